"""Frames in uniform motion, such as a pad's: transformations to and from them, and their predicted motion.

The fixed frame is the EKF's NED. A frame is the motion of its origin; its axes are NED's. m, s.
"""

import math
from typing import Final

import numpy as np

from companion.base.geometry import ZERO3, FloatArray, Vector3, add, scale
from companion.base.motion import COURSE_M_S, Motion

STILL: Final = Motion(ZERO3)
FASTEST_TURN_RAD_S: Final = 1.0  # of a pad's course: a faster turn is noise, or turning back


def in_space(motion: Motion, frame: Motion) -> Motion:
    """A motion in a frame that moves evenly, seen from space."""
    return Motion(
        add(motion.position_m, frame.position_m),
        add(motion.velocity_m_s, frame.velocity_m_s),
        motion.acceleration_m_s2,
    )


def space_seen_from(frame: Motion) -> Motion:
    """Space as it moves seen from the frame."""
    return Motion(scale(frame.position_m, -1.0), scale(frame.velocity_m_s, -1.0))


def along_arc(
    place_m: Vector3, velocity_m_s: Vector3, turn_rate_rad_s: float, duration_s: float
) -> tuple[float, float]:
    """Where (m, north and east) what keeps its speed and its turn gets to in a time."""
    (pn, pe, _), (vn, ve, _) = place_m, velocity_m_s
    angle = turn_rate_rad_s * duration_s
    turns = abs(angle) > 1e-4
    along_s = math.sin(angle) / turn_rate_rad_s if turns else duration_s
    across_s = (1.0 - math.cos(angle)) / turn_rate_rad_s if turns else 0.5 * angle * duration_s
    return pn + along_s * vn - across_s * ve, pe + across_s * vn + along_s * ve


def predicted_places(frame: Motion, times_s: FloatArray) -> FloatArray:
    """Where a frame will be, (n, 3), at times (n,) from now: along the arc that its acceleration gives."""
    (vn, ve, vd), (an, ae, _) = frame.velocity_m_s, frame.acceleration_m_s2
    square = vn * vn + ve * ve
    turn = (vn * ae - ve * an) / square if square > COURSE_M_S**2 else 0.0
    angle = max(-FASTEST_TURN_RAD_S, min(FASTEST_TURN_RAD_S, turn)) * times_s
    # sin(a) / a and (1 - cos(a)) / a, which numpy's sinc has for a = 0 too
    along, across = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi)) * np.sin(0.5 * angle)
    north, east = times_s * (along * vn - across * ve), times_s * (along * ve + across * vn)
    return np.array(frame.position_m) + np.stack((north, east, times_s * vd), axis=1)
