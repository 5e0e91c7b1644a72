"""Looking for the pad: hold, ask the ground station where it is, fly there, spiral (Algorithm 1, else).

What is known of the pad's place is a `Lead`: the ground station's beacon, the last sight, or the point where
the search began; the newest counts. It is led along its arc for a while only. Everything is in the EKF's
NED, m, s and rad; the height is chosen on entry and kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.config import SearchConfig
from companion.geometry import ZERO3, Vector3, ned_from_geodetic, wrap_angle
from companion.messages import PadBeacon
from companion.plan.guidance import Guide
from companion.plan.min_jerk import Motion

# The reference counts as at a corner when this close: the next one is taken up without a halt.
_CORNER_M = 1.0
# A floor is heeded in steps, lest its noise be flown.
_FLOOR_STEP_M = 0.3
# A search that begins with a climb comes to rest first.
_STOPPED_S = 0.6
# Slower than this a pad has no course to speak of; turning faster than that is noise.
_COURSE_M_S = 0.3
_FASTEST_TURN_RAD_S = 1.0


def square_spiral(corner: int, spacing_m: float) -> tuple[float, float]:
    """North and east (m) of a corner of the expanding square; corner 0 is its centre.

    The legs grow so that neighbouring turns lie one spacing apart.
    """
    if corner == 0:
        return (0.0, 0.0)
    turn, side = divmod(corner - 1, 4)
    near, far = turn * spacing_m, (turn + 1) * spacing_m
    return ((far, -near), (far, far), (-far, far), (-far, -far))[side]


@dataclass(frozen=True, slots=True)
class Lead:
    """Where the pad was at a time, and how it moved; horizontal, EKF's NED."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3 = ZERO3
    turn_rate_rad_s: float = 0.0

    def at(self, now_s: float, longest_s: float) -> Motion:
        """Where it should be now, along an arc; after longest_s it is taken to stand where it was by then."""
        age_s = now_s - self.time_s
        t = max(0.0, min(age_s, longest_s))
        p, v, w = self.position_ned_m, self.velocity_ned_m_s, self.turn_rate_rad_s
        angle = w * t
        along = math.sin(angle) / w if abs(angle) > 1e-4 else t
        across = (1.0 - math.cos(angle)) / w if abs(angle) > 1e-4 else 0.5 * angle * t
        place = (p[0] + along * v[0] - across * v[1], p[1] + across * v[0] + along * v[1], 0.0)
        if age_s >= longest_s:
            return Motion(place)
        c, s = math.cos(angle), math.sin(angle)
        return Motion(place, (c * v[0] - s * v[1], s * v[0] + c * v[1], 0.0))


def turn_rate(before: Lead | None, time_s: float, velocity: Vector3) -> float:
    """Rate (rad/s, clockwise from above) at which the course turned since an earlier word."""
    if before is None or time_s - before.time_s < 0.5:
        return 0.0 if before is None else before.turn_rate_rad_s
    old = before.velocity_ned_m_s
    if min(math.hypot(old[0], old[1]), math.hypot(velocity[0], velocity[1])) < _COURSE_M_S:
        return 0.0
    turned = wrap_angle(math.atan2(velocity[1], velocity[0]) - math.atan2(old[1], old[0]))
    return _bounded(turned / (time_s - before.time_s))


def _bounded(rate_rad_s: float) -> float:
    return max(-_FASTEST_TURN_RAD_S, min(_FASTEST_TURN_RAD_S, rate_rad_s))


class Whereabouts:
    """The newest word of where the pad is."""

    def __init__(self, config: SearchConfig) -> None:
        self._config = config
        self._beacon: Lead | None = None
        self._beacon_heard: PadBeacon | None = None
        self._sight: Lead | None = None
        self.start = Lead(-math.inf, ZERO3)

    def hear(self, beacon: PadBeacon | None, origin: Vector3 | None) -> bool:
        """Take in the beacon; `origin` is the EKF's (deg, deg, m). Returns whether it was a surprise."""
        if beacon is None or origin is None or beacon == self._beacon_heard:
            return False
        self._beacon_heard = beacon
        position = ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, origin)
        velocity = beacon.velocity_ned_m_s
        rate = turn_rate(self._beacon, beacon.time_s, velocity)
        expected = self.likely(beacon.time_s).position_m
        self._beacon = Lead(beacon.time_s, position, velocity, rate)
        return math.dist(expected[:2], position[:2]) > self._config.spacing_m

    def remember(self, pad: Motion, seen_s: float, now_s: float) -> None:
        """Keep the last sight of the pad; `pad` is what the filter leads it to now."""
        p, v, a = pad.position_m, pad.velocity_m_s, pad.acceleration_m_s2
        age_s = now_s - seen_s
        flat = v[0] * v[0] + v[1] * v[1]
        rate = _bounded((v[0] * a[1] - v[1] * a[0]) / flat) if flat > _COURSE_M_S**2 else 0.0
        self._sight = Lead(seen_s, (p[0] - v[0] * age_s, p[1] - v[1] * age_s, 0.0), v, rate)

    def distrust(self) -> None:
        """The last sight proved wrong."""
        self._sight = None

    def likely(self, now_s: float) -> Motion:
        """Where the pad should be now; at rest where the search began when there is no word."""
        newest = self._newest(now_s)
        if newest is self.start:
            return Motion(newest.position_ned_m)
        return newest.at(now_s, self._config.lead_s)

    def source(self, now_s: float) -> str:
        """What it goes by, in words."""
        newest = self._newest(now_s)
        if newest is self.start:
            return "no word of it yet"
        return "by its beacon" if newest is self._beacon else "by the last sight"

    def _newest(self, now_s: float) -> Lead:
        words = [w for w in (self._beacon, self._sight) if w and now_s - w.time_s <= self._config.trust_s]
        return max(words, key=lambda word: word.time_s, default=self.start)


