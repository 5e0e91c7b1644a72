"""Obstacle avoidance: each planned trajectory is checked over its whole length and replaced if necessary.

The reference generator plans without obstacles. Its trajectory is flown if it keeps the margin up to its
end and for the time that a stop takes after it. Otherwise a detour goes around or over the obstacles by the
shortest route: smooth if that keeps the margin, else with stops at its corners. Without any detour the
vehicle brakes and holds (`blocked`). Over a pad that is too near to an obstacle it follows at a greater
height (`waiting`).

Obstacles stand still and the pad moves: clearance is checked in the EKF's NED, with the pad predicted along
its arc, and the result is returned in the reference's frame. Obstacles are relative to home and not to the
EKF's origin, so that surveyed positions do not move with an estimate. m, s.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from companion.base.geometry import FloatArray, Vector3, add, norm, scale, subtract
from companion.base.motion import Motion
from companion.config import GuidanceConfig, PlanConfig
from companion.plan.events import Announcements, NoticeSeverity
from companion.plan.obstacles.obstacles import (
    Obstacle,
    clearance_m,
    line_clear,
    nearest_free,
    prepare,
    route,
    way_cost,
)
from companion.plan.trajectory.coordinate_frames import STILL, in_space, predicted_places, space_seen_from
from companion.plan.trajectory.course import Course, PlannedPath, halting, paced
from companion.plan.trajectory.min_jerk import HARD_STOP_M_S2, Trajectory, brake, carried, stop_s

# Corners are first passed with this much spare room, so that a smooth curve fits.
_SPARES_M: Final = (0.5, 0.25, 0.05)
# Planning a detour is expensive: not in every cycle.
_THINK_AGAIN_S: Final = 0.2
_THINK_AGAIN_SHARE: Final = 0.1
_LONGEST_LEAD_S: Final = 4.0
_NEAR_M: Final = 1.0
# A detour is left for a straight trajectory that arrives no later than this.
_LATER_S: Final = 2.0
# Spare room may lengthen a detour by this factor; the other side must be shorter by that one.
_WORTH_ROOM: Final = 1.1
_WORTH_TURNING: Final = 1.3
_WORTH_M: Final = 1.0
_CHECK_STEP_S: Final = 0.1
# The far part of a longer trajectory is checked in as many coarse steps, and closely once it is near.
_MOST_CHECKS: Final = 300
# A detour is kept while its end is this near to where the target will be.
_SAME_END: Final = 0.3  # m, and m/s
_SLACK: Final = 0.01  # m, and m/s
# Waiting over a pad, so much higher than the margin asks for.
_ABOVE_M: Final = 0.1
_TELL_AGAIN_S: Final = 2.0
Situation = Literal["blocked", "waiting_over", "detour", "clear"]
_WORDS: Final[dict[Situation, str]] = {
    "blocked": "no clear path past the obstacles: holding",
    "waiting_over": "pad too near to an obstacle: waiting over it",
    "detour": "obstacle ahead: flying round it",
    "clear": "clear of the obstacles again",
}

_Corners = tuple[tuple[float, Vector3], ...]  # of a detour: when they are passed, and where in space
_Detour = tuple[Course, _Corners]


@dataclass(frozen=True, slots=True)
class _Stop:
    """A stop that is flown: in space, where it was checked, and as last seen from the reference's frame.

    It is a commitment. A quintic planned anew in each cycle never comes to its hard middle: it ends farther
    on than what was checked.
    """

    in_space: Trajectory
    seen: Trajectory


@dataclass(frozen=True, slots=True)
class _Flown:
    """What the obstacles make of the path, and the detour that is flown for it."""

    situation: Situation = "clear"
    detour: Course | None = None
    corners: _Corners = ()  # of the last detour: the side that was begun is not left for little
    think_again_s: float = -math.inf  # no sooner than then, unless the detour that is flown fails
    stop: _Stop | None = None  # while there is no way


class Avoidance:
    """The obstacles and the detour that is flown. Without obstacles it changes nothing."""

    def __init__(self, config: PlanConfig, vehicle_radius_m: float) -> None:
        self._obstacles = tuple(Obstacle.of(shape) for shape in config.obstacles)
        self._margin_m = config.obstacle_margin_m + vehicle_radius_m
        for spare_m in _SPARES_M:
            prepare(self._obstacles, self._margin_m + spare_m)
        self._ceiling_down_m = -config.obstacle_ceiling_m
        self._limits: GuidanceConfig = config.guidance
        self.home_ned_m: Vector3 | None = None  # in the EKF's NED, from where the obstacles count
        self.frame = STILL  # how the reference's frame moves in the EKF's NED
        self._flown = _Flown()

    @property
    def needed(self) -> bool:
        """Whether there are obstacles, and home is known."""
        return bool(self._obstacles) and self.home_ned_m is not None

    @property
    def lost(self) -> bool:
        """Whether there are obstacles, but it is not known where: none of them would be kept clear of."""
        return bool(self._obstacles) and self.home_ned_m is None

    def forget(self) -> None:
        """Drop the detour: a new reference begins."""
        self._flown = _Flown()

    def way(
        self,
        direct: Trajectory,
        target: Motion,
        now_s: float,
        *,
        level: bool = False,
        may_wait: bool = False,
    ) -> PlannedPath:
        """What to fly instead of a direct trajectory to a moving target, all in the reference's frame.

        Args:
            direct: what was planned, from the reference's state now.
            target: where it leads, now, and its velocity.
            level: only round, at the present height, never over.
            may_wait: over the target but higher, where it cannot be had itself, is good enough for now.
        """
        if not self.needed:
            return direct
        start, kept = direct.at(now_s), self._flown.detour
        late = kept is not None and direct.end_s > max(now_s, kept.end_s) + _LATER_S
        if not late and self.keeps_clear(direct, now_s, self.frame):
            self.forget()
            return direct
        if kept is not None and not (
            _on(kept, start, now_s, level=level) and self.keeps_clear(kept, now_s, self.frame)
        ):
            kept = None
        if kept is not None and (now_s < self._flown.think_again_s or _leads_to(kept, target, now_s)):
            return kept
        if not self._still_blocked(now_s):
            found = self._round(start, target, now_s, level)
            waits = found is None and may_wait
            if waits:
                found = self._over(start, target, now_s)
            if found is None and kept is not None and now_s < kept.end_s:
                found = kept, self._flown.corners
            if found is None:
                self._block(now_s)
            else:  # what takes long is planned less often
                pause_s = max(_THINK_AGAIN_S, _THINK_AGAIN_SHARE * (found[0].end_s - now_s))
                self._flown = _Flown("waiting_over" if waits else "detour", *found, now_s + pause_s)
        return self._flown.detour or self.stop(start, now_s, level=level)

    def along(self, start: Motion, points: Sequence[Vector3], now_s: float) -> Course | None:
        """Through points in space, round what is between them; None when there is no way that keeps clear."""
        if self._still_blocked(now_s):
            return None
        places = [start.position_m, *points]
        for via in self._roomy(places):
            for pace in (paced, halting):
                course = pace(start, via, Motion(points[-1]), now_s, self._limits)
                if self.keeps_clear(course, now_s, STILL):
                    return course
        self._block(now_s)
        return None

    def brake(self, start: Motion, now_s: float) -> Trajectory:
        """Come to rest in the reference's frame, as gently as that keeps clear."""
        return self._braked(start, self.frame, now_s)

    def stop(self, start: Motion, now_s: float, *, level: bool = False) -> Trajectory:
        """Come to rest in space, seen from the reference's frame, while there is no way that keeps clear.

        Once begun it is flown on, until another one keeps clear and it does not.
        """
        flown = self._flown.stop
        kept = flown.in_space if flown is not None and _on(flown.seen, start, now_s, level=level) else None
        if kept is None or not self.keeps_clear(kept, now_s, STILL):
            again = self._braked(in_space(start, self.frame), STILL, now_s)
            kept = again if kept is None or self.keeps_clear(again, now_s, STILL) else kept
        seen = carried(kept, space_seen_from(self.frame), now_s)
        self._flown = replace(self._flown, stop=_Stop(kept, seen))
        return seen

    def straight_clear(self, start: Vector3, goal_from_home_m: Vector3) -> bool:
        """Whether the straight line from a point in space to a place that counts from home keeps clear."""
        if not self.needed:
            return True
        assert self.home_ned_m is not None
        return line_clear(subtract(start, self.home_ned_m), goal_from_home_m, self._obstacles, self._margin_m)

    def free_for(self, place: Vector3, duration_s: float) -> bool:
        """Whether a place in the reference's frame, going with it, stays clear for so long."""
        if not self.needed:
            return True
        times_s = np.arange(0.0, duration_s + _CHECK_STEP_S, _CHECK_STEP_S)
        points = np.array(place) + predicted_places(self.frame, times_s)
        return bool(np.min(self._clearance_m(points)) >= self._margin_m)

    @property
    def situation(self) -> Situation:
        return self._flown.situation

    @property
    def blocked(self) -> bool:
        return self.situation == "blocked"

    def _still_blocked(self, now_s: float) -> bool:
        return self.blocked and now_s < self._flown.think_again_s

    def _block(self, now_s: float) -> None:
        think_again_s = now_s + _THINK_AGAIN_S
        self._flown = _Flown("blocked", None, self._flown.corners, think_again_s, self._flown.stop)

    def tell(self, say: Announcements, now_s: float) -> None:
        """Announce a detour, that there is none, and when the path is straight again; call it every cycle."""
        severity: NoticeSeverity = "warning" if self.situation in {"blocked", "waiting_over"} else "info"
        words = _WORDS[self.situation]
        say.change("obstacles", self.situation, words, now_s, _TELL_AGAIN_S, severity)

    # ------------------------------------------------------------ judging

    def keeps_clear(self, way: PlannedPath, now_s: float, frame: Motion) -> bool:
        """Whether a way in a frame keeps the margin to its stop; from within it, never nearer than it got."""
        if not self.needed:
            return True
        last = in_space(way.at(way.end_s), frame)
        after_s = stop_s(norm(last.velocity_m_s), self._limits.horizontal_acceleration_m_s2)
        whole_s = max(_CHECK_STEP_S, way.end_s - now_s) + after_s
        close_s = min(whole_s, _MOST_CHECKS * _CHECK_STEP_S)
        points = [_places(way, frame, now_s, 0.0, close_s)]
        if whole_s > close_s:
            points.append(_places(way, frame, now_s, close_s, whole_s))
        clearance = self._clearance_m(np.concatenate(points))
        least_m = np.minimum(self._margin_m, np.maximum.accumulate(clearance)) - _SLACK
        return bool(np.all(clearance >= least_m))

    def _clearance_m(self, points: FloatArray) -> FloatArray:
        assert self.home_ned_m is not None
        return clearance_m(points - np.array(self.home_ned_m), self._obstacles)

    # ------------------------------------------------------------ finding a way

    def _round(self, start: Motion, target: Motion, now_s: float, level: bool) -> _Detour | None:
        """A way round or over, in the reference's frame."""
        start, target = in_space(start, self.frame), in_space(target, self.frame)
        met = target.position_m
        for _ in range(2):  # where the target is met depends on the way there
            ways = self._ways(start.position_m, met, now_s, level)
            if not ways:
                return None
            time_s = paced(start, ways[0], target, now_s, self._limits).duration_s
            if time_s > _LONGEST_LEAD_S and self.frame is STILL:
                # its motion can be predicted for a while only
                target = Motion(add(target.position_m, scale(target.velocity_m_s, _LONGEST_LEAD_S)))
                met, time_s = target.position_m, 0.0
            met = add(target.position_m, scale(target.velocity_m_s, time_s))
        for via in self._ways(start.position_m, met, now_s, level):
            for pace in (paced, halting):
                found = pace(start, via, target, now_s, self._limits)
                if self.keeps_clear(found, now_s, STILL):
                    corners = tuple((leg.end_s, c) for leg, c in zip(found.legs, via, strict=False))
                    return found.carried(space_seen_from(self.frame), now_s), corners
        return None

    def _ways(self, here: Vector3, there: Vector3, now_s: float, level: bool) -> list[list[Vector3]]:
        """The points of the ways worth a try, the roomiest first; one begun is not left for little."""
        ways = self._roomy((here, there), level=level)
        if not ways:
            return []
        shortest = min(way_cost((here, *via, there)) for via in ways)
        ahead = next(
            (c for when_s, c in self._flown.corners if when_s > now_s and math.dist(c, here) > _NEAR_M), None
        )
        begun = None if ahead is None else self._via((here, ahead, there), _SPARES_M[-1], level=level)
        if begun is not None and way_cost((here, *begun, there)) <= _WORTH_TURNING * shortest + _WORTH_M:
            return [begun, *ways]
        return ways

    def _roomy(self, places: Sequence[Vector3], *, level: bool = False) -> list[list[Vector3]]:
        """The points between the first place and the last by as much room as is worth the way, most first."""
        found = [self._via(places, spare_m, level=level) for spare_m in _SPARES_M]
        ways = [via for via in found if via is not None]
        costs = [way_cost((places[0], *via, places[-1])) for via in ways]
        most = _WORTH_ROOM * min(costs, default=0.0) + _WORTH_M
        return [via for via, cost in zip(ways, costs, strict=True) if cost <= most]

    def _over(self, start: Motion, target: Motion, now_s: float) -> _Detour | None:
        """To over the target: no lower than now, or higher up, or else as near as it may."""
        assert self.home_ned_m is not None
        here, home_down = start.position_m[2] + self.frame.position_m[2], self.home_ned_m[2]
        tops = {home_down + o.top_down_m - self._margin_m - _ABOVE_M for o in self._obstacles}
        higher = sorted((t for t in tops if home_down + self._ceiling_down_m <= t < here), reverse=True)
        for down in (here, *higher):
            north, east, _ = target.position_m
            raised = Motion((north, east, down - self.frame.position_m[2]), target.velocity_m_s)
            found = self._round(start, raised, now_s, level=False)
            if found is not None:
                return found
        return self._beside(start, target, now_s)

    def _beside(self, start: Motion, target: Motion, now_s: float) -> _Detour | None:
        """To the place nearest to over the target that is clear, at the present height: it stays in view."""
        assert self.home_ned_m is not None
        target = in_space(target, self.frame)
        north, east, _ = add(target.position_m, scale(target.velocity_m_s, _THINK_AGAIN_S))
        down = start.position_m[2] + self.frame.position_m[2]
        over = subtract((north, east, down), self.home_ned_m)
        free = nearest_free(over, self._obstacles, self._margin_m + _ABOVE_M)
        if free is None:
            return None
        place = subtract(add(free, self.home_ned_m), self.frame.position_m)
        return self._round(start, Motion(place, scale(self.frame.velocity_m_s, -1.0)), now_s, level=True)

    def _via(self, places: Sequence[Vector3], spare_m: float, *, level: bool = False) -> list[Vector3] | None:
        """The points between the first place and the last, those on the way round included."""
        if not self.needed:
            return list(places[1:-1])
        assert self.home_ned_m is not None
        ceiling = None if level else self._ceiling_down_m
        from_home = [subtract(place, self.home_ned_m) for place in places]
        margin_m = self._margin_m + spare_m
        here_m = from_home[:1]
        if spare_m != _SPARES_M[-1] and clearance_m(np.array(here_m), self._obstacles)[0] < margin_m:
            return None  # it would go out sideways first, where less room is enough
        via: list[Vector3] = []
        for here, there in pairwise(from_home):
            corners = route(here, there, self._obstacles, margin_m, ceiling_down_m=ceiling)
            if corners is None:
                return None
            via += [*(add(corner, self.home_ned_m) for corner in corners), add(there, self.home_ned_m)]
        return via[:-1]

    def _braked(self, start: Motion, frame: Motion, now_s: float) -> Trajectory:
        """Come to rest in a frame; harder where the gentle stop comes too near."""
        stop = brake(start, now_s, self._limits.horizontal_acceleration_m_s2)
        for deceleration in (HARD_STOP_M_S2, 1.5 * HARD_STOP_M_S2):  # the last is taken anyway
            if self.keeps_clear(stop, now_s, frame):
                break
            stop = brake(start, now_s, deceleration)
        return stop


