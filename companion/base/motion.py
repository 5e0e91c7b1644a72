"""How a point moves at one moment: the one form for a vehicle's or a pad's motion in a named frame."""

from dataclasses import dataclass
from typing import Final

from companion.base.geometry import ZERO3, Vector3

COURSE_M_S: Final = 0.3  # slower than this a pad has no course: how it turns is noise


@dataclass(frozen=True, slots=True)
class Motion:
    """Position (m), velocity (m/s) and acceleration (m/s²) of a point at one time, in one frame.

    Who holds it says whose motion it is and in which frame.
    """

    position_m: Vector3
    velocity_m_s: Vector3 = ZERO3
    acceleration_m_s2: Vector3 = ZERO3
