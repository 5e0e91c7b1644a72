"""Looking for the pad: hold, ask the ground station where it is, fly there, spiral (Algorithm 1, else-branch).

What is known of the pad's place is a `Lead`: the ground station's beacon, the last sight, or the point where
the search began; the newest counts. It is led by its velocity for a while only, since a pad that circles is
not where a straight line says. Everything in the EKF's NED, m and s; the height is chosen on entry and kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.config import SearchConfig
from companion.geometry import ZERO3, Vector3, ned_from_geodetic
from companion.messages import PadBeacon
from companion.plan.min_jerk import Motion

# At a corner of the spiral the next one is taken up this long before the reference would come to rest.
_CORNER_M = 1.0


def square_spiral(corner: int, spacing_m: float) -> tuple[float, float]:
    """North and east (m) of a corner of the expanding square; corner 0 is its centre.

    The legs are 1, 1, 2, 2, 3, 3, ... spacings long, so that neighbouring turns lie one spacing apart.
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

    def at(self, now_s: float, lead_s: float) -> Motion:
        """Where it should be now; after lead_s it is taken to stand where it would have been by then."""
        age_s = max(0.0, now_s - self.time_s)
        p, v = self.position_ned_m, self.velocity_ned_m_s
        led_s = min(age_s, lead_s)
        velocity = (v[0], v[1], 0.0) if age_s < lead_s else ZERO3
        return Motion((p[0] + v[0] * led_s, p[1] + v[1] * led_s, 0.0), velocity)


class Search:
    """One search after another: `begin` at each, then `target` every cycle."""

    def __init__(self, config: SearchConfig) -> None:
        self._config = config
        self._beacon: Lead | None = None
        self._beacon_seen: PadBeacon | None = None
        self._sight: Lead | None = None
        self._start = Lead(0.0, ZERO3)
        self._down_m = 0.0
        self._corner = 0

    def hear(self, beacon: PadBeacon | None, origin: Vector3 | None) -> None:
        """Take in the ground station's word; `origin` is the EKF's (latitude deg, longitude deg, m)."""
        if beacon is None or origin is None or beacon == self._beacon_seen:
            return
        self._beacon_seen = beacon
        position = ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, origin)
        word = Lead(beacon.time_s, position, beacon.velocity_ned_m_s)
        if self._surprising(word):
            self._corner = 0
        self._beacon = word

    def remember(self, pad: Motion, seen_s: float, now_s: float) -> None:
        """Keep the last sight of the pad, as the filter leads it to now."""
        p, v = pad.position_m, pad.velocity_m_s
        age_s = now_s - seen_s
        self._sight = Lead(seen_s, (p[0] - v[0] * age_s, p[1] - v[1] * age_s, 0.0), v)

    def begin(self, here: Vector3, climb_m: float, now_s: float) -> float:
        """Start at a place in the EKF's NED; returns the climb (m), bounded, that the search will make."""
        climb_m = max(0.0, min(self._config.climb_m, climb_m))
        self._start = Lead(-math.inf, here)
        self._down_m = here[2] - climb_m
        self._corner = 0
        return climb_m

    def target(self, reference: Vector3, now_s: float) -> Motion:
        """Where to fly: the pad's likely place first, then the corners of a spiral about it."""
        centre = self._likely(now_s)
        if self._distance(reference, self._corner_at(centre)) < _CORNER_M:
            self._next_corner()
        north, east = self._corner_at(centre)
        return Motion((north, east, self._down_m), centre.velocity_m_s)

    def known(self, now_s: float) -> str:
        """What the search goes by, in words."""
        newest = self._newest(now_s)
        if newest is self._start:
            return "no word of the pad"
        return "the beacon" if newest is self._beacon else "the last sight"

    def _newest(self, now_s: float) -> Lead:
        words = [w for w in (self._beacon, self._sight) if w and now_s - w.time_s <= self._config.trust_s]
        return max(words, key=lambda word: word.time_s, default=self._start)

    def _likely(self, now_s: float) -> Motion:
        newest = self._newest(now_s)
        if newest is self._start:
            return Motion(newest.position_ned_m)
        return newest.at(now_s, self._config.lead_s)

    def _surprising(self, word: Lead) -> bool:
        """Whether a new word lies far from where the old one led."""
        expected = self._likely(word.time_s).position_m
        return self._distance(expected, word.position_ned_m) > self._config.spacing_m

    def _corner_at(self, centre: Motion) -> tuple[float, float]:
        north, east = square_spiral(self._corner, self._config.spacing_m)
        return (centre.position_m[0] + north, centre.position_m[1] + east)

    def _next_corner(self) -> None:
        north, east = square_spiral(self._corner + 1, self._config.spacing_m)
        # beyond the radius it begins anew: the pad may have come closer meanwhile
        self._corner = 0 if math.hypot(north, east) > self._config.radius_m else self._corner + 1

    @staticmethod
    def _distance(place: Vector3, point: tuple[float, float] | Vector3) -> float:
        return math.hypot(place[0] - point[0], place[1] - point[1])