@dataclass(frozen=True, slots=True)
class SearchStep:
    """What a cycle of searching asks for."""

    ask_for_control: bool = False
    request_pad: bool = False
    seen: bool = False
    flying: bool = False


class Search:
    """One search after another: `begin`, then `step` every cycle. Steers the guide in the EKF's NED."""

    def __init__(self, config: SearchConfig, guide: Guide) -> None:
        self._config, self._guide = config, guide
        self.whereabouts = Whereabouts(config)
        self._down_m = 0.0
        self._corner = 0
        self._arrived_s: float | None = None
        self._begun_s = self._control_s = self._next_request_s = -math.inf
        self._had_control = False

    def hear(self, beacon: PadBeacon | None, origin: Vector3 | None) -> None:
        """Take in the beacon; one that is far from where the pad was thought starts the spiral again."""
        if self.whereabouts.hear(beacon, origin):
            self._corner, self._arrived_s = 0, None

    def request_now(self) -> None:
        """Ask for the pad's position at the next step, however lately that was done."""
        self._next_request_s = -math.inf

    def begin(self, climb_m: float, lowest_down_m: float, now_s: float) -> float:
        """Start from the reference; returns the climb (m), bounded, that the search will make.

        It ends no lower than lowest_down_m (EKF's NED), and that bounds it too.
        """
        here = self._guide.at(now_s).position_m
        self.whereabouts.start = Lead(-math.inf, here)
        wished_m = max(0.0, min(self._config.climb_m, climb_m))
        self._down_m = min(here[2] - wished_m, lowest_down_m)
        self._hold_m = self._guide.resting_place_m()
        climb_m = here[2] - self._down_m
        self._most_up_m = self._down_m - self._config.climb_m
        self._corner, self._arrived_s = 0, None
        self._begun_s = now_s
        return climb_m

    def keep_above(self, lowest_down_m: float) -> float:
        """Raise the height of searching over a floor (EKF's NED) that rose; returns the climb (m), if any.

        All such climbs of a search together are bounded: a floor that goes on rising is a fault.
        """
        floor_m = max(lowest_down_m, self._most_up_m)
        climb_m = self._down_m - floor_m
        if climb_m < _FLOOR_STEP_M:
            return 0.0
        self._down_m = floor_m - _FLOOR_STEP_M
        return climb_m + _FLOOR_STEP_M

    def step(self, actual: Motion, in_control: bool, steady: bool, now_s: float) -> SearchStep:
        """One cycle; `actual` is the vehicle in the EKF's NED, `steady` whether the pad is in view."""
        if not in_control:
            # setpoints first, then the question: PX4 wants to see them before it obeys
            self._had_control = False
            return SearchStep(ask_for_control=now_s - self._begun_s >= self._config.stream_s)
        if not self._had_control:
            self._had_control, self._control_s = True, now_s
            self._guide.take_up(actual, now_s)
        if steady:
            return SearchStep(seen=True)
        request = now_s >= self._next_request_s
        if request:
            self._next_request_s = now_s + self._config.request_s
        flying = now_s - max(self._begun_s, self._control_s) >= self._config.hold_s
        if flying:
            self._guide.fly_to(self._target(now_s), now_s)
        elif in_control and now_s - self._begun_s >= _STOPPED_S:
            self._guide.fly_to(Motion((*self._hold_m[:2], self._down_m)), now_s)
        return SearchStep(request_pad=request, flying=flying)

    def _target(self, now_s: float) -> Motion:
        """The pad's likely place first, then the corners of a spiral about it, moving as it does."""
        centre = self.whereabouts.likely(now_s)
        reference = self._guide.at(now_s).position_m
        place = self._corner_of(centre)
        if math.dist(reference[:2], place) < _CORNER_M:
            self._at_corner(now_s)
            place = self._corner_of(centre)
        return Motion((*place, self._down_m), centre.velocity_m_s)

    def _at_corner(self, now_s: float) -> None:
        """Go on to the next corner; at the centre look about for a moment first."""
        if self._arrived_s is None:
            self._arrived_s = now_s
        if self._corner == 0 and now_s - self._arrived_s < self._config.dwell_s:
            return
        north, east = square_spiral(self._corner + 1, self._config.spacing_m)
        # beyond the radius it begins anew: the pad may have come closer meanwhile
        self._corner = 0 if math.hypot(north, east) > self._config.radius_m else self._corner + 1
        self._arrived_s = None

    def _corner_of(self, centre: Motion) -> tuple[float, float]:
        north, east = square_spiral(self._corner, self._config.spacing_m)
        return (centre.position_m[0] + north, centre.position_m[1] + east)
