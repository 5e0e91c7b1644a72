"""Driven paths: waypoints with rounded corners, or random turns.

Both are sequences of segments (`sitl.pad.curves.PathSegment`), so that speed, course, acceleration and rate
of turn are all continuous, and bounded. NED, SI; courses clockwise from north.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import chain, cycle, pairwise
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from companion.base.geometry import ZERO3, Vector3, wrap_angle
from companion.config import StrictModel
from sitl.pad.curves import Path, PathPoint, PathSegment, segment_point
from sitl.pad.paths import Angle, Meeting, Metres, drawn_angle

Seconds = Annotated[float, Field(ge=0.5, le=60.0)]
Point = tuple[Metres, Metres]
DRIVES_FOR_S: Final = 1000.0
SHARPEST_CORNER_DEG: Final = 150.0
CLOSEST_M: Final = 0.1
# of the acceleration's bound, so that both together keep it
SIDEWAYS_SHARE: Final = 0.8
LENGTHWISE_SHARE: Final = 0.6
# a bend's rate of turn and acceleration rise and fall as 1 - cos: their peak is twice their mean
PEAK_OVER_MEAN: Final = 2.0


class RandomTurnsMotion(StrictModel):
    """Random turns and speed changes; beyond the radius, back to the middle."""

    kind: Literal["random_turns"]
    speed_m_s: float = Field(gt=0.0, le=10.0, description="Highest speed, through random turns")
    slowest_m_s: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None, description="Lowest speed; none: the speed is constant"
    )
    max_turn_rate_deg_s: float = Field(default=20.0, gt=0.0, le=90.0, description="Largest turn rate")
    max_acceleration_m_s2: float = Field(
        default=1.5,
        gt=0.05,
        le=10.0,
        description="Largest acceleration, of turning, speeding up and slowing down together",
    )
    arc_s: tuple[Seconds, Seconds] = Field(default=(2.0, 5.0), description="Shortest and longest arc")
    radius_m: float = Field(
        default=12.0, ge=2.0, le=200.0, description="Distance from the start beyond which it turns back"
    )
    course_deg: Angle = Field(default="random", description="First course")
    meet: Meeting = Meeting()

    @model_validator(mode="after")
    def _in_order(self) -> RandomTurnsMotion:
        if self.arc_s[0] > self.arc_s[1]:
            raise ValueError(f"arc_s is {list(self.arc_s)}; expected the shortest first, then the longest")
        if self.slowest_m_s is not None and self.slowest_m_s > self.speed_m_s:
            raise ValueError(
                f"slowest_m_s is {self.slowest_m_s:g}; expected at most speed_m_s, {self.speed_m_s:g}"
            )
        return self

    def path(self, rng: np.random.Generator) -> Path:
        """Segments from the origin at time 0."""
        return drive(self._segments(rng))

    def _segments(self, rng: np.random.Generator) -> Iterator[PathSegment]:
        place = PathPoint(ZERO3, ZERO3, ZERO3, drawn_angle(self.course_deg, rng), 0.0)
        speed = self.speed_m_s
        while True:
            turn, length_s = self._turn(place, speed, rng)
            reach = LENGTHWISE_SHARE * self.max_acceleration_m_s2 * length_s / PEAK_OVER_MEAN
            slowest = self.slowest_m_s
            wanted = speed if slowest is None else float(rng.uniform(slowest, self.speed_m_s))
            after = speed + max(-reach, min(reach, wanted - speed))
            segment = PathSegment(place.position_ned_m, place.course_rad, turn, length_s, speed, after)
            yield segment
            place, speed = segment_point(segment, length_s), after

    def _turn(self, place: PathPoint, speed_m_s: float, rng: np.random.Generator) -> tuple[float, float]:
        """Angle (rad) and duration (s) of the next segment: random, or towards the middle."""
        sideways = SIDEWAYS_SHARE * self.max_acceleration_m_s2
        # the bend may speed up meanwhile, so its fastest counts
        limit = min(math.radians(self.max_turn_rate_deg_s), sideways / max(speed_m_s, self.speed_m_s))
        rate, length_s = float(rng.uniform(-limit, limit)), float(rng.uniform(*self.arc_s))
        north, east, _ = place.position_ned_m
        if math.hypot(north, east) <= self.radius_m:
            return rate * length_s / PEAK_OVER_MEAN, length_s
        home = wrap_angle(math.atan2(-east, -north) - place.course_rad)
        return home, max(self.arc_s[0], PEAK_OVER_MEAN * abs(home) / limit)


class WaypointsMotion(StrictModel):
    """From point to point at a constant speed, each corner rounded as tightly as the bounds allow."""

    kind: Literal["waypoints"]
    points_ned_m: tuple[Point, ...] = Field(
        min_length=2, max_length=100, description="North and east of home; independent of the seed"
    )
    speed_m_s: float = Field(gt=0.0, le=10.0, description="Speed all the way")
    max_acceleration_m_s2: float = Field(
        default=1.0, gt=0.05, le=10.0, description="Corners are rounded to keep this acceleration"
    )
    max_turn_rate_deg_s: float = Field(default=45.0, gt=0.0, le=90.0, description="Largest turn rate")
    loop: bool = Field(
        default=False, description="Whether the first point follows the last; else straight on"
    )
    start_s: float = Field(
        default=0.0,
        ge=0.0,
        le=600.0,
        description="At the first point at this time, coming straight from behind it",
    )
    spread_m: float = Field(
        default=0.0, ge=0.0, le=30.0, description="Largest random shift of the whole path"
    )

    @property
    def meet(self) -> Meeting:
        """The points are where they are: the first is passed at the start."""
        return Meeting(point_ned_m=self.points_ned_m[0], time_s=self.start_s, spread_m=self.spread_m)

    @model_validator(mode="after")
    def _can_be_driven(self) -> WaypointsMotion:
        if self.loop and len(self.points_ned_m) < 3:
            raise ValueError("a loop of 2 points; expected 3 or more")
        points = self.points_ned_m
        route = (*points, *points[:3]) if self.loop else points
        for before, after in pairwise(route):
            if math.dist(before, after) < CLOSEST_M:
                raise ValueError(
                    f"points_ned_m: {list(after)} comes twice in a row; expected points {CLOSEST_M:g} m apart"
                )
        corners = zip(route, route[1:], route[2:], strict=False)
        reaches = [0.0, *(self._reach_m(*corner) for corner in corners), 0.0]
        for (before, after), (out, into) in zip(pairwise(route), pairwise(reaches), strict=True):
            if out + into > math.dist(before, after):
                raise ValueError(
                    f"points_ned_m: {list(before)} to {list(after)} is {math.dist(before, after):.1f} m; "
                    f"expected {out + into:.1f} m or more to round the corners there, or a lower speed_m_s"
                )
        return self

    def path(self, _rng: np.random.Generator) -> Path:
        """From the first point at `start_s`; before it and after the last the pad moves straight."""
        first = self.points_ned_m[0]
        segments = drive(self._segments())

        def at(t: float) -> PathPoint:
            place = segments(t - self.start_s)
            north, east, down = place.position_ned_m
            return place._replace(position_ned_m=(north + first[0], east + first[1], down))

        return at

    def _segments(self) -> Iterator[PathSegment]:
        points = self.points_ned_m
        route = cycle(points) if self.loop else chain(points)
        here: Vector3 = ZERO3
        before, corner = next(route), next(route)
        for after in route:
            course, turn, length_s = self._corner(before, corner, after)
            reach_m = self._reach_m(before, corner, after)
            leg_m = math.dist((here[0], here[1]), _less(corner, points[0])) - reach_m
            straight = PathSegment(here, course, 0.0, leg_m / self.speed_m_s, self.speed_m_s, self.speed_m_s)
            yield straight
            start = segment_point(straight, straight.length_s)
            segment = PathSegment(
                start.position_ned_m, course, turn, length_s, self.speed_m_s, self.speed_m_s
            )
            yield segment
            here = segment_point(segment, length_s).position_ned_m
            before, corner = corner, after
        yield PathSegment(here, _course(before, corner), 0.0, DRIVES_FOR_S, self.speed_m_s, self.speed_m_s)

    def _corner(self, before: Point, corner: Point, after: Point) -> tuple[float, float, float]:
        """Course towards it, turn (rad) and duration (s) of the bend."""
        course = _course(before, corner)
        turn = wrap_angle(_course(corner, after) - course)
        rate = min(math.radians(self.max_turn_rate_deg_s), self.max_acceleration_m_s2 / self.speed_m_s)
        return course, turn, max(PEAK_OVER_MEAN * abs(turn) / rate, 1e-3)

    def _reach_m(self, before: Point, corner: Point, after: Point) -> float:
        """How far before the corner its bend begins; by symmetry it ends as far behind it."""
        _, turn, length_s = self._corner(before, corner, after)
        if abs(turn) > math.radians(SHARPEST_CORNER_DEG):
            raise ValueError(
                f"points_ned_m: the corner at {list(corner)} turns by {math.degrees(abs(turn)):.0f} deg; "
                f"expected at most {SHARPEST_CORNER_DEG:g}: put a point beside it"
            )
        end = segment_point(PathSegment(ZERO3, 0.0, turn, length_s, self.speed_m_s, self.speed_m_s), length_s)
        return math.hypot(*end.position_ned_m[:2]) / (2.0 * math.cos(0.5 * turn))


def drive(segments: Iterable[PathSegment]) -> Path:
    """A sequence of segments from time 0, the first also before it, the last also after it."""
    starts: list[float] = []
    row: list[PathSegment] = []
    t = 0.0
    for segment in segments:
        starts.append(t)
        row.append(segment)
        t += segment.length_s
        if t >= DRIVES_FOR_S:
            break

    def at(time_s: float) -> PathPoint:
        i = max(0, bisect_right(starts, time_s) - 1)
        return segment_point(row[i], time_s - starts[i])

    return at


def _course(a: Point, b: Point) -> float:
    return math.atan2(b[1] - a[1], b[0] - a[0])


def _less(a: Point, b: Point) -> Point:
    return (a[0] - b[0], a[1] - b[1])
