"""Setpoints that the autopilot flies, and the fields of a streamed message in SI units.

The meaning of fields, mask and frame differs between autopilots: `px4.control`, `ardupilot.control`. NED
in the autopilot's own heading frame, SI units; a value that is not given is NaN.
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from math import isfinite, nan
from typing import Final

from companion.base.geometry import ZERO3, Quaternion, Vector3, quat_normalise

NOT_GIVEN: Final[Vector3] = (nan, nan, nan)
_UNIT_WITHIN: Final = 1e-3


@dataclass(frozen=True, slots=True)
class MotionSetpoint:
    """Position, velocity, acceleration and heading. North and east are given together or not at all.

    `streamed`: it was received by MAVLink, it does not come from an autonomous mode.
    """

    position_ned_m: Vector3 = NOT_GIVEN
    velocity_ned_m_s: Vector3 = NOT_GIVEN
    acceleration_ned_m_s2: Vector3 = NOT_GIVEN
    yaw_rad: float = nan
    yaw_rate_rad_s: float = nan
    horizontal_speed_m_s: float = 12.0
    climb_speed_m_s: float = 3.0
    descent_speed_m_s: float = 1.5
    streamed: bool = False


STOP: Final = MotionSetpoint(velocity_ned_m_s=ZERO3, yaw_rate_rad_s=0.0, streamed=True)


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """Attitude (body to NED) and the field `thrust` (0..1), whose meaning depends on the autopilot.

    `attitude` None: only the body rates are flown. With an attitude they are what it turns at, and
    `yaw_rate_rad_s` is a turn about the world's down axis. `holds_height`: whatever `thrust` means, none.
    """

    attitude: Quaternion | None
    thrust: float
    yaw_rate_rad_s: float = 0.0
    rate_body_rad_s: Vector3 = ZERO3
    holds_height: bool = False


@dataclass(frozen=True, slots=True)
class SetpointRefusal:
    """A rejected setpoint, and the text that reports it, if any."""

    text: str = ""


class LocalFrame(IntEnum):
    """MAV_FRAME of SET_POSITION_TARGET_LOCAL_NED."""

    LOCAL_NED = 1
    LOCAL_OFFSET_NED = 7
    BODY_NED = 8
    BODY_OFFSET_NED = 9


class GlobalFrame(IntEnum):
    """MAV_FRAME of SET_POSITION_TARGET_GLOBAL_INT: what the altitude counts from."""

    GLOBAL = 0
    RELATIVE_ALT = 3
    GLOBAL_INT = 5
    RELATIVE_ALT_INT = 6
    TERRAIN_ALT = 10
    TERRAIN_ALT_INT = 11


OVER_HOME: Final = frozenset({GlobalFrame.RELATIVE_ALT, GlobalFrame.RELATIVE_ALT_INT})
OVER_TERRAIN: Final = frozenset({GlobalFrame.TERRAIN_ALT, GlobalFrame.TERRAIN_ALT_INT})


class Ignore(IntFlag):
    """POSITION_TARGET_TYPEMASK: a set bit means that the field is not to be used."""

    X, Y, Z = 1, 2, 4
    VX, VY, VZ = 8, 16, 32
    AX, AY, AZ = 64, 128, 256
    FORCE = 512
    YAW = 1024
    YAW_RATE = 2048


class IgnoreAttitude(IntFlag):
    """ATTITUDE_TARGET_TYPEMASK; THRUST_BODY means that the thrust is a vector, in a field that the
    MAVLink library here does not know."""

    ROLL_RATE, PITCH_RATE, YAW_RATE = 1, 2, 4
    THRUST_BODY = 32
    THROTTLE = 64
    ATTITUDE = 128


@dataclass(frozen=True, slots=True)
class StreamedMotion:
    """The fields of SET_POSITION_TARGET_LOCAL_NED or _GLOBAL_INT in SI units.

    `frame` may be unknown. A global position has been converted to local NED.
    """

    frame: int
    mask: int
    position_m: Vector3
    velocity_m_s: Vector3
    acceleration_m_s2: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float
    is_global: bool = False


@dataclass(frozen=True, slots=True)
class StreamedAttitude:
    """The fields of SET_ATTITUDE_TARGET."""

    mask: int
    attitude: tuple[float, float, float, float]
    rate_body_rad_s: Vector3
    thrust: float


def unit_attitude(values: tuple[float, float, float, float]) -> Quaternion | None:
    """The attitude of a message, None if it is not a unit quaternion."""
    w, x, y, z = values
    length = w * w + x * x + y * y + z * z
    if not isfinite(length) or abs(length - 1.0) > _UNIT_WITHIN:
        return None
    return quat_normalise((w, x, y, z))


def is_finite(vector: Vector3) -> bool:
    return isfinite(vector[0]) and isfinite(vector[1]) and isfinite(vector[2])
