"""A pad's paths: static, line, circle, figure of eight or heave in closed form, and driven ones.

Each kind's settings make a path about the origin (NED, SI; courses clockwise from north); `motion` puts
it at its meeting point. What is "random" is drawn from the generator handed in, so a seed gives one motion.
Curves and waves give position, velocity, acceleration, course and course rate by time at a constant speed.
Driven paths (waypoints with rounded corners, random turns) are sequences of segments (`PathSegment`), so that
speed, course, acceleration and rate of turn are all continuous, and bounded.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, cycle, pairwise
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from companion.base.geometry import ZERO3, Vector3, add, rotate_yaw, wrap_angle
from companion.config import StrictModel

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


Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Angle = Degrees | Literal["random"]
Heading = Degrees | Literal["along", "random"]
Metres = Annotated[float, Field(ge=-1000.0, le=1000.0)]


def drawn_angle(angle: Angle, rng: np.random.Generator) -> float:
    """A fixed angle in radians, or one drawn; draws in either case, so that later draws stay the same."""
    drawn = float(rng.uniform(-math.pi, math.pi))
    return drawn if angle == "random" else math.radians(angle)


class Meeting(StrictModel):
    """Where and when the pad can be met."""

    point_ned_m: tuple[Metres, Metres] = Field(
        default=(10.0, 0.0), description="The pad passes this point, north and east of home"
    )
    time_s: float = Field(
        default=22.0, ge=0.0, le=600.0, description="Time at which the pad passes that point"
    )
    spread_m: float = Field(default=3.0, ge=0.0, le=30.0, description="Largest random shift of the point")


class StaticMotion(StrictModel):
    """It stands."""

    kind: Literal["static"]
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A point with a drawn course, which "along" turns into a heading."""
        place = PathPoint(ZERO3, ZERO3, ZERO3, drawn_angle("random", rng), 0.0)
        return lambda _time_s: place


class LineMotion(StrictModel):
    """Straight on at a constant speed."""

    kind: Literal["line"]
    speed_m_s: float = Field(gt=0.0, le=10.0, description="Speed of a straight motion")
    course_deg: Angle = Field(default="random", description="Course, clockwise from north")
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A straight line through the origin at time 0."""
        course = drawn_angle(self.course_deg, rng)
        velocity = rotate_yaw((self.speed_m_s, 0.0, 0.0), course)
        return lambda t: PathPoint((velocity[0] * t, velocity[1] * t, 0.0), velocity, ZERO3, course, 0.0)


class CircleMotion(StrictModel):
    """Round and round at a constant speed."""

    kind: Literal["circle"]
    speed_m_s: float = Field(gt=0.0, le=10.0, description="Speed along the circle")
    radius_m: float = Field(gt=0.2, le=100.0, description="Radius of the circle")
    direction: Literal["clockwise", "anticlockwise", "random"] = Field(
        default="random", description="Seen from above"
    )
    phase_deg: Angle = Field(
        default="random", description="Position on the circle at time 0, clockwise from north"
    )
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A circle about the origin; the phase is where on it, clockwise from north, time 0 finds the pad."""
        phase0 = drawn_angle(self.phase_deg, rng)
        coin = 1.0 if rng.integers(2) else -1.0
        sign = {"clockwise": 1.0, "anticlockwise": -1.0, "random": coin}[self.direction]
        r, w = self.radius_m, sign * self.speed_m_s / self.radius_m

        def at(t: float) -> PathPoint:
            c, s = math.cos(phase0 + w * t), math.sin(phase0 + w * t)
            position, velocity = (r * c, r * s, 0.0), (-r * w * s, r * w * c, 0.0)
            acceleration = (-r * w * w * c, -r * w * w * s, 0.0)
            return PathPoint(position, velocity, acceleration, math.atan2(velocity[1], velocity[0]), w)

        return at


