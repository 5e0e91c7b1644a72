"""How the pad moves: each kind gives place, velocity, acceleration, heading and heading rate in closed form.

NED, SI; headings clockwise from north. A path starts anywhere; it is then shifted so that the pad is at a
meeting point at a meeting time, where the mission looks for it, give or take a seeded spread. What is
"random" is drawn from the generator handed in, so a seed gives one motion.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from companion.config import StrictModel
from companion.geometry import ZERO3, Vector3, add, rotate_yaw, subtract, wrap_angle
from sitl.curves import (
    LEMNISCATE_LAP,
    Arc,
    Path,
    Place,
    arc_place,
    lemniscate_place,
    sum_of_waves,
    wave_frequency,
)

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Angle = Degrees | Literal["random"]
Heading = Degrees | Literal["along", "random"]
Metres = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Seconds = Annotated[float, Field(ge=0.5, le=60.0)]
WAVES: Final = 6
TURNS_FOR_S: Final = 1000.0
CLEAR_OF_HOME_M: Final = 3.0
TRIES: Final = 50


class PadTruth(NamedTuple):
    """The pad's surface centre at one time; level, whatever it rides on."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    heading_rad: float
    heading_rate_rad_s: float


# ---------------------------------------------------------------- settings


def _drawn(angle: Angle, rng: np.random.Generator) -> float:
    """A fixed angle in radians, or one drawn; draws in either case, so that later draws stay the same."""
    drawn = float(rng.uniform(-math.pi, math.pi))
    return drawn if angle == "random" else math.radians(angle)


class Meeting(StrictModel):
    """Where and when the pad can be met."""

    point_ned_m: tuple[Metres, Metres] = (10.0, 0.0)
    time_s: float = Field(default=22.0, ge=0.0, le=600.0)
    spread_m: float = Field(default=3.0, ge=0.0, le=30.0)


class StaticMotion(StrictModel):
    """It stands."""

    kind: Literal["static"]
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A point with a drawn course, which "along" turns into a heading."""
        place = Place(ZERO3, ZERO3, ZERO3, _drawn("random", rng), 0.0)
        return lambda _time_s: place


class LineMotion(StrictModel):
    """Straight on at a constant speed."""

    kind: Literal["line"]
    speed_m_s: float = Field(gt=0.0, le=10.0)
    course_deg: Angle = "random"
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A straight line through the origin at time 0."""
        course = _drawn(self.course_deg, rng)
        velocity = rotate_yaw((self.speed_m_s, 0.0, 0.0), course)
        return lambda t: Place((velocity[0] * t, velocity[1] * t, 0.0), velocity, ZERO3, course, 0.0)


class CircleMotion(StrictModel):
    """Round and round at a constant speed."""

    kind: Literal["circle"]
    speed_m_s: float = Field(gt=0.0, le=10.0)
    radius_m: float = Field(gt=0.2, le=100.0)
    direction: Literal["clockwise", "anticlockwise", "random"] = "random"
    phase_deg: Angle = "random"
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A circle about the origin; the phase is where on it, clockwise from north, time 0 finds the pad."""
        phase0 = _drawn(self.phase_deg, rng)
        coin = 1.0 if rng.integers(2) else -1.0
        sign = {"clockwise": 1.0, "anticlockwise": -1.0, "random": coin}[self.direction]
        r, w = self.radius_m, sign * self.speed_m_s / self.radius_m

        def at(t: float) -> Place:
            c, s = math.cos(phase0 + w * t), math.sin(phase0 + w * t)
            position, velocity = (r * c, r * s, 0.0), (-r * w * s, r * w * c, 0.0)
            acceleration = (-r * w * w * c, -r * w * w * s, 0.0)
            return Place(position, velocity, acceleration, math.atan2(velocity[1], velocity[0]), w)

        return at


class FigureEightMotion(StrictModel):
    """Bernoulli's lemniscate at a constant speed: the lemniscate sine is its arc length's inverse."""

    kind: Literal["figure_8"]
    speed_m_s: float = Field(gt=0.0, le=10.0)
    half_length_m: float = Field(gt=0.5, le=100.0)
    axis_deg: Angle = "random"
    phase: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["random"] = "random"  # share of a lap
    meet: Meeting = Meeting()

    def path(self, rng: np.random.Generator) -> Path:
        """A lemniscate about the origin."""
        axis = _drawn(self.axis_deg, rng)
        lap_m = LEMNISCATE_LAP * self.half_length_m
        drawn = float(rng.uniform())
        start_m = lap_m * (drawn if self.phase == "random" else self.phase)

        def at(t: float) -> Place:
            return lemniscate_place(start_m + self.speed_m_s * t, self.half_length_m, self.speed_m_s, axis)

        return at


class HeaveMotion(StrictModel):
    """A sea: heave and a smaller surge, each a sum of waves, on a mean that may drift.

    The waves share a Pierson-Moskowitz spectrum's energy equally (amplitude Hs / 4 sqrt(2 / N)), so their
    periods lie where the energy is; phases are drawn.
    """

    kind: Literal["heave"]
    significant_height_m: float = Field(gt=0.0, le=4.0)
    peak_period_s: float = Field(ge=2.0, le=20.0)
    surge_share: float = Field(default=0.3, ge=0.0, le=1.0)
    surge_course_deg: Angle = "random"
    drift_speed_m_s: float = Field(default=0.0, ge=0.0, le=3.0)
    meet: Meeting = Meeting()

    def largest_excursion_m(self) -> float:
        """All crests at once."""
        return 0.25 * self.significant_height_m * math.sqrt(2.0 * WAVES)

    def path(self, rng: np.random.Generator) -> Path:
        """Waves about a mean that leaves the origin with the drift, down the surge's course."""
        course = _drawn(self.surge_course_deg, rng)
        amplitude = self.largest_excursion_m() / WAVES
        waves = tuple(
            (amplitude, wave_frequency((i + 0.5) / WAVES, self.peak_period_s), phase)
            for i, phase in enumerate(rng.uniform(0.0, math.tau, WAVES).tolist())
        )
        c, s = math.cos(course), math.sin(course)

        def at(t: float) -> Place:
            z, vz, az = sum_of_waves(waves, t, 0.0)
            # on deep water surge follows heave by a quarter of a period
            x, vx, ax = (self.surge_share * value for value in sum_of_waves(waves, t, -0.5 * math.pi))
            x, vx = x + self.drift_speed_m_s * t, vx + self.drift_speed_m_s
            return Place((x * c, x * s, z), (vx * c, vx * s, vz), (ax * c, ax * s, az), course, 0.0)

        return at


