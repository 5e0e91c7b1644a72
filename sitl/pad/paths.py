"""Paths of a pad in closed form: static, line, circle, figure of eight, or heave.

Each kind's settings make a path about the origin (NED, SI; courses clockwise from north); `motion` puts
it at its meeting point. What is "random" is drawn from the generator handed in, so a seed gives one motion.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from companion.base.geometry import ZERO3, rotate_yaw
from companion.config import StrictModel
from sitl.pad.curves import LEMNISCATE_LAP, Path, PathPoint, lemniscate_point, sum_of_waves
from sitl.pad.sea import draw_waves, peak

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
