"""The world of Fig. 14 by seed: a moving pad, obstacles before it, and what disturbs whom.

NED, SI. The pad and the wind are the simulator's; obstacles are drawn again until the pad's way and the start
are clear of them and there is something to go round.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, Vector3, add, dot, norm, scale, subtract
from companion.base.motion import Motion
from companion.config import Box, Cylinder
from companion.plan.obstacles.obstacles import Obstacle, clearance_m, line_clear, route
from companion.plan.speed.speed_table import SpeedTable, load_table
from companion.plan.trajectory.course import Course, through
from companion.plan.trajectory.min_jerk import trajectory_time_s
from sitl.pad.motion import PadMotion, build_pad_motion
from sitl.pad.paths import Meeting, RandomTurnsMotion
from sitl.vehicle.quadrotor import QuadrotorParameters
from sitl.world.wind import GustSettings, WindSettings

START_NED_M: Final[Vector3] = (0.0, 0.0, -6.0)
HOVERS_S: Final = 2.0  # before the reference begins, so that integrals and estimates settle; not scored
FLOWN_S: Final = 18.0
SURFACE_HEIGHT_M: Final = 0.3
OBSTACLES: Final = 3
PAD_CLEAR_M: Final = 2.2
START_CLEAR_M: Final = 2.0
BETWEEN_M: Final = 2.6  # two obstacles leave a gate as wide or none
TRIES: Final = 500
PAD: Final = RandomTurnsMotion(
    kind="random_turns",
    speed_m_s=1.2,
    slowest_m_s=0.6,
    max_turn_rate_deg_s=15.0,
    max_acceleration_m_s2=0.6,
    radius_m=30.0,
    meet=Meeting(point_ned_m=(14.0, 0.0), time_s=9.0, spread_m=2.0),
)
WIND: Final = WindSettings(
    mean_m_s=3.0,
    turbulence="moderate",
    gusts=GustSettings(amplitude_m_s=6.0, duration_s=2.0, interval_s=3.0),
)
MODEL_ERROR: Final = 0.2


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measured state."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0


@dataclass(frozen=True)
class DisturbanceCase:
    """What a flight is disturbed by."""

    name: str
    gusts: bool = False
    model_error: bool = False
    noise: Noise = Noise()


NOISY: Final = Noise(0.02, 0.04, math.radians(0.5), 0.03)
CASES: Final = (
    DisturbanceCase("nominal"),
    DisturbanceCase("gust", gusts=True),
    DisturbanceCase("mass, inertia", model_error=True),
    DisturbanceCase("noise", noise=NOISY),
    DisturbanceCase("all", gusts=True, model_error=True, noise=NOISY),
)


@dataclass(frozen=True)
class LandingScene:
    """One seed: where the pad goes and what stands in the way."""

    seed: int
    pad: PadMotion
    obstacles: tuple[Obstacle, ...]


def draw_world(seed: int, attempt: int = 0) -> LandingScene:
    """The pad's motion and the obstacles of a seed; another attempt is another draw.

    Raises:
        RuntimeError: nothing was found that can be flown round.
    """
    rng = np.random.default_rng((seed, 14, attempt))
    for _ in range(TRIES):
        pad = build_pad_motion(PAD, SURFACE_HEIGHT_M, "along", rng)
        obstacles = _drawn_obstacles(rng)
        if _flyable(pad, obstacles):
            return LandingScene(seed, pad, obstacles)
    raise RuntimeError(f"seed {seed}: no obstacles fit between the start and the pad's way")


def _drawn_obstacles(rng: np.random.Generator) -> tuple[Obstacle, ...]:
    found = []
    for k in range(OBSTACLES):
        place = (float(rng.uniform(3.0, 10.0)), float(rng.uniform(-4.0, 4.0)))
        if k == OBSTACLES - 1:
            length, heading = float(rng.uniform(1.0, 2.5)), float(rng.uniform(-90.0, 90.0))
            box = Box(
                kind="box",
                centre_ned_m=place,
                length_m=length,
                width_m=0.6,
                heading_deg=heading,
                height_m=9.0,
            )
            found.append(Obstacle.of(box))
        else:
            radius = float(rng.uniform(0.3, 0.8))
            found.append(
                Obstacle.of(Cylinder(kind="cylinder", centre_ned_m=place, radius_m=radius, height_m=9.0))
            )
    return tuple(found)


def _flyable(pad: PadMotion, obstacles: tuple[Obstacle, ...]) -> bool:
    """Clear of the pad's way and of the start, with room between them, and in the straight way."""
    way = np.array([pad.at(t).position_ned_m for t in np.arange(0.0, FLOWN_S + 1.0, 0.25)])
    if clearance_m(way, obstacles).min() < PAD_CLEAR_M:
        return False
    if clearance_m(np.array([START_NED_M]), obstacles)[0] < START_CLEAR_M:
        return False
    for k, one in enumerate(obstacles):
        middle = np.array([[one.north_m, one.east_m, -1.0]])
        others = obstacles[:k] + obstacles[k + 1 :]
        if clearance_m(middle, others)[0] < BETWEEN_M + max(one.round_m, one.half_length_m):
            return False
    return not line_clear(START_NED_M, pad.at(PAD.meet.time_s).position_ned_m, obstacles, 0.3)


