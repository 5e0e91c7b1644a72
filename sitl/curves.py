"""Plane curves and waves in closed form, by time at a constant speed: what pads move along.

NED, SI; courses clockwise from north. Each gives place, velocity, acceleration, course and course rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from scipy.special import ellipj

from companion.geometry import Vector3, add, rotate_yaw

# a lap over half the length: twice the lemniscate constant
LEMNISCATE_LAP: Final = 5.244115108584239


class Place(NamedTuple):
    """A path's point."""

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    course_rad: float
    course_rate_rad_s: float


Path = Callable[[float], Place]


class Arc(NamedTuple):
    """Where a bend begins, and how fast it turns."""

    position_ned_m: Vector3
    course_rad: float
    turn_rad_s: float


def arc_place(arc: Arc, speed_m_s: float, t: float) -> Place:
    """The point t seconds along a bend; the chord's form holds for a straight line too."""
    half = 0.5 * arc.turn_rad_s * t
    chord = speed_m_s * t * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    middle, course = arc.course_rad + half, arc.course_rad + 2.0 * half
    c, s, w = math.cos(course), math.sin(course), arc.turn_rad_s
    position = add(arc.position_ned_m, (chord * math.cos(middle), chord * math.sin(middle), 0.0))
    velocity = (speed_m_s * c, speed_m_s * s, 0.0)
    return Place(position, velocity, (-w * velocity[1], w * velocity[0], 0.0), course, w)


def lemniscate_place(arc_m: float, a: float, speed_m_s: float, axis_rad: float) -> Place:
    """The point arc_m along Bernoulli's r^4 = a^2 (x^2 - y^2), x along the axis.

    With u the arc over a, r / a = sl(u) = sd(u sqrt 2 | 1/2) / sqrt 2 and y / x = cl(u) = cn(u sqrt 2 | 1/2);
    the curvature is 3 r / a^2.
    """
    sn, cl, dn, _ = (float(value) for value in ellipj(math.sqrt(2.0) * arc_m / a, 0.5))
    r = sn / dn / math.sqrt(2.0)
    stretch = math.sqrt(0.5 * (1.0 + r * r))
    x = r * stretch
    tx = cl * stretch * (1.0 + 2.0 * r * r)
    ty = tx * cl - x * r * (1.0 + cl * cl)
    rate = -3.0 * r / a * speed_m_s
    velocity = rotate_yaw((speed_m_s * tx, speed_m_s * ty, 0.0), axis_rad)
    return Place(
        rotate_yaw((a * x, a * x * cl, 0.0), axis_rad),
        velocity,
        (-rate * velocity[1], rate * velocity[0], 0.0),
        math.atan2(velocity[1], velocity[0]),
        rate,
    )


def wave_frequency(energy_share: float, peak_period_s: float) -> float:
    """Frequency (rad/s) under which lies this share (0..1, open) of a Pierson-Moskowitz spectrum's energy.

    Its cumulative energy is exp(-1.25 (w_p / w)^4).
    """
    return math.tau / peak_period_s * float((1.25 / -math.log(energy_share)) ** 0.25)


def sum_of_waves(
    waves: tuple[tuple[float, float, float], ...], t: float, shift_rad: float
) -> tuple[float, float, float]:
    """Elevation (m), its speed and acceleration, of waves given as amplitude (m), rad/s and phase (rad)."""
    x = v = a = 0.0
    for amplitude, w, phase in waves:
        angle = w * t + phase + shift_rad
        s, c = amplitude * math.sin(angle), amplitude * math.cos(angle)
        x, v, a = x + s, v + w * c, a - w * w * s
    return x, v, a
