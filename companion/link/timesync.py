"""The autopilot's clock against ours by MAVLink's TIMESYNC, and its stamps as times of ours. Pure.

We send our time ts1; the autopilot answers with its own, tc1, and ts1 again: a round trip, of which
`ClockFilter` makes offset and rate. A clock that goes back has been restarted: until enough answers have come
it is unknown again. `BootClock` turns stamps into times by it.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

# ---------------------------------------------------------------- a line through round trips
# A round trip from a to b of our time in which that clock read c bounds its offset, c - b <= offset <= c - a,
# whatever delayed it on its way. Within these bounds a Kalman filter of offset and rate weighs the quickest
# trips most: delays only ever add, so the longest trip is the least accurate. An estimate outside the bounds
# is not noise. A little outside, the clock's rate has changed; far outside, that clock has stood still or was
# set (a simulator on a busy machine does both), and the offset starts again with the rate kept.

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


_SETTLED: Final = 5
_KEPT: Final = 50  # questions whose answer may still come: of 5 s and more
_RECENT: Final = 3  # answers, of which the quickest tells how late the link is
_RECENT_S: Final = 3.0
_ANOTHER_CLOCK_S: Final = 2.0  # a clock that is off by more is another one
_BACK_S: Final = 0.1  # and so is one that has gone back by more
_NS: Final = 1e9


class TimeSync:
    """Keeps what is known of the autopilot's clock."""

    def __init__(self) -> None:
        self._asked_ns: deque[int] = deque(maxlen=_KEPT)
        self._filter: ClockFilter | None = None
        self._newest: Trip | None = None
        self._recent: deque[Trip] = deque(maxlen=_RECENT)
        self._answers = 0

    @property
    def line(self) -> ClockLine | None:
        """The autopilot's clock against ours; None before the first answer."""
        return None if self._filter is None else self._filter.line

    @property
    def settled(self) -> bool:
        """Whether there have been enough answers to choose from since the start, or a restart over there."""
        return self._answers >= _SETTLED

    @property
    def offset_s(self) -> float | None:
        """The autopilot's clock minus ours at the newest answer; None before the first."""
        return None if self._filter is None else self._filter.line.offset_s

    @property
    def round_trip_s(self) -> float | None:
        """The quickest of the last three answers, at the newest one; None while there are not three in 3 s.

        One slow answer says nothing: a radio that repeats what was lost gives such.
        """
        trips = [trip for trip in self._recent if self._recent[-1].received_s - trip.received_s <= _RECENT_S]
        return min(trip.length_s for trip in trips) if len(trips) == _RECENT else None

    def ask(self, now_s: float) -> int:
        """ts1 (ns) of a request sent now."""
        ts1_ns = clock_ns(now_s)
        self._asked_ns.append(ts1_ns)
        return ts1_ns

    def answered(self, tc1_ns: int, ts1_ns: int, now_s: float) -> bool:
        """Take a reply; False when it answers no question of ours (others on the link ask too)."""
        if ts1_ns not in self._asked_ns:
            return False
        self._asked_ns.remove(ts1_ns)
        trip = Trip(ts1_ns / _NS, max(now_s, ts1_ns / _NS), tc1_ns / _NS)
        if self._is_another_clock(trip):
            self._filter, self._answers = None, 0
        if self._filter is None:
            self._filter = ClockFilter(trip)
        else:
            self._filter.add(trip)
        self._newest = trip
        self._recent.append(trip)
        self._answers += 1
        return True

    def forget(self) -> None:
        """The autopilot was lost: its clock may restart."""
        self._filter = self._newest = None
        self._asked_ns.clear()
        self._recent.clear()
        self._answers = 0

    def _is_another_clock(self, trip: Trip) -> bool:
        """Whether it has gone back, or on by what no stall of it or of ours explains."""
        newest = self._newest
        if newest is None or trip.sent_s < newest.received_s:
            return False  # the questions were under way together: the answers may come in any order
        theirs_s = trip.theirs_s - newest.theirs_s
        passed_s = trip.received_s - newest.sent_s
        return (
            theirs_s < -_BACK_S
            or abs(theirs_s - passed_s) > _ANOTHER_CLOCK_S + trip.length_s + newest.length_s
        )


def clock_ns(now_s: float) -> int:
    """Our time for TIMESYNC; never 0, which would read as a request."""
    return max(round(now_s * _NS), 1)


