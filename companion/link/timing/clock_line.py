"""Another clock's offset and rate against ours, estimated together from round trips. Pure.

A round trip from a to b of our time in which that clock read c bounds its offset, c - b <= offset <= c - a,
whatever delayed it on its way. Within these bounds a Kalman filter of offset and rate weighs the quickest
trips most: delays only ever add, so the longest trip is the least accurate. An estimate outside the bounds is
not noise. A little outside, the clock's rate has changed; far outside, that clock has stood still or was set
(a simulator on a busy machine does both), and the offset starts again with the rate kept.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

_QUICKEST_OF: Final = 50  # trips: 10 s at 5 Hz
_LONG_S: Final = 0.05  # a trip longer than the quickest by more gives only its bounds
_FLOOR_S: Final = 0.0005  # of a trip's standard deviation
_UNLIKE: Final = 0.1  # by which share of the quickest trips the two ways may differ
_RATE_STD: Final = 0.005  # at first: crystals differ by 1e-4, a simulator's clock by a few percent
_RATE_WALK: Final = 0.001  # 1/sqrt(s)
_FASTEST: Final = 0.1
_MARGIN_S: Final = 0.001  # of the bounds: stamps are rounded
JUMP_S: Final = 0.03


@dataclass(frozen=True, slots=True)
class Trip:
    """A question sent and its answer received (our time, s), and that clock's time between the two."""

    sent_s: float
    received_s: float
    theirs_s: float

    @property
    def length_s(self) -> float:
        return self.received_s - self.sent_s

    @property
    def middle_s(self) -> float:
        return 0.5 * (self.sent_s + self.received_s)

    @property
    def offset_s(self) -> float:
        """Their clock minus ours, were both ways alike; off by half the length at most."""
        return self.theirs_s - self.middle_s


@dataclass(frozen=True, slots=True)
class ClockLine:
    """Theirs = ours + offset_s + rate * (ours - at_s)."""

    at_s: float
    offset_s: float
    rate: float

    def offset_at(self, ours_s: float) -> float:
        """Their clock minus ours at a time of ours."""
        return self.offset_s + self.rate * (ours_s - self.at_s)

    def to_ours(self, theirs_s: float) -> float:
        """Our time of a moment given in theirs."""
        return self.at_s + (theirs_s - self.offset_s - self.at_s) / (1.0 + self.rate)


class ClockFilter:
    """Takes trips in the order of their answers; `line` is what they give by now."""

    def __init__(self, first: Trip) -> None:
        self.line = ClockLine(first.middle_s, first.offset_s, 0.0)
        # variances of offset (s²) and rate, and their covariance (s)
        self._pp = (0.5 * first.length_s + _FLOOR_S) ** 2
        self._pr, self._rr = 0.0, _RATE_STD**2
        self._lengths_s = deque((first.length_s,), maxlen=_QUICKEST_OF)

    def add(self, trip: Trip) -> None:
        elapsed_s = max(trip.middle_s - self.line.at_s, 0.0)
        self._predict(elapsed_s)
        self._lengths_s.append(trip.length_s)
        outside_s = self._outside_s(trip)
        if abs(outside_s) > JUMP_S:
            self._jump(trip, outside_s)
            return
        if outside_s != 0.0:
            self._pp += outside_s**2
            self._rr += (outside_s / max(elapsed_s, 0.1)) ** 2
        self._rely_on(trip)
        self._move(-self._outside_s(trip))

    def _predict(self, elapsed_s: float) -> None:
        line = self.line
        now_s = line.at_s + elapsed_s
        self.line = ClockLine(now_s, line.offset_at(now_s), line.rate)
        walk = _RATE_WALK**2 * elapsed_s
        self._pp += 2.0 * elapsed_s * self._pr + elapsed_s**2 * (self._rr + walk / 3.0)
        self._pr += elapsed_s * (self._rr + 0.5 * walk)
        self._rr += walk

    def _rely_on(self, trip: Trip) -> None:
        """Take the trip as a measurement: the less it took beyond the quickest, the better."""
        spare_s = trip.length_s - min(self._lengths_s)
        if spare_s <= _LONG_S:
            std_s = _FLOOR_S + 0.5 * spare_s + _UNLIKE * trip.length_s
            self._update(trip.offset_s - self.line.offset_s, std_s**2)

    def _update(self, innovation_s: float, variance_s2: float) -> None:
        total = self._pp + variance_s2
        k, kr = self._pp / total, self._pr / total
        rate = self.line.rate + kr * innovation_s
        self.line = ClockLine(
            self.line.at_s, self.line.offset_s + k * innovation_s, max(-_FASTEST, min(_FASTEST, rate))
        )
        self._rr -= kr * self._pr
        self._pp, self._pr = (1.0 - k) * self._pp, (1.0 - k) * self._pr

    def _outside_s(self, trip: Trip) -> float:
        """How far (s, signed) the offset lies outside what the trip allows."""
        reach_s = 0.5 * trip.length_s + _MARGIN_S
        off_s = self.line.offset_s - trip.offset_s
        return math.copysign(max(abs(off_s) - reach_s, 0.0), off_s)

    def _jump(self, trip: Trip, outside_s: float) -> None:
        """Start again at the nearest offset that the trip allows."""
        self._move(-outside_s)
        self._pp, self._pr = (0.5 * trip.length_s + _FLOOR_S) ** 2, 0.0
        self._rely_on(trip)

    def _move(self, by_s: float) -> None:
        self.line = ClockLine(self.line.at_s, self.line.offset_s + by_s, self.line.rate)
