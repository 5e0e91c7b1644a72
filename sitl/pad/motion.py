"""The pad's motion: a path at its meeting point, with the board's height, heading and tilt.

NED, SI; headings clockwise from north. A path starts anywhere; it is then shifted so that the pad is at a
meeting point at a meeting time, where the mission looks for it, give or take a seeded spread. What is
"random" is drawn from the generator handed in, so a seed gives one motion.

What happens to a pad on its way: it brakes, turns back, leaves, tilts, or is gone.

`IncidentMotion` follows the scenario's motion until something happens; from then on it drives straight
along the course that it had, by a speed that changes at a constant rate. Its height and what the sea does
stay those of the scenario's motion. NED, SI.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import Vector3, add, cross, subtract, wrap_angle
from sitl.pad.paths import (
    CircleMotion,
    DeckMotion,
    DeckSettings,
    FigureEightMotion,
    Heading,
    HeaveMotion,
    LineMotion,
    Path,
    RandomTurnsMotion,
    StaticMotion,
    WaypointsMotion,
    drawn_angle,
)

CLEAR_OF_HOME_M: Final = 3.0
TRIES: Final = 50

PadMotionSettings = (
    StaticMotion
    | LineMotion
    | CircleMotion
    | FigureEightMotion
    | HeaveMotion
    | RandomTurnsMotion
    | WaypointsMotion
)


class Axes(NamedTuple):
    """The board's axes in NED: forward (its heading), right, and down, which is its normal."""

    forward: Vector3
    right: Vector3
    down: Vector3

    def to_ned(self, local: Vector3) -> Vector3:
        """A vector given along the board's axes."""
        f, r, d = self
        x, y, z = local
        return (
            f[0] * x + r[0] * y + d[0] * z,
            f[1] * x + r[1] * y + d[1] * z,
            f[2] * x + r[2] * y + d[2] * z,
        )

    def from_ned(self, v: Vector3) -> Vector3:
        """A vector's shares along the board's axes."""
        f, r, d = self
        return (
            f[0] * v[0] + f[1] * v[1] + f[2] * v[2],
            r[0] * v[0] + r[1] * v[1] + r[2] * v[2],
            d[0] * v[0] + d[1] * v[1] + d[2] * v[2],
        )