# ---------------------------------------------------------------- stamps as times of ours
# A small correction of the offset is followed bit by bit; where that clock has stood still, the times jump
# ahead with it. They never go back: what is newer by its stamp is newer by its time, and nothing is refused
# because the mapping was corrected. Until TIMESYNC has settled, and from a restart of the autopilot until it
# has settled again, there are no times: a stamp that makes a moment long past, or still to come, belongs to
# another clock.

OLDEST_S: Final = 1.0
FUTURE_S: Final = 0.15  # as far as a slow link's round trip may mislead; what is used is not of the future
AT_ONCE_S: Final = 0.03  # times that lag by more jump ahead
SLEW: Final = 0.1  # seconds a second: 0.5 ms between two samples at 200 Hz
SLOWEST: Final = 0.1  # at least so much of what passes by the stamps passes by our times
RESTART_S: Final = 2.0  # a stamp that goes back further is not late, it counts from a new boot
WRAP_S: Final = 2**32 * 1e-3  # of time_boot_ms: 49.7 days


class Instant(NamedTuple):
    """Our time of a stamp, and how long after its stream's last one it was by the autopilot's own clock.

    That is None for a stream's first sample. It has no error of the mapping in it.
    """

    time_s: float
    interval_s: float | None


class BootClock:
    """Turns stamps into our time; None for one that is not to be used."""

    def __init__(self, timesync: TimeSync) -> None:
        self._timesync = timesync
        self._line: ClockLine | None = None
        self._ahead_s = 0.0  # by how much the times given are ahead of the line's
        self._followed_s = 0.0  # by their clock
        self._last: dict[str, tuple[float, float]] = {}
        # TIMESYNC takes both directions for equally slow: by how much its times are late, as others found out
        self.late_s = 0.0

    @property
    def settled(self) -> bool:
        return self._timesync.settled

    def instant(self, stream: str, stamp_s: float, now_s: float) -> Instant | None:
        """Of a stamp (s since boot) received now, rising strictly in a stream; None also when repeated."""
        unwrapped_s = self._unwrapped_s(stamp_s, now_s)
        last = self._last.get(stream)
        passed_s = None if last is None else unwrapped_s - last[0]
        if passed_s is not None and -RESTART_S < passed_s <= 0.0:
            return None
        time_s = self._time_s(unwrapped_s, now_s)
        if time_s is None:
            return None
        if last is None or passed_s is None or passed_s <= 0.0:
            passed_s = None
        else:
            time_s = max(time_s, last[1] + SLOWEST * passed_s)
        self._last[stream] = (unwrapped_s, time_s)
        return Instant(time_s, passed_s)

    def time_s(self, stamp_s: float, now_s: float) -> float | None:
        """Our time of a stamp (s since boot) received now; None: unknown clock, or impossible."""
        return self._time_s(self._unwrapped_s(stamp_s, now_s), now_s)

    def _time_s(self, unwrapped_s: float, now_s: float) -> float | None:
        line = self._timesync.line
        if line is None or not self._timesync.settled:
            self._line = None
            return None
        if not -FUTURE_S <= now_s - line.to_ours(unwrapped_s) <= OLDEST_S:
            return None
        return min(self._followed(line, unwrapped_s) - self.late_s, now_s)

    def _unwrapped_s(self, stamp_s: float, now_s: float) -> float:
        """A stamp of 32 bits in ms may have wrapped: it is taken as the moment nearest to now."""
        line = self._timesync.line
        if line is None:
            return stamp_s
        expected_s = now_s + line.offset_at(now_s)
        return stamp_s + round((expected_s - stamp_s) / WRAP_S) * WRAP_S

    def _followed(self, line: ClockLine, stamp_s: float) -> float:
        """Our time of a stamp by a line that may have been corrected since the last one."""
        if self._line is None:
            self._ahead_s, self._followed_s = 0.0, stamp_s
        elif line is not self._line:
            self._ahead_s += self._line.to_ours(stamp_s) - line.to_ours(stamp_s)
        if self._ahead_s < -AT_ONCE_S:
            self._ahead_s = 0.0
        reach_s = SLEW * max(stamp_s - self._followed_s, 0.0)
        self._ahead_s -= max(-reach_s, min(reach_s, self._ahead_s))
        self._line, self._followed_s = line, max(stamp_s, self._followed_s)
        return line.to_ours(stamp_s) + self._ahead_s