def disturbed(parameters: QuadrotorParameters, case: DisturbanceCase, seed: int) -> QuadrotorParameters:
    """The airframe that flies: mass and moments of inertia each off by up to a fifth, if the case says so."""
    rng = np.random.default_rng((seed, 20))
    mass, *inertia = (1.0 + rng.uniform(-MODEL_ERROR, MODEL_ERROR, 4)).tolist()
    if not case.model_error:
        return parameters
    x, y, z = (share * value for share, value in zip(inertia, parameters.inertia_kg_m2, strict=True))
    return parameters.model_copy(update={"mass_kg": mass * parameters.mass_kg, "inertia_kg_m2": (x, y, z)})


# ---------------------------------------------------------------- reference
# The reference of Fig. 14: minimum jerk to the moving pad, planned again every iteration (Algorithm 1).
#
# Each iteration starts from the reference's own state, so that its acceleration has no step and every
# controller gets the very same; the pad is taken to go on at its present velocity. The time to go is eq. 37's
# with the fuzzy speed. Where an obstacle is in the way the course goes by the points of the shortest way
# round. NED, SI.

ITERATION_S: Final = 0.1
MINIMUM_TIME_S: Final = 1.0  # T_min of eq. 37
FOLLOWED_AT_M: Final = 0.3  # legs and a hand's breadth over the pad: there the figure's tracking ends
LEAST_CLEAR_M: Final = 0.9  # of the reference from an obstacle
PLAN_MARGINS_M: Final = (1.0, 1.2, 1.4, 1.7, 2.0)
FASTEST_M_S: Final = 3.5
HARDEST_M_S2: Final = 3.0
ARRIVED_M: Final = 0.15
DIPS_M: Final = 0.04  # below the height at which it follows
ATTEMPTS: Final = 50
PASSED_S: Final = 0.3  # a point nearer in time than this is left behind