# axes are needed several times per step
@lru_cache(maxsize=16)
def _axes(heading_rad: float, roll_rad: float, pitch_rad: float) -> Axes:
    cy, sy = math.cos(heading_rad), math.sin(heading_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    return Axes(
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    )


class PadTruth(NamedTuple):
    """The pad's surface centre at one time; roll and pitch (after the heading) are of a deck at sea.

    One that is not there can be neither touched nor heard.
    """

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    heading_rad: float
    heading_rate_rad_s: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    roll_rate_rad_s: float = 0.0
    pitch_rate_rad_s: float = 0.0
    is_there: bool = True

    def axes(self) -> Axes:
        """The board's axes: yaw, then pitch, then roll."""
        return _axes(self.heading_rad, self.roll_rad, self.pitch_rad)

    def rate_ned_rad_s(self) -> Vector3:
        """Angular rate of the board: the three angles' rates, each about its own axis."""
        cy, sy = math.cos(self.heading_rad), math.sin(self.heading_rad)
        cp, sp = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        roll, pitch = self.roll_rate_rad_s, self.pitch_rate_rad_s
        return (roll * cp * cy - pitch * sy, roll * cp * sy + pitch * cy, self.heading_rate_rad_s - roll * sp)

    def velocity_at_ned_m_s(self, place_ned_m: Vector3) -> Vector3:
        """Velocity of the board at a place on it: the pad's, and its turning."""
        lever = subtract(place_ned_m, self.position_ned_m)
        return add(self.velocity_ned_m_s, cross(self.rate_ned_rad_s(), lever))

    def extrapolated(self, ahead_s: float) -> PadTruth:
        """The pad a fraction of a step later, at constant rates."""
        x, y, z = self.position_ned_m
        vx, vy, vz = self.velocity_ned_m_s
        return self._replace(
            position_ned_m=(x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s),
            heading_rad=self.heading_rad + self.heading_rate_rad_s * ahead_s,
            roll_rad=self.roll_rad + self.roll_rate_rad_s * ahead_s,
            pitch_rad=self.pitch_rad + self.pitch_rate_rad_s * ahead_s,
        )


class PadMotion:
    """A path at its meeting point, with the board's height and heading, and the sea state."""

    def __init__(
        self, path: Path, shift_ned_m: Vector3, heading_rad: float | None, deck: DeckMotion | None = None
    ) -> None:
        """`heading_rad` None: the pad points along its course."""
        self._path = path
        self._shift = shift_ned_m
        self._heading_rad = heading_rad
        self._deck = deck

    def at(self, time_s: float) -> PadTruth:
        place = self._path(time_s)
        fixed = self._heading_rad
        pad = PadTruth(
            time_s,
            add(place.position_ned_m, self._shift),
            place.velocity_ned_m_s,
            place.acceleration_ned_m_s2,
            wrap_angle(place.course_rad) if fixed is None else fixed,
            place.course_rate_rad_s if fixed is None else 0.0,
        )
        return pad if self._deck is None else _at_sea(pad, self._deck)


def _at_sea(pad: PadTruth, deck: DeckMotion) -> PadTruth:
    (down, sinking, falling), (roll, roll_rate), (pitch, pitch_rate) = deck.at(pad.time_s)
    return pad._replace(
        position_ned_m=add(pad.position_ned_m, (0.0, 0.0, down)),
        velocity_ned_m_s=add(pad.velocity_ned_m_s, (0.0, 0.0, sinking)),
        acceleration_ned_m_s2=add(pad.acceleration_ned_m_s2, (0.0, 0.0, falling)),
        roll_rad=roll,
        pitch_rad=pitch,
        roll_rate_rad_s=roll_rate,
        pitch_rate_rad_s=pitch_rate,
    )


def build_pad_motion(
    settings: PadMotionSettings,
    surface_height_m: float,
    heading_deg: Heading,
    rng: np.random.Generator,
    deck: DeckSettings | None = None,
) -> PadMotion:
    """Draw a motion through the meeting point of the settings.

    Where the random draws allow, the pad stays clear of home until it is met: otherwise it could drive
    through a vehicle that has not yet taken off.
    """
    drawn = drawn_angle("random" if isinstance(heading_deg, str) else heading_deg, rng)
    heading = None if heading_deg == "along" else drawn
    # a generator of its own: a sea does not change the way
    at_sea = None if deck is None else DeckMotion(deck, rng.spawn(1)[0])
    for _ in range(TRIES):
        motion = PadMotion(*_placed(settings, surface_height_m, rng), heading, at_sea)
        if _clear_of_home(motion, settings.meet.time_s):
            break
    return motion


def _placed(
    settings: PadMotionSettings, surface_height_m: float, rng: np.random.Generator
) -> tuple[Path, Vector3]:
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


# a speed that changes at once: so fast that the pad moves by less than a millimetre meanwhile
AT_ONCE_M_S2: Final = 1e5


class Drive(NamedTuple):
    """Straight on from a place, the speed along the course going from one to another at a constant rate."""

    begun_s: float
    north_m: float
    east_m: float
    course_rad: float
    heading_rad: float
    speed_m_s: float
    target_m_s: float
    rate_m_s2: float

    def along(self, time_s: float) -> Vector3:
        """Way (m), speed (m/s) and acceleration (m/s²) along the course since it began."""
        change = self.target_m_s - self.speed_m_s
        rate = math.copysign(self.rate_m_s2, change)
        passed_s, whole_s = time_s - self.begun_s, abs(change) / self.rate_m_s2
        if passed_s < whole_s:
            return (self.speed_m_s + 0.5 * rate * passed_s) * passed_s, self.speed_m_s + rate * passed_s, rate
        way_m = 0.5 * (self.speed_m_s + self.target_m_s) * whole_s
        return way_m + self.target_m_s * (passed_s - whole_s), self.target_m_s, 0.0

    def applied(self, pad: PadTruth) -> PadTruth:
        """The pad of the scenario's motion, driven so instead."""
        way, speed, rate = self.along(pad.time_s)
        c, s = math.cos(self.course_rad), math.sin(self.course_rad)
        return pad._replace(
            position_ned_m=(self.north_m + c * way, self.east_m + s * way, pad.position_ned_m[2]),
            velocity_ned_m_s=(c * speed, s * speed, pad.velocity_ned_m_s[2]),
            acceleration_ned_m_s2=(c * rate, s * rate, pad.acceleration_ned_m_s2[2]),
            heading_rad=self.heading_rad,
            heading_rate_rad_s=0.0,
        )


class RollRamp(NamedTuple):
    """A roll that goes from one angle to another at a constant rate."""

    begun_s: float
    roll_rad: float
    target_rad: float
    rate_rad_s: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Roll (rad) and its rate (rad/s)."""
        change = self.target_rad - self.roll_rad
        done = (time_s - self.begun_s) * self.rate_rad_s
        if done >= abs(change):
            return self.target_rad, 0.0
        rate = math.copysign(self.rate_rad_s, change)
        return self.roll_rad + math.copysign(done, change), rate


class IncidentMotion:
    """A pad's motion with what happens to it. Times do not go back.

    `usual_m_s` is the speed that it had before anything happened to it.
    """

    def __init__(self, motion: Callable[[float], PadTruth]) -> None:
        """`motion`: the scenario's, the pad at a time (s)."""
        self._motion = motion
        self._drive: Drive | None = None
        self._tilt: RollRamp | None = None
        self.usual_m_s = 0.0
        self._gone: PadTruth | None = None

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time (s); one that is gone stays where it was, as its beacon says."""
        if self._gone is not None:
            return self._gone._replace(time_s=time_s)
        pad = self._motion(time_s)
        if self._drive is not None:
            pad = self._drive.applied(pad)
        if self._tilt is not None:
            roll, rate = self._tilt.at(time_s)
            pad = pad._replace(roll_rad=pad.roll_rad + roll, roll_rate_rad_s=pad.roll_rate_rad_s + rate)
        return pad

    def drive(self, now_s: float, target_m_s: float, rate_m_s2: float = AT_ONCE_M_S2) -> None:
        """From now on straight along the course, to that speed; negative is backwards."""
        pad = self.at(now_s)
        north, east, _ = pad.position_ned_m
        vn, ve, _ = pad.velocity_ned_m_s
        speed = math.hypot(vn, ve)
        if self._drive is None:
            self.usual_m_s = speed
            course = math.atan2(ve, vn) if speed > 0.0 else pad.heading_rad
        else:
            course = self._drive.course_rad
            speed = self._drive.along(now_s)[1]
        self._drive = Drive(now_s, north, east, course, pad.heading_rad, speed, target_m_s, rate_m_s2)

    def turn_back(self, now_s: float, rate_m_s2: float) -> None:
        """From now on back the way it came, as fast as it came."""
        vn, ve, _ = self.at(now_s).velocity_ned_m_s
        self.drive(now_s, -math.hypot(vn, ve), rate_m_s2)

    def tilt(self, now_s: float, roll_rad: float, rate_rad_s: float) -> None:
        """Tilt to a roll beyond the deck's own, at a rate."""
        begins = 0.0 if self._tilt is None else self._tilt.at(now_s)[0]
        self._tilt = RollRamp(now_s, begins, roll_rad, rate_rad_s)

    def vanish(self, now_s: float) -> None:
        self._gone = self.at(now_s)._replace(
            velocity_ned_m_s=(0.0, 0.0, 0.0), acceleration_ned_m_s2=(0.0, 0.0, 0.0), is_there=False
        )

    def appear(self) -> None:
        self._gone = None