def _places(way: PlannedPath, frame: Motion, now_s: float, from_s: float, to_s: float) -> FloatArray:
    """Where a way in a frame leads in space from one time after now to another, (n, 3)."""
    count = min(_MOST_CHECKS, 1 + math.ceil((to_s - from_s) / _CHECK_STEP_S)) + 1
    step_s = (to_s - from_s) / (count - 1)
    points = way.rows(now_s + from_s, count, step_s)[0]
    if frame is not STILL:
        points += predicted_places(frame, from_s + step_s * np.arange(count, dtype=float))
    return points


def _on(course: PlannedPath, start: Motion, now_s: float, *, level: bool) -> bool:
    """Whether the reference is on a course still: levelling off takes its height elsewhere, and may."""
    there, axes = course.at(now_s), 2 if level else 3
    near = math.dist(there.position_m[:axes], start.position_m[:axes]) <= _SLACK
    return near and math.dist(there.velocity_m_s[:axes], start.velocity_m_s[:axes]) <= _SLACK


def _leads_to(course: Course, target: Motion, now_s: float) -> bool:
    """Whether a course still ends where the target will be then."""
    end_s = max(now_s, course.end_s)
    end = course.at(end_s)
    wanted = add(target.position_m, scale(target.velocity_m_s, end_s - now_s))
    near = math.dist(end.position_m, wanted) <= _SAME_END
    return near and math.dist(end.velocity_m_s, target.velocity_m_s) <= _SAME_END
