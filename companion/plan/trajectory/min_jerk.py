"""Minimum-jerk trajectories: one quintic an axis (eqs. 20-30) and their duration (eq. 37).

Frame-free: whatever frame the boundary states are in (pad-relative NED or the EKF's NED) the
trajectory is in. Metres and seconds; tau = (t - t0) / T runs from 0 to 1.

The paper ends at rest; here the final velocity and acceleration are general, so that a trajectory can
meet a point that moves. With x(1) = xf, x'(1) = T vf, x''(1) = T² af the three free coefficients solve
    c3 +  c4 +   c5 = xf - x0 - T v0 - T² a0 / 2
   3c3 + 4c4 +  5c5 = T vf - T v0 - T² a0
   6c3 + 12c4 + 20c5 = T² af - T² a0
which for vf = af = 0 gives back eq. 30.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray
from companion.base.motion import Motion

Coefficients = tuple[float, float, float, float, float, float]

REST_PEAK: Final = 1.875  # from rest to rest the greatest speed is so many times the mean
SHORTEST_STOP_S: Final = 0.6
HARD_STOP_M_S2: Final = 3.0  # harder than the plan's own limits, for safety and to keep the pad in view


def trajectory_time_s(distance_m: float, speed_m_s: float, minimum_time_s: float) -> float:
    """T (s) of a way |Δ| (m) at an average speed V (m/s): T = |Δ| / V + T_min, eq. 37 of the paper.

    V comes from the speed law (`companion.plan.speed`), T_min is the setting `plan.guidance.minimum_time_s`.
    `stretched` lengthens it if speed or acceleration would exceed its limit.
    """
    return distance_m / speed_m_s + minimum_time_s


def quintic(
    start: tuple[float, float, float], final: tuple[float, float, float], duration_s: float
) -> Coefficients:
    """Coefficients c0..c5 of x(tau) from (position, velocity, acceleration) to the same (eqs. 29, 30).

    Raises:
        ValueError: the duration is not positive.
    """
    if not duration_s > 0.0:
        raise ValueError(f"a trajectory takes time: duration {duration_s} s")
    t, t2 = duration_s, duration_s * duration_s
    x0, v0, a0 = start
    xf, vf, af = final
    delta = xf - x0
    return (
        x0,
        t * v0,
        0.5 * t2 * a0,
        10.0 * delta - t * (6.0 * v0 + 4.0 * vf) - t2 * (1.5 * a0 - 0.5 * af),
        -15.0 * delta + t * (8.0 * v0 + 7.0 * vf) + t2 * (1.5 * a0 - af),
        6.0 * delta - t * (3.0 * v0 + 3.0 * vf) - t2 * (0.5 * a0 - 0.5 * af),
    )


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Three quintics over [start_s, start_s + duration_s]; afterwards the final velocity goes on."""

    start_s: float
    duration_s: float
    axes: tuple[Coefficients, Coefficients, Coefficients]

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s

    def at(self, time_s: float) -> Motion:
        """State at a time; the start's before it, the final position led by the final velocity after."""
        tau = min(1.0, max(0.0, (time_s - self.start_s) / self.duration_s))
        beyond_s = max(0.0, time_s - self.end_s)
        x, y, z = self.axes
        px, vx, ax = _axis_at(x, tau, beyond_s, self.duration_s)
        py, vy, ay = _axis_at(y, tau, beyond_s, self.duration_s)
        pz, vz, az = _axis_at(z, tau, beyond_s, self.duration_s)
        return Motion((px, py, pz), (vx, vy, vz), (ax, ay, az))

    def rows(self, time_s: float, count: int, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations, each (count, 3), at time_s + k * step_s."""
        since_s = time_s - self.start_s + step_s * np.arange(count)
        tau = np.clip(since_s / self.duration_s, 0.0, 1.0)
        beyond_s = np.maximum(since_s - self.duration_s, 0.0)[:, None]
        powers = np.vander(tau, 6, increasing=True)
        c = np.array(self.axes).T
        inverse = 1.0 / self.duration_s
        velocity = powers[:, :5] @ (c[1:] * _FIRST) * inverse
        acceleration = powers[:, :4] @ (c[2:] * _SECOND) * (inverse * inverse)
        acceleration[beyond_s[:, 0] > 0.0] = 0.0
        return powers @ c + velocity * beyond_s, velocity, acceleration


_FIRST = np.array([[1.0], [2.0], [3.0], [4.0], [5.0]])
_SECOND = np.array([[2.0], [6.0], [12.0], [20.0]])


def _axis_at(c: Coefficients, tau: float, beyond_s: float, duration_s: float) -> tuple[float, float, float]:
    position = c[0] + tau * (c[1] + tau * (c[2] + tau * (c[3] + tau * (c[4] + tau * c[5]))))
    slope = c[1] + tau * (2.0 * c[2] + tau * (3.0 * c[3] + tau * (4.0 * c[4] + tau * 5.0 * c[5])))
    velocity = slope / duration_s
    if beyond_s > 0.0:
        return (position + velocity * beyond_s, velocity, 0.0)
    bend = 2.0 * c[2] + tau * (6.0 * c[3] + tau * (12.0 * c[4] + tau * 20.0 * c[5]))
    return (position, velocity, bend / (duration_s * duration_s))


def plan(start: Motion, final: Motion, start_s: float, duration_s: float) -> Trajectory:
    """The minimum-jerk trajectory between two states (eqs. 20-30), both in the same frame.

    Raises:
        ValueError: the duration is not positive.
    """
    here, there = (
        zip(motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2, strict=True)
        for motion in (start, final)
    )
    x, y, z = (quintic(begin, end, duration_s) for begin, end in zip(here, there, strict=True))
    return Trajectory(start_s, duration_s, (x, y, z))


def brake(start: Motion, start_s: float, deceleration_m_s2: float) -> Trajectory:
    """Come to rest along the present velocity, about as gently as the given deceleration (m/s²)."""
    v = start.velocity_m_s
    duration_s = stop_s((v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) ** 0.5, deceleration_m_s2)
    p = start.position_m
    half = 0.5 * duration_s
    final = Motion((p[0] + half * v[0], p[1] + half * v[1], p[2] + half * v[2]))
    return plan(start, final, start_s, duration_s)


def stop_s(speed_m_s: float, deceleration_m_s2: float) -> float:
    """How long `brake` takes: a quintic from speed v to rest over v T / 2 peaks at 1.5 v / T."""
    return max(SHORTEST_STOP_S, 1.5 * speed_m_s / deceleration_m_s2)


def carried(trajectory: Trajectory, by: Motion, at_s: float) -> Trajectory:
    """A trajectory seen from the frame in which its own is at `by` at a time, gaining speed steadily."""
    t, lasts_s = trajectory.start_s - at_s, trajectory.duration_s
    x, y, z = (
        (
            c[0] + place + (rate + 0.5 * gain * t) * t,
            c[1] + (rate + gain * t) * lasts_s,
            c[2] + 0.5 * gain * lasts_s * lasts_s,
            *c[3:],
        )
        for c, place, rate, gain in zip(
            trajectory.axes, by.position_m, by.velocity_m_s, by.acceleration_m_s2, strict=True
        )
    )
    return Trajectory(trajectory.start_s, trajectory.duration_s, (x, y, z))