class FigureEightMotion(StrictModel):
    """Bernoulli's lemniscate at a constant speed: the lemniscate sine is its arc length's inverse."""

    kind: Literal["figure_8"]
    speed_m_s: float = Field(gt=0.0, le=10.0, description="Speed along the lemniscate, constant")
    half_length_m: float = Field(gt=0.5, le=100.0, description="Distance from its middle to an end")
    axis_deg: Angle = Field(default="random", description="Direction of its length, clockwise from north")
    phase: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["random"] = Field(
        default="random", description="Share of a lap done at time 0"
    )
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A lemniscate about the origin."""
        axis = drawn_angle(self.axis_deg, rng)
        lap_m = LEMNISCATE_LAP * self.half_length_m
        drawn = float(rng.uniform())
        start_m = lap_m * (drawn if self.phase == "random" else self.phase)

        def at(t: float) -> PathPoint:
            return lemniscate_point(start_m + self.speed_m_s * t, self.half_length_m, self.speed_m_s, axis)

        return at


class HeaveMotion(StrictModel):
    """A sea: heave and a smaller surge, each a sum of waves, on a mean that may drift.

    The waves share a Pierson-Moskowitz spectrum's energy equally (amplitude Hs / 4 sqrt(2 / N)), so their
    periods lie where the energy is; phases are drawn.
    """

    kind: Literal["heave"]
    significant_height_m: float = Field(
        gt=0.0,
        le=4.0,
        description="Significant wave height (Pierson-Moskowitz): trough to crest, highest third",
    )
    peak_period_s: float = Field(ge=2.0, le=20.0, description="Peak period of the waves")
    surge_share: float = Field(
        default=0.3, ge=0.0, le=1.0, description="Horizontal motion as a share of the heave"
    )
    surge_course_deg: Angle = Field(default="random", description="Direction of the surge")
    drift_speed_m_s: float = Field(default=0.0, ge=0.0, le=3.0, description="Steady drift in addition")
    meet: Meeting = Meeting()

    def largest_excursion_m(self) -> float:
        """All crests at once."""
        return peak(self.significant_height_m)

    def path(self, rng: np.random.Generator) -> Path:
        """Waves about a mean that leaves the origin with the drift, down the surge's course."""
        course = drawn_angle(self.surge_course_deg, rng)
        waves = draw_waves(self.significant_height_m, self.peak_period_s, rng)
        c, s = math.cos(course), math.sin(course)

        def at(t: float) -> PathPoint:
            z, vz, az = sum_of_waves(waves, t, 0.0)
            # on deep water surge follows heave by a quarter of a period
            x, vx, ax = (self.surge_share * value for value in sum_of_waves(waves, t, -0.5 * math.pi))
            x, vx = x + self.drift_speed_m_s * t, vx + self.drift_speed_m_s
            return PathPoint((x * c, x * s, z), (vx * c, vx * s, vz), (ax * c, ax * s, az), course, 0.0)

        return at


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
        description="Time at which the pad passes the first point, coming straight",
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


# ---------------------------------------------------------------- sea
# Sea motion of a deck, in addition to its path: heave, roll and pitch, each a sum of waves.
#
# SI; roll and pitch are the deck's own (aerospace angles after its heading), about the pad's centre. The
# waves of each share a Pierson-Moskowitz spectrum's energy equally. "Significant" is the mean of the highest
# third of the swings from one side to the other, 4 standard deviations, as with the height of waves.

WAVES: Final = 6


class DeckSettings(StrictModel):
    """How a deck moves in the sea; its way is the pad's motion."""

    significant_height_m: float = Field(default=0.0, ge=0.0, le=4.0, description="Heave, trough to crest")
    significant_roll_deg: float = Field(
        default=0.0, ge=0.0, le=30.0, description="Roll, from one side to the other"
    )
    significant_pitch_deg: float = Field(
        default=0.0, ge=0.0, le=30.0, description="Pitch, from bow up to bow down"
    )
    peak_period_s: float = Field(default=6.0, ge=2.0, le=20.0, description="Period of heave and pitch")
    roll_period_s: float = Field(default=8.0, ge=2.0, le=30.0, description="Period of roll, a ship's own")

    def largest_excursion_m(self, half_diagonal_m: float) -> float:
        """How far the lowest corner of a board goes below the mean, all crests at once."""
        tilt = math.radians(peak(self.significant_roll_deg) + peak(self.significant_pitch_deg))
        return peak(self.significant_height_m) + half_diagonal_m * math.sin(min(tilt, 0.5 * math.pi))


class DeckState(NamedTuple):
    """Heave (m, down), roll and pitch (rad), each with its speed; the heave with its acceleration too."""

    heave: tuple[float, float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]


def peak(significant: float) -> float:
    """The largest excursion of a sum of waves: all crests at once."""
    return 0.25 * significant * math.sqrt(2.0 * WAVES)


def draw_waves(significant: float, peak_period_s: float, rng: np.random.Generator) -> tuple[Wave, ...]:
    """Amplitude, frequency (rad/s) and drawn phase of each wave."""
    amplitude = peak(significant) / WAVES
    return tuple(
        (amplitude, wave_frequency((i + 0.5) / WAVES, peak_period_s), phase)
        for i, phase in enumerate(rng.uniform(0.0, math.tau, WAVES).tolist())
    )


class DeckMotion:
    """A deck under one seed."""

    def __init__(self, settings: DeckSettings, rng: np.random.Generator) -> None:
        s = settings
        self._heave = draw_waves(s.significant_height_m, s.peak_period_s, rng)
        self._roll = draw_waves(math.radians(s.significant_roll_deg), s.roll_period_s, rng)
        self._pitch = draw_waves(math.radians(s.significant_pitch_deg), s.peak_period_s, rng)

    def at(self, time_s: float) -> DeckState:
        return DeckState(
            sum_of_waves(self._heave, time_s, 0.0),
            sum_of_waves(self._roll, time_s, 0.0)[:2],
            sum_of_waves(self._pitch, time_s, 0.0)[:2],
        )
