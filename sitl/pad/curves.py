"""Plane curves and waves in closed form, by time at a constant speed, for the pad's motion.

NED, SI; courses clockwise from north. Each gives position, velocity, acceleration, course and course rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import Vector3, add, rotate_yaw

# a lap over half the length: twice the lemniscate constant
LEMNISCATE_LAP: Final = 5.244115108584239
_NODES: Final = tuple(zip(*(values.tolist() for values in np.polynomial.legendre.leggauss(16)), strict=True))


class PathPoint(NamedTuple):
    """A path's point."""

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    course_rad: float
    course_rate_rad_s: float


Path = Callable[[float], PathPoint]
# amplitude (m), frequency (rad/s) and phase (rad)
Wave = tuple[float, float, float]


class PathSegment(NamedTuple):
    """A segment of a driven path: start, change of course and speed, and duration.

    Rate of turn and acceleration along it are raised cosines, zero at both ends: the segments join
    with finite jerk. Their peak is twice their mean.
    """

    position_ned_m: Vector3
    course_rad: float
    turn_rad: float
    length_s: float
    speed_m_s: float
    end_speed_m_s: float


def segment_point(segment: PathSegment, t: float) -> PathPoint:
    """The point t seconds along a segment; a straight one extends beyond its ends.

    The position is the velocity's integral by Gauss-Legendre quadrature: accurate to 1e-9 m in half a turn.
    """
    place, course0, turn, length_s, speed0, speed1 = segment
    gain, half = speed1 - speed0, 0.5 * t
    x = y = 0.0
    for node, weight in _NODES:
        share = half * (1.0 + node) / length_s
        ramp = share - math.sin(math.tau * share) / math.tau
        speed, course = weight * (speed0 + gain * ramp), course0 + turn * ramp
        x, y = x + speed * math.cos(course), y + speed * math.sin(course)
    share = t / length_s
    ramp, slope = share - math.sin(math.tau * share) / math.tau, (1.0 - math.cos(math.tau * share)) / length_s
    speed, course, rate = speed0 + gain * ramp, course0 + turn * ramp, turn * slope
    c, s = math.cos(course), math.sin(course)
    along, across = gain * slope, rate * speed
    return PathPoint(
        add(place, (half * x, half * y, 0.0)),
        (speed * c, speed * s, 0.0),
        (along * c - across * s, along * s + across * c, 0.0),
        course,
        rate,
    )


def lemniscate_point(arc_m: float, a: float, speed_m_s: float, axis_rad: float) -> PathPoint:
    """The point arc_m along Bernoulli's r^4 = a^2 (x^2 - y^2), x along the axis.

    With u the arc over a, r / a = sl(u) = sd(u sqrt 2 | 1/2) / sqrt 2 and y / x = cl(u) = cn(u sqrt 2 | 1/2);
    the curvature is 3 r / a^2.
    """
    from scipy.special import ellipj  # noqa: PLC0415 - slow

    sn, cl, dn, _ = (float(value) for value in ellipj(math.sqrt(2.0) * arc_m / a, 0.5))
    r = sn / dn / math.sqrt(2.0)
    stretch = math.sqrt(0.5 * (1.0 + r * r))
    x = r * stretch
    tx = cl * stretch * (1.0 + 2.0 * r * r)
    ty = tx * cl - x * r * (1.0 + cl * cl)
    rate = -3.0 * r / a * speed_m_s
    velocity = rotate_yaw((speed_m_s * tx, speed_m_s * ty, 0.0), axis_rad)
    return PathPoint(
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


def sum_of_waves(waves: tuple[Wave, ...], t: float, shift_rad: float) -> tuple[float, float, float]:
    """Elevation (m), its speed and its acceleration."""
    x = v = a = 0.0
    for amplitude, w, phase in waves:
        angle = w * t + phase + shift_rad
        s, c = amplitude * math.sin(angle), amplitude * math.cos(angle)
        x, v, a = x + s, v + w * c, a - w * w * s
    return x, v, a
