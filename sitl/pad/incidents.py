"""What happens to a pad on its way: it brakes, turns back, leaves, tilts, or is gone.

`IncidentMotion` follows the scenario's motion until something happens; from then on it drives straight
along the course that it had, by a speed that changes at a constant rate. Its height and what the sea does
stay those of the scenario's motion. NED, SI.
"""

import math
from typing import Final, NamedTuple, Protocol

from companion.base.geometry import Vector3
from sitl.pad.motion import PadTruth

# a speed that changes at once: so fast that the pad moves by less than a millimetre meanwhile
AT_ONCE_M_S2: Final = 1e5


class Moving(Protocol):
    """A pad's motion."""

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time (s)."""
        ...


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
    """A pad's motion with what happens to it. Times do not go back."""

    def __init__(self, motion: Moving) -> None:
        self._motion = motion
        self._drive: Drive | None = None
        self._tilt: RollRamp | None = None
        self._usual_m_s = 0.0
        self._gone: PadTruth | None = None

    def at(self, time_s: float) -> PadTruth:
        """The pad at a time (s); one that is gone stays where it was, as its beacon says."""
        if self._gone is not None:
            return self._gone._replace(time_s=time_s)
        pad = self._motion.at(time_s)
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
            self._usual_m_s = speed
            course = math.atan2(ve, vn) if speed > 0.0 else pad.heading_rad
        else:
            course = self._drive.course_rad
            speed = self._drive.along(now_s)[1]
        self._drive = Drive(now_s, north, east, course, pad.heading_rad, speed, target_m_s, rate_m_s2)

    @property
    def usual_m_s(self) -> float:
        """The speed that it had before anything happened to it."""
        return self._usual_m_s

    def turn_back(self, now_s: float, rate_m_s2: float) -> None:
        """From now on back the way it came, as fast as it came."""
        vn, ve, _ = self.at(now_s).velocity_ned_m_s
        self.drive(now_s, -math.hypot(vn, ve), rate_m_s2)

    def tilt(self, now_s: float, roll_rad: float, rate_rad_s: float) -> None:
        """Tilt to a roll beyond the deck's own, at a rate."""
        begins = 0.0 if self._tilt is None else self._tilt.at(now_s)[0]
        self._tilt = RollRamp(now_s, begins, roll_rad, rate_rad_s)

    def vanish(self, now_s: float) -> None:
        """It is gone from now on."""
        self._gone = self.at(now_s)._replace(
            velocity_ned_m_s=(0.0, 0.0, 0.0), acceleration_ned_m_s2=(0.0, 0.0, 0.0), is_there=False
        )

    def appear(self) -> None:
        """It is there again."""
        self._gone = None