@dataclass(frozen=True)
class PlannedReference:
    """What was planned, iteration by iteration, from time 0."""

    courses: tuple[Course, ...]

    def _at(self, time_s: float) -> Course:
        return self.courses[min(max(int(time_s / ITERATION_S + 1e-6), 0), len(self.courses) - 1)]

    def at(self, time_s: float) -> Motion:
        """Where to be now; before time 0, at rest at the start."""
        return self._at(time_s).at(time_s)

    def rows(self, time_s: float, count: int, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities, accelerations (count, 3) from now on, as planned at the last iteration."""
        return self._at(time_s).rows(time_s, count, step_s)

    def path(self, step_s: float = 0.05) -> FloatArray:
        """Positions (n, 3) over the flight."""
        return np.array([self.at(t).position_m for t in np.arange(0.0, FLOWN_S, step_s)])


@lru_cache(maxsize=1)
def fuzzy_speed() -> SpeedTable:
    """The shipped rules' surface."""
    return load_table("landing")[0]


@dataclass
class _Plan:
    """Points still to go by, the time left for each leg, and the course of it."""

    via: list[Vector3]
    left_s: list[float]
    course: Course


def plan_reference(world: LandingScene) -> PlannedReference | None:
    """The whole reference of a world, or None if no way round its obstacles keeps clear of them."""
    motion, courses = Motion(START_NED_M), list[Course]()
    plan = _way_round(motion, _target(world, 0.0), 0.0, world.obstacles)
    for k in range(round(FLOWN_S / ITERATION_S)):
        now_s, pad = k * ITERATION_S, _target(world, k * ITERATION_S)
        if plan is not None:
            plan = _again(plan, motion, pad, now_s)
            if _clear_m(plan.course, world.obstacles) < LEAST_CLEAR_M:
                plan = _way_round(motion, pad, now_s, world.obstacles)
        if plan is None:
            return None
        courses.append(plan.course)
        motion = plan.course.at(now_s + ITERATION_S)
        plan.left_s[0] -= ITERATION_S
    return PlannedReference(tuple(courses))


def _again(plan: _Plan, motion: Motion, pad: Motion, now_s: float) -> _Plan:
    """The same way from where the reference is now, to where the pad goes now."""
    via, left = list(plan.via), list(plan.left_s)
    while via and left[0] < PASSED_S:
        via.pop(0)
        passed_s = left.pop(0)
        left[0] += passed_s
    left = _grown(left, motion, via, pad)
    return _Plan(via, left, through(motion, via, _met(pad, sum(left)), now_s, left))


def _way_round(motion: Motion, pad: Motion, now_s: float, obstacles: tuple[Obstacle, ...]) -> _Plan | None:
    """The way with the least margin whose rounded course keeps clear; the spline cuts and swings out."""
    for margin_m in PLAN_MARGINS_M:
        meeting = _met(pad, _time_to_go_s(motion, [], pad)).position_m
        points = route(motion.position_m, meeting, obstacles, margin_m)
        if points is None:
            continue
        left = _durations(motion, list(points), pad)
        course = through(motion, points, _met(pad, sum(left)), now_s, left)
        if _clear_m(course, obstacles) >= LEAST_CLEAR_M:
            return _Plan(list(points), left, course)
    return None


def _met(pad: Motion, after_s: float) -> Motion:
    return Motion(add(pad.position_m, scale(pad.velocity_m_s, after_s)), pad.velocity_m_s)


def _clear_m(course: Course, obstacles: tuple[Obstacle, ...]) -> float:
    count = 2 + int(course.duration_s / 0.1)
    rows = course.rows(course.start_s, count, course.duration_s / (count - 1))[0]
    return float(clearance_m(rows, obstacles).min())


def draw_scene(seed: int) -> tuple[LandingScene, PlannedReference]:
    """The first world of a seed that has a reference: round the obstacles, in time and not in a hurry.

    No controller has a say in what is drawn.

    Raises:
        RuntimeError: none is found.
    """
    for attempt in range(ATTEMPTS):
        world = draw_world(seed, attempt)
        reference = plan_reference(world)
        if reference is not None and _comfortable(reference, world):
            return world, reference
    raise RuntimeError(f"seed {seed}: no world with a reference in {ATTEMPTS} attempts")


def _comfortable(reference: PlannedReference, world: LandingScene) -> bool:
    """Arrived for the last 2 s, never faster or harder than a landing is flown, and nowhere too low."""
    motions = [reference.at(t) for t in np.arange(0.0, FLOWN_S, 0.1)]
    speed = max(norm(m.velocity_m_s) for m in motions)
    acceleration = max(norm(m.acceleration_m_s2) for m in motions)
    late = (reference.at(t).position_m for t in (FLOWN_S - 2.0, FLOWN_S - 0.1))
    pads = (_target(world, t).position_m for t in (FLOWN_S - 2.0, FLOWN_S - 0.1))
    away = max(math.dist(p, q) for p, q in zip(late, pads, strict=True))
    lowest_m = min(-m.position_m[2] for m in motions) - SURFACE_HEIGHT_M
    within = speed <= FASTEST_M_S and acceleration <= HARDEST_M_S2
    return within and away <= ARRIVED_M and lowest_m >= FOLLOWED_AT_M - DIPS_M


def closest_m(reference: PlannedReference, world: LandingScene) -> float:
    """How near the reference comes to an obstacle."""
    return float(clearance_m(reference.path(), world.obstacles).min())


def _target(world: LandingScene, time_s: float) -> Motion:
    pad = world.pad.at(time_s)
    return Motion(add(pad.position_ned_m, (0.0, 0.0, -FOLLOWED_AT_M)), pad.velocity_ned_m_s)


def _lengths(motion: Motion, via: list[Vector3], pad: Motion) -> list[float]:
    """Of the legs, as the pad's own motion leaves them to be flown."""
    return [math.dist(p, q) for p, q in pairwise([motion.position_m, *via, pad.position_m])]


def _time_to_go_s(motion: Motion, via: list[Vector3], pad: Motion) -> float:
    """T of eq. 37 along the way that is left."""
    distance_m = sum(_lengths(motion, via, pad))
    ahead = subtract(via[0] if via else pad.position_m, motion.position_m)
    unit = scale(ahead, 1.0 / max(norm(ahead), 1e-6))
    closing = dot(subtract(motion.velocity_m_s, pad.velocity_m_s), unit)
    speed = fuzzy_speed()(distance_m, closing, dot(motion.acceleration_m_s2, unit))
    return trajectory_time_s(distance_m, speed, MINIMUM_TIME_S)


def _durations(motion: Motion, via: list[Vector3], pad: Motion) -> list[float]:
    """T shared out among the legs by their lengths."""
    lengths = _lengths(motion, via, pad)
    time_s = _time_to_go_s(motion, via, pad)
    return [max(time_s * length / sum(lengths), PASSED_S) for length in lengths]


def _grown(left: list[float], motion: Motion, via: list[Vector3], pad: Motion) -> list[float]:
    """The times left, longer where eq. 37 now asks for more: never shorter, so that it arrives."""
    factor = max(1.0, _time_to_go_s(motion, via, pad) / sum(left)) if not via else 1.0
    return [factor * duration for duration in left]
