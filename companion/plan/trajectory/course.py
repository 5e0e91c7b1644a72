"""Minimum jerk through several points: consecutive quintics, smooth to the fourth derivative.

The integral of the squared jerk through given points at given times is smallest for a spline of quintics
whose jerk and snap are continuous at each point (Pontryagin, as for eq. 20 within a leg). With eq. 29 for a
leg of T from (x0, v0, a0) to (x1, v1, a1), D = x1 - x0:

    jerk at its start  (60 D - T (36 v0 + 24 v1) - T² (9 a0 - 3 a1)) / T³
    jerk at its end    (60 D - T (24 v0 + 36 v1) - T² (3 a0 - 9 a1)) / T³
    snap at its start (-360 D + T (192 v0 + 168 v1) + T² (36 a0 - 24 a1)) / T⁴
    snap at its end    (360 D - T (168 v0 + 192 v1) - T² (24 a0 - 36 a1)) / T⁴

These are linear in the velocities and accelerations at the points, so one solution serves all three axes.
Frame-free, m and s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np

from companion.base.geometry import ZERO3, FloatArray, Vector3, add, norm, scale
from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.trajectory.min_jerk import REST_PEAK, Trajectory, carried, plan

CHECKED: Final = 8  # so many steps of a leg are looked at for its limits
_MOST_STRETCHES: Final = 8
# So near to the limits is near enough: behind a target that runs, the last few per cent take for ever.
_NEAR_ENOUGH: Final = 1.05
_REST_PUSH: Final = 5.7735  # from rest to rest the greatest acceleration so many times distance / time²
_MEAN_SHARE: Final = 0.8  # of the greatest speed, as the mean of a leg that is passed through
_SHORTEST_S: Final = 0.3


@dataclass(frozen=True, slots=True)
class Course:
    """Trajectories one after another, each starting where and when the one before ends."""

    legs: tuple[Trajectory, ...]

    @property
    def start_s(self) -> float:
        return self.legs[0].start_s

    @property
    def end_s(self) -> float:
        return self.legs[-1].end_s

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    def at(self, time_s: float) -> Motion:
        leg = next((leg for leg in self.legs if time_s < leg.end_s), self.legs[-1])
        return leg.at(time_s)

    def rows(self, time_s: float, count: int, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        ends_s = [leg.end_s for leg in self.legs[:-1]]
        which = np.searchsorted(ends_s, time_s + step_s * np.arange(count), side="right")
        rows = self.legs[int(which[0])].rows(time_s, count, step_s)
        for i in range(int(which[0]) + 1, int(which[-1]) + 1):
            for row, later in zip(rows, self.legs[i].rows(time_s, count, step_s), strict=True):
                row[which >= i] = later[which >= i]
        return rows

    def carried(self, by: Motion, at_s: float) -> Course:
        """Seen from the frame in which its own frame is at `by` at a time and moves on at its velocity."""
        return Course(tuple(carried(leg, by, at_s) for leg in self.legs))


PlannedPath = Trajectory | Course
_Path = TypeVar("_Path", Trajectory, Course)


def through(
    start: Motion, via: Sequence[Vector3], final: Motion, start_s: float, durations_s: Sequence[float]
) -> Course:
    """The minimum-jerk course from a state through points to a state, all in one frame.

    Raises:
        ValueError: a duration is not positive, or there are not as many as legs, one more than points.
    """
    if len(durations_s) != len(via) + 1 or not min(durations_s) > 0.0:
        raise ValueError(f"{len(via)} points need {len(via) + 1} durations above 0, found {durations_s}")
    motions = [start, *_at_points(start, via, final, durations_s), final]
    return _joined(motions, start_s, durations_s)


def _at_points(
    start: Motion, via: Sequence[Vector3], final: Motion, durations_s: Sequence[float]
) -> list[Motion]:
    """Velocity and acceleration at each point, so that jerk and snap are continuous there."""
    n = len(via)
    if n == 0:
        return []
    places = np.array([start.position_m, *via, final.position_m])
    # columns: v and a at every place, the ends included; they are known and go to the right-hand side
    system = np.zeros((2 * n, 2 * (n + 2)))
    wanted = np.zeros((2 * n, 3))
    for i in range(n):
        t, u = durations_s[i], durations_s[i + 1]
        k = 2 * i
        jerk, snap = system[k], system[k + 1]
        jerk[k : k + 4] += [-24.0 / t**2, -3.0 / t, -36.0 / t**2, 9.0 / t]
        jerk[k + 2 : k + 6] += [36.0 / u**2, 9.0 / u, 24.0 / u**2, -3.0 / u]
        snap[k : k + 4] += [-168.0 / t**3, -24.0 / t**2, -192.0 / t**3, 36.0 / t**2]
        snap[k + 2 : k + 6] += [-192.0 / u**3, -36.0 / u**2, -168.0 / u**3, 24.0 / u**2]
        before, after = places[i + 1] - places[i], places[i + 2] - places[i + 1]
        wanted[k] = 60.0 * (after / u**3 - before / t**3)
        wanted[k + 1] = -360.0 * (after / u**4 + before / t**4)
    ends = np.array(
        [start.velocity_m_s, start.acceleration_m_s2, final.velocity_m_s, final.acceleration_m_s2]
    )
    wanted -= system[:, [0, 1, -2, -1]] @ ends
    found = np.linalg.solve(system[:, 2:-2], wanted).tolist()
    return [
        Motion(point, (v[0], v[1], v[2]), (a[0], a[1], a[2]))
        for point, v, a in zip(via, found[::2], found[1::2], strict=True)
    ]


def paced(
    start: Motion, via: Sequence[Vector3], target: Motion, start_s: float, limits: GuidanceConfig
) -> Course:
    """Through points to one that moves on at its velocity, within the limits (speed to 5, push to 10 %).

    The speed's limits count relative to the target: its own speed comes on top.

    Each leg gets the time that its length takes at most of the speed allowed, the first and the last half of
    T_min more; then all times grow together until no limit is broken (but by what the start already has).
    """
    first_s = _first_guess(start, via, target, limits)

    def lasting(times: float) -> Course:
        durations_s = [times * duration_s for duration_s in first_s]
        return through(start, via, _met(target, sum(durations_s)), start_s, durations_s)

    return stretched(lasting, limits, target.velocity_m_s, _NEAR_ENOUGH)


def _first_guess(
    start: Motion, via: Sequence[Vector3], target: Motion, limits: GuidanceConfig
) -> list[float]:
    durations = [limits.minimum_time_s]
    for _ in range(_MOST_STRETCHES):  # the target moves on meanwhile
        before_s = sum(durations)
        places = [start.position_m, *via, _met(target, before_s).position_m]
        durations = [
            max(_SHORTEST_S, _crossing_s(p, q, *_greatest_speeds(target.velocity_m_s, limits)) / _MEAN_SHARE)
            for p, q in pairwise(places)
        ]
        durations[0] += 0.5 * limits.minimum_time_s
        durations[-1] += 0.5 * limits.minimum_time_s
        if abs(sum(durations) - before_s) <= 0.02 * before_s:
            break
    return durations


def halting(
    start: Motion, via: Sequence[Vector3], target: Motion, start_s: float, limits: GuidanceConfig
) -> Course:
    """As `paced`, but with a halt at each point: from the first on it keeps to the straight lines."""
    places = [start.position_m, *via]
    durations = [_from_rest_s(p, q, limits) for p, q in pairwise(places)]
    # the last leg makes up for what the target has gone ahead, and then for its speed
    durations.append(_from_rest_s(places[-1], _met(target, sum(durations)).position_m, limits))
    durations[-1] += 1.5 * norm(target.velocity_m_s) / limits.horizontal_acceleration_m_s2
    brake_s = 1.5 * norm(start.velocity_m_s) / limits.horizontal_acceleration_m_s2
    durations[0] += brake_s + 0.5 * limits.minimum_time_s
    motions = [start, *(Motion(point) for point in via), _met(target, sum(durations))]
    return _joined(motions, start_s, durations)


def _joined(motions: Sequence[Motion], start_s: float, durations_s: Sequence[float]) -> Course:
    legs, begins_s = list[Trajectory](), start_s
    for (here, there), duration_s in zip(pairwise(motions), durations_s, strict=True):
        legs.append(plan(here, there, begins_s, duration_s))
        begins_s = legs[-1].end_s
    return Course(tuple(legs))


def _met(target: Motion, after_s: float) -> Motion:
    return Motion(add(target.position_m, scale(target.velocity_m_s, after_s)), target.velocity_m_s)


def _crossing_s(p: Vector3, q: Vector3, fastest: float, steepest: float) -> float:
    """Shortest time between two points at the greatest speeds across and along down."""
    return max(math.dist(p[:2], q[:2]) / fastest, abs(q[2] - p[2]) / steepest)


def _from_rest_s(p: Vector3, q: Vector3, limits: GuidanceConfig) -> float:
    """Shortest time of a quintic from rest to rest within the limits."""
    push = max(
        math.dist(p[:2], q[:2]) / limits.horizontal_acceleration_m_s2,
        abs(q[2] - p[2]) / limits.vertical_acceleration_m_s2,
    )
    crossing_s = _crossing_s(p, q, limits.horizontal_speed_m_s, limits.vertical_speed_m_s)
    return max(_SHORTEST_S, REST_PEAK * crossing_s, math.sqrt(_REST_PUSH * push))


def stretched(
    lasting: Callable[[float], _Path],
    limits: GuidanceConfig,
    target_m_s: Vector3 = ZERO3,
    near_enough: float = 1.001,
) -> _Path:
    """The quickest of some ways that breaks no limit, unless its start does already: that cannot be mended.

    Args:
        lasting: the way that lasts so many times as long as the first; all have the same start.
        limits: of the speed relative to the target, and of the acceleration.
        target_m_s: velocity of what they lead to, in their frame.
        near_enough: so many times a limit counts as kept.
    """
    times, way = 1.0, lasting(1.0)
    excess = _excess(way, limits, target_m_s)
    for _ in range(_MOST_STRETCHES):
        if excess <= near_enough:
            break
        times *= min(excess, 1.5)
        longer = lasting(times)
        before, excess = excess, _excess(longer, limits, target_m_s)
        if excess >= before:
            break  # an acceleration at the start lasts longer too, and leads to more speed
        way = longer
    return way


def _excess(way: PlannedPath, limits: GuidanceConfig, target_m_s: Vector3) -> float:
    """By what factor a way should last longer."""
    steps = CHECKED * (len(way.legs) if isinstance(way, Course) else 1)
    step_s = way.duration_s / steps
    along = [way.at(way.start_s + k * step_s) for k in range(steps + 1)]
    push, lift = limits.horizontal_acceleration_m_s2, limits.vertical_acceleration_m_s2
    speed = _over([m.velocity_m_s for m in along], *_greatest_speeds(target_m_s, limits))
    return max(speed, math.sqrt(_over([m.acceleration_m_s2 for m in along], push, lift)))


def _over(along: Sequence[Vector3], across: float, down: float) -> float:
    """The greatest of them over the limits across and along down, or over the first where that is more."""
    flat, steep = [math.hypot(x, y) for x, y, _ in along], [abs(z) for *_, z in along]
    return max(max(flat) / max(across, flat[0]), max(steep) / max(down, steep[0]))


def _greatest_speeds(target_m_s: Vector3, limits: GuidanceConfig) -> tuple[float, float]:
    """The greatest speeds across and along down: relative to a target that runs from who stands, its own."""
    across, along = math.hypot(*target_m_s[:2]), abs(target_m_s[2])
    return across + max(limits.horizontal_speed_m_s, across), along + max(limits.vertical_speed_m_s, along)
