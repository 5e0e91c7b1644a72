"""The autopilot's clock against ours by MAVLink's TIMESYNC: offset and rate. Pure.

We send our time ts1; the autopilot answers with its own, tc1, and ts1 again: a round trip, and `clock_line`
makes of trips what they can show. A clock that goes back has been restarted: until enough answers have
come it is unknown again.
"""

from collections import deque
from typing import Final

from companion.link.timing.clock_line import ClockFilter, ClockLine, Trip

_SETTLED: Final = 5
_KEPT: Final = 50  # questions whose answer may still come: of 5 s and more
_RECENT: Final = 3  # answers, of which the quickest tells how late the link is
_RECENT_S: Final = 3.0
_RESTART_S: Final = 2.0  # a clock that is off by more is another one
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
    def offset_s(self) -> float | None:
        """The autopilot's clock minus ours at the newest answer; None before the first."""
        return None if self._filter is None else self._filter.line.offset_s

    @property
    def settled(self) -> bool:
        """Whether there have been enough answers to choose from since the start, or a restart over there."""
        return self._answers >= _SETTLED

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
        return theirs_s < -_BACK_S or abs(theirs_s - passed_s) > _RESTART_S + trip.length_s + newest.length_s


def clock_ns(now_s: float) -> int:
    """Our time for TIMESYNC; never 0, which would read as a request."""
    return max(round(now_s * _NS), 1)