class RandomTurnsMotion(StrictModel):
    """A driver who turns at whim: arcs of drawn length and bend; beyond the radius, back to the middle.

    Course and velocity are continuous; the sideways acceleration jumps where one arc meets the next.
    """

    kind: Literal["random_turns"]
    speed_m_s: float = Field(gt=0.0, le=10.0)
    max_turn_rate_deg_s: float = Field(default=20.0, gt=0.0, le=90.0)
    arc_s: tuple[Seconds, Seconds] = (2.0, 5.0)  # shortest and longest
    radius_m: float = Field(default=12.0, ge=2.0, le=200.0)
    course_deg: Angle = "random"
    meet: Meeting = Meeting()

    @model_validator(mode="after")
    def _shortest_first(self) -> RandomTurnsMotion:
        if self.arc_s[0] > self.arc_s[1]:
            raise ValueError(f"arc_s is {list(self.arc_s)}; expected the shortest first, then the longest")
        return self

    def path(self, rng: np.random.Generator) -> Path:
        """Arcs from the origin at time 0."""
        starts, arcs = self._arcs(rng)

        def at(t: float) -> Place:
            i = max(0, bisect_right(starts, t) - 1)
            return arc_place(arcs[i], self.speed_m_s, t - starts[i])

        return at

    def _arcs(self, rng: np.random.Generator) -> tuple[list[float], list[Arc]]:
        limit = math.radians(self.max_turn_rate_deg_s)
        starts, arcs = [], []
        t, position, course = 0.0, ZERO3, _drawn(self.course_deg, rng)
        while t < TURNS_FOR_S:
            turn, length_s = float(rng.uniform(-limit, limit)), float(rng.uniform(*self.arc_s))
            if math.hypot(position[0], position[1]) > self.radius_m:
                home = math.atan2(-position[1], -position[0])
                turn = math.copysign(limit, wrap_angle(home - course))
                length_s = abs(wrap_angle(home - course)) / limit + 1.0
            arc = Arc(position, course, turn)
            starts.append(t)
            arcs.append(arc)
            end = arc_place(arc, self.speed_m_s, length_s)
            t, position, course = t + length_s, end.position_ned_m, end.course_rad
        return starts, arcs


Motion = StaticMotion | LineMotion | CircleMotion | FigureEightMotion | HeaveMotion | RandomTurnsMotion


# ---------------------------------------------------------------- the pad


class PadMotion:
    """A path put in its place, with the board's height and heading."""

    def __init__(self, path: Path, shift_ned_m: Vector3, heading_rad: float | None) -> None:
        """`heading_rad` None: the pad points where it goes."""
        self._path = path
        self._shift = shift_ned_m
        self._heading_rad = heading_rad

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time (s)."""
        place = self._path(time_s)
        fixed = self._heading_rad
        return PadTruth(
            time_s,
            add(place.position_ned_m, self._shift),
            place.velocity_ned_m_s,
            place.acceleration_ned_m_s2,
            wrap_angle(place.course_rad) if fixed is None else fixed,
            place.course_rate_rad_s if fixed is None else 0.0,
        )


def build_pad_motion(
    settings: Motion,
    surface_height_m: float,
    heading_deg: Heading,
    rng: np.random.Generator,
) -> PadMotion:
    """Draw a motion that can be met where the settings say.

    Where the dice leave room the pad keeps clear of home until it is met: it would otherwise drive through
    a vehicle that has not yet taken off.
    """
    drawn = _drawn("random" if isinstance(heading_deg, str) else heading_deg, rng)
    heading = None if heading_deg == "along" else drawn
    for _ in range(TRIES):
        motion = PadMotion(*_placed(settings, surface_height_m, rng), heading)
        if _clear_of_home(motion, settings.meet.time_s):
            break
    return motion


def _placed(settings: Motion, surface_height_m: float, rng: np.random.Generator) -> tuple[Path, Vector3]:
    path = settings.path(rng)
    meet = settings.meet
    # the root spreads the points evenly over the disc
    away = meet.spread_m * math.sqrt(float(rng.uniform()))
    bearing = float(rng.uniform(-math.pi, math.pi))
    point = (meet.point_ned_m[0] + away * math.cos(bearing), meet.point_ned_m[1] + away * math.sin(bearing))
    shift = subtract((point[0], point[1], 0.0), path(meet.time_s).position_ned_m)
    return path, (shift[0], shift[1], -surface_height_m)


def _clear_of_home(motion: PadMotion, until_s: float) -> bool:
    times = (0.25 * i for i in range(int(4.0 * until_s) + 1))
    return all(math.hypot(*motion.at(t).position_ned_m[:2]) > CLEAR_OF_HOME_M for t in times)
