"""Lengthens a trajectory until it keeps the limits of speed and acceleration, up to a longest time. m, s."""

import math
from typing import Final

from companion.base.geometry import Vector3
from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.trajectory.min_jerk import Trajectory, plan

_CHECKED_AT: Final = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
_MOST_STRETCHES: Final = 4


def within_limits(
    moving: Motion, duration_s: float, longest_s: float, now_s: float, limits: GuidanceConfig
) -> Trajectory:
    """The way to the origin at rest, longer than asked where speed or acceleration would be too much.

    Within reason: an acceleration at the start lasts the longer the longer the way, and more time makes
    the speed that it leads to worse.
    """
    best, least = None, math.inf
    for _ in range(_MOST_STRETCHES + 1):
        trajectory = plan(moving, Motion((0.0, 0.0, 0.0)), now_s, duration_s)
        stretch = _stretch(trajectory, moving, limits)
        if best is None or stretch < least:
            best, least = trajectory, stretch
        if stretch <= 1.001:
            break
        duration_s = min(duration_s * min(stretch, 1.5), longest_s)
    assert best is not None
    return best


def _stretch(trajectory: Trajectory, start: Motion, limits: GuidanceConfig) -> float:
    """By what factor the duration should grow; what the start already exceeds cannot be helped."""
    v, a = start.velocity_m_s, start.acceleration_m_s2
    fastest, steepest = max(limits.horizontal_speed_m_s, _flat(v)), max(limits.vertical_speed_m_s, abs(v[2]))
    push = max(limits.horizontal_acceleration_m_s2, _flat(a))
    lift = max(limits.vertical_acceleration_m_s2, abs(a[2]))
    speed = acceleration = 1.0
    for tau in _CHECKED_AT:
        motion = trajectory.at(trajectory.start_s + tau * trajectory.duration_s)
        v, a = motion.velocity_m_s, motion.acceleration_m_s2
        speed = max(speed, _flat(v) / fastest, abs(v[2]) / steepest)
        acceleration = max(acceleration, _flat(a) / push, abs(a[2]) / lift)
    return max(speed, math.sqrt(acceleration))


def _flat(v: Vector3) -> float:
    return math.hypot(v[0], v[1])
