"""The reference generator: one minimum-jerk trajectory in one frame, replanned from its own state.

Replanning starts from the previous reference and not from the vehicle: position, velocity and acceleration
stay continuous, and the estimate's noise does not enter them. Only if the vehicle is too far from the
reference does planning start from the estimate again.

T = |Δ| / V + T_min (eq. 37) with V from the fuzzy controller; T is lengthened until the path keeps its
limits of speed and acceleration. Planning uses the frame that moves with the target, in which the end is at
rest (eqs. 29, 30). Frames, NED axes: positions are relative to the pad ("pad") or to the EKF's origin
("local"). m, s, rad.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, Literal

from companion.base.geometry import ZERO3, Vector3, add, dot, norm, scale, subtract, wrap_angle
from companion.base.messages import DescentCone, LevelOff, Reference
from companion.base.motion import Motion
from companion.config import GuidanceConfig, PlanConfig
from companion.plan.debounce import StepClock
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.coordinate_frames import STILL
from companion.plan.trajectory.course import CHECKED, Course, PlannedPath, stretched
from companion.plan.trajectory.min_jerk import (
    HARD_STOP_M_S2,
    REST_PEAK,
    Trajectory,
    brake,
    carried,
    plan,
    trajectory_time_s,
)

RESET_DISTANCE_M: Final = 0.8  # reference to estimate: beyond it the reference starts afresh

ReferenceFrame = Literal["pad", "local"]
SpeedLaw = Callable[[float, float, float], float]

_MAX_OVERSHOOT_M = 0.3
# The climb that begins a break-off close to the pad.
_RISES_M_S = 0.3
_RISES_WITHIN_S = 0.3
_TOO_LOW_M = 0.15
SAME_POINT_M: Final = 0.5


class ReferenceGenerator:
    """Holds the reference and moves it on. Before `start` there is none."""

    def __init__(
        self,
        config: GuidanceConfig,
        law: SpeedLaw,
        horizon_steps: int,
        step_s: float,
        avoidance: Avoidance | None = None,
    ) -> None:
        self.limits, self._law = config, law
        self.pace = 1.0  # factor on V
        self.avoidance = avoidance or Avoidance(PlanConfig(), 0.0)
        self._count, self._step_s = horizon_steps + 1, step_s
        self.origin: ReferenceFrame = "local"
        self._trajectory: PlannedPath | None = None
        self._pad = STILL
        self._level: Trajectory | None = None
        self._aside: Course | None = None
        self._rise: Trajectory | None = None
        self.heading_rad = 0.0
        self._turning = StepClock()
        self.speed_m_s = 0.0
        self.time_to_go_s = 0.0

    @property
    def active(self) -> bool:
        return self._trajectory is not None

    def at(self, now_s: float) -> Motion:
        """The reference's own state now.

        Raises:
            RuntimeError: there is no reference.
        """
        if self._trajectory is None:
            raise RuntimeError("no reference yet: start one first")
        motion = self._trajectory.at(now_s)
        if self._aside is not None:
            motion = _with_down(self._aside.at(now_s), motion)
        return motion if self._level is None else _with_down(motion, self._level.at(now_s))

    @property
    def end_s(self) -> float:
        """When the present trajectory ends, whatever levelling off there is; inf without one."""
        return math.inf if self._trajectory is None else self._trajectory.end_s

    def resting_place_m(self) -> Vector3:
        """Where the reference ends, if there is one."""
        ends_s = [t.end_s for t in (self._trajectory, self._level) if t is not None]
        return self.at(max(ends_s, default=math.inf)).position_m

    def start(self, origin: ReferenceFrame, motion: Motion, now_s: float) -> None:
        """Begin afresh at a state, coming to rest in the frame."""
        self.origin = origin
        self._look_from_frame()
        self.rest(motion, now_s)

    def rest(self, motion: Motion, now_s: float) -> None:
        self._follow(self.avoidance.brake(motion, now_s), now_s)

    def stop(self) -> None:
        """Give the reference up: no setpoint leaves any more."""
        self._trajectory = None
        self.speed_m_s = self.time_to_go_s = 0.0

    def change_frame(self, origin: ReferenceFrame, pad: Motion, now_s: float) -> None:
        """Go on in the other frame with the same motion in space; `pad` is the pad in the EKF's NED."""
        if self.origin == origin:
            return
        combine = subtract if origin == "pad" else add
        now = self.at(now_s)
        motion = Motion(
            combine(now.position_m, pad.position_m),
            combine(now.velocity_m_s, pad.velocity_m_s),
            combine(now.acceleration_m_s2, pad.acceleration_m_s2),
        )
        self.start(origin, motion, now_s)

    def keep_near(self, actual: Motion, now_s: float) -> float:
        """Take the estimate up when the reference is too far from it; returns how far (m), else 0."""
        distance_m = norm(subtract(self.at(now_s).position_m, actual.position_m))
        if distance_m <= RESET_DISTANCE_M:
            return 0.0
        self.take_up(actual, now_s)
        return distance_m

    def take_up(self, actual: Motion, now_s: float) -> None:
        """Put the reference onto the estimate; its acceleration goes on, and so does a climb of its own.

        A vehicle that the wind blows off its way is not kept low by it.
        """
        before, level = self.at(now_s), self._level
        self.rest(Motion(actual.position_m, actual.velocity_m_s, before.acceleration_m_s2), now_s)
        if abs(actual.position_m[2] - before.position_m[2]) <= RESET_DISTANCE_M:
            self._level = level

    def see(self, home_ned_m: Vector3 | None, pad: Motion | None) -> None:
        """Take in where home is, from which obstacles count, and how the pad moves; EKF's NED."""
        if home_ned_m is not None:
            self.avoidance.home_ned_m = home_ned_m
        if pad is not None:
            self._pad = pad
            self._look_from_frame()

    def fly_along(self, points: Sequence[Vector3], now_s: float) -> None:
        """Through points of the EKF's NED by minimum jerk, round what is between them; the last is a halt.

        A course that was begun is kept while it is clear: the points passed may be left out next time.
        """
        flown = self._trajectory
        if isinstance(flown, Course):
            same = math.dist(flown.at(flown.end_s).position_m, points[-1]) <= SAME_POINT_M
            if same and self.avoidance.keeps_clear(flown, now_s, self.avoidance.frame):
                self.time_to_go_s = max(0.0, flown.end_s - now_s)
                return
        course = self.avoidance.along(self.at(now_s), points, now_s)
        if course is None:
            # held as it is: `rest` would forget that there is no way
            self._trajectory, self._level = self.avoidance.stop(self.at(now_s), now_s), None
            self._aside = None
            return
        self._follow(course, now_s)

    def fly_to(self, target: Motion, now_s: float) -> None:
        """Replan towards a point that moves on as it does, by eqs. 37 and 29, clear of obstacles.

        A `rise` is flown to its end first.
        """
        if not self.rising(now_s):
            self._fly_to(target, now_s, level=False)

    def _fly_to(self, target: Motion, now_s: float, *, level: bool) -> None:
        start = self.at(now_s)
        offset = subtract(target.position_m, start.position_m)
        closing = subtract(start.velocity_m_s, target.velocity_m_s)
        distance = norm(offset)
        unit = scale(offset, 1.0 / distance) if distance > 1e-6 else (0.0, 0.0, 0.0)
        gaining = subtract(start.acceleration_m_s2, target.acceleration_m_s2)
        speed = self.pace * self._law(distance, dot(closing, unit), dot(gaining, unit))
        moving = Motion(scale(offset, -1.0), closing, gaining)
        duration_s = trajectory_time_s(distance, speed, self.limits.minimum_time_s)
        relative = stretched(
            lambda share: plan(moving, Motion(ZERO3), now_s, share * duration_s), self.limits
        )
        direct = carried(relative, target, now_s)
        way = self.avoidance.way(
            direct, target, now_s, level=level, may_wait=self.origin == "pad" and not level
        )
        # a way round obstacles has its heights for a reason, and goes on in the next cycle
        self._level = self._between_ends(direct, start, target, now_s) if way is direct else None
        self._aside = None
        self._trajectory = way
        self.speed_m_s = speed
        self.time_to_go_s = relative.duration_s if way is direct else max(0.0, way.end_s - now_s)

    def _between_ends(
        self, way: Trajectory, start: Motion, target: Motion, now_s: float
    ) -> Trajectory | None:
        """Levelling off first, where the way would sink below both its ends or rise above both; else None.

        A long way from a state that sinks or climbs, or is about to, ends at rest but goes on for metres: and
        planned anew from there it is longer still. So is a stop that is: what was begun is kept
        while it ends nearer than the way's farthest. No climb over an obstacle is meant, where the way is
        free for a cycle.
        """
        z, goal, step_s = start.position_m[2], target.position_m[2], (way.end_s - now_s) / CHECKED
        over_something = isinstance(self._trajectory, Course)
        beyond_m = 0.0
        for after_s in (k * step_s for k in range(1, CHECKED)):
            there = way.at(now_s + after_s).position_m[2]
            goal_then = goal + target.velocity_m_s[2] * after_s
            above_m = 0.0 if over_something else min(z, goal, goal_then) - there
            beyond_m = max(beyond_m, there - max(z, goal, goal_then), above_m)
        level = self._level
        if level is None or now_s >= level.end_s:
            if beyond_m <= _MAX_OVERSHOOT_M:
                return None
            level = brake(_upright(start), now_s, HARD_STOP_M_S2)
        stopped_m = abs(level.at(level.end_s).position_m[2] - z)
        return level if stopped_m < beyond_m else None

    def fly_level(self, target: Motion, lowest_down_m: float, now_s: float) -> float:
        """As `fly_to`, but the height is kept: any climb or sink is stopped, at once and by itself.

        Once it does not sink, it climbs to `lowest_down_m` (of the present frame) if it is lower than that;
        returns the climb (m) that begins with this cycle, else 0. A `rise` is flown to its end first.
        """
        if self.rising(now_s):
            return 0.0
        climb_m = 0.0
        start, level = self.at(now_s), self._level
        x, y, _ = target.position_m
        (vx, vy, _), (ax, ay, _) = target.velocity_m_s, target.acceleration_m_s2
        self._fly_to(Motion((x, y, start.position_m[2]), (vx, vy, 0.0), (ax, ay, 0.0)), now_s, level=True)
        z, upright = start.position_m[2], _upright(start)
        too_low = z - lowest_down_m > _TOO_LOW_M
        rises = level is None and start.velocity_m_s[2] < 0.0
        if too_low and (rises or (level is not None and now_s >= level.end_s)):
            climb_m = z - lowest_down_m
            duration_s = self.limits.minimum_time_s + REST_PEAK * climb_m / self.limits.vertical_speed_m_s
            level = plan(upright, Motion((0.0, 0.0, lowest_down_m)), now_s, duration_s)
        elif level is None:
            level = brake(upright, now_s, HARD_STOP_M_S2)
        self._level = level
        return climb_m

    def sink(self, speed_m_s: float, blend_s: float, now_s: float, *, leads: bool = False) -> float:
        """From here straight down to a constant speed that goes on; returns how far (m) the blend takes.

        leads: it goes on aside as `lead` has it.
        """
        start = self.at(now_s)
        depth_m = 0.5 * (start.velocity_m_s[2] + speed_m_s) * blend_s
        final = Motion((0.0, 0.0, start.position_m[2] + depth_m), (0.0, 0.0, speed_m_s))
        aside = self._aside if leads else None
        self._follow(plan(start, final, now_s, blend_s), now_s)
        self._aside = aside
        self.speed_m_s = speed_m_s
        return depth_m

    def lead(self, course: Course) -> None:
        """From here aside by a course of its own, until something else is planned; the height goes on."""
        self._aside = course

    def rise(self, now_s: float) -> None:
        """Come to a climb at once, straight up from where the reference goes; `fly_to` goes on from there.

        A smooth way from a sink to somewhere above begins by sinking on.
        """
        start, half_s = self.at(now_s), 0.5 * _RISES_WITHIN_S
        (x, y, z), (vx, vy, vz) = start.position_m, start.velocity_m_s
        if vz <= -_RISES_M_S:
            return  # with a deck that rises it climbs faster as it is
        place = (x + half_s * vx, y + half_s * vy, z + half_s * (vz - _RISES_M_S))
        self._rise = plan(start, Motion(place, (0.0, 0.0, -_RISES_M_S)), now_s, _RISES_WITHIN_S)
        self._follow(self._rise, now_s)

    def rising(self, now_s: float) -> bool:
        """Whether the climb that `rise` began still lasts."""
        rise = self._rise
        return rise is not None and self._trajectory is rise and now_s < rise.end_s

    def shift_down(self, depth_m: float) -> None:
        """Move the reference down as a whole; its speed and acceleration stay."""
        if isinstance(self._trajectory, Trajectory):
            x, y, (place, *rest) = self._trajectory.axes
            z = (place + depth_m, rest[0], rest[1], rest[2], rest[3], rest[4])
            self._trajectory = replace(self._trajectory, axes=(x, y, z))

    def turn(self, heading_rad: float | None, now_s: float, pad_rate_rad_s: float = 0.0) -> None:
        """Slew the heading towards one, or keep it; a turning pad is caught up with at the rate allowed."""
        elapsed_s = self._turning.step_s(now_s)
        if heading_rad is not None:
            most = (math.radians(self.limits.heading_rate_deg_s) + abs(pad_rate_rad_s)) * elapsed_s
            error = wrap_angle(heading_rad - self.heading_rad)
            self.heading_rad = wrap_angle(self.heading_rad + max(-most, min(most, error)))

    def reference(
        self,
        now_s: float,
        *,
        minimum_height_m: float | None = None,
        cone: DescentCone | None = None,
        level_off: LevelOff | None = None,
    ) -> Reference | None:
        """The rows over the horizon, (horizon_steps + 1, 3) each, and the bounds that go with them."""
        if self._trajectory is None:
            return None
        rows = self._trajectory.rows(now_s, self._count, self._step_s)
        if self._aside is not None:
            sideways = self._aside.rows(now_s, self._count, self._step_s)
            for row, horizontal in zip(rows, sideways, strict=True):
                row[:, :2] = horizontal[:, :2]
        if self._level is not None:
            upright = self._level.rows(now_s, self._count, self._step_s)
            for row, vertical in zip(rows, upright, strict=True):
                row[:, 2] = vertical[:, 2]
        return Reference(
            now_s, self.origin, self._step_s, *rows, self.heading_rad, minimum_height_m, cone, level_off
        )

    def _look_from_frame(self) -> None:
        self.avoidance.frame = self._pad if self.origin == "pad" else STILL

    def _follow(self, trajectory: PlannedPath, now_s: float) -> None:
        self.avoidance.forget()
        self._trajectory, self._level, self._aside = trajectory, None, None
        self.speed_m_s, self.time_to_go_s = 0.0, max(0.0, trajectory.end_s - now_s)


def _upright(motion: Motion) -> Motion:
    """The vertical part of a motion alone."""
    z, rate, change = (m[2] for m in (motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2))
    return Motion((0.0, 0.0, z), (0.0, 0.0, rate), (0.0, 0.0, change))


def _with_down(motion: Motion, vertical: Motion) -> Motion:
    """A motion whose third axis is another's."""
    (x, y, _), (vx, vy, _), (ax, ay, _) = motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2
    z, vz, az = vertical.position_m[2], vertical.velocity_m_s[2], vertical.acceleration_m_s2[2]
    return Motion((x, y, z), (vx, vy, vz), (ax, ay, az))
