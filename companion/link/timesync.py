"""Clock offset to the autopilot by MAVLink's TIMESYNC. Pure.

We send our time ts1; the autopilot answers with its own, tc1, and ts1 again. Halfway through the round trip
its clock showed tc1, so offset = tc1 - (sent + received) / 2, wrong by at most half the round trip. The
sample with the shortest trip among the last few is the best one: delays only ever add.
"""

from __future__ import annotations

from collections import deque
from typing import Final

_KEPT: Final = 10
_SETTLED: Final = 5
_RESTART_S: Final = 0.5  # a smaller jump is a clock that runs fast or slow, as a simulator's may
_JUMP_MARGIN_S: Final = 0.01
_NS: Final = 1e9


class TimeSync:
    """Keeps the offset between the autopilot's clock and ours, in s."""

    def __init__(self) -> None:
        self._asked_ns: deque[int] = deque(maxlen=4)
        self._trips: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._answers = 0

    @property
    def offset_s(self) -> float | None:
        """The autopilot's clock minus ours; None before the first answer."""
        return min(self._trips)[1] if self._trips else None

    @property
    def round_trip_s(self) -> float | None:
        """The shortest round trip among the last ones; half of it bounds the offset's error."""
        return min(self._trips)[0] if self._trips else None

    @property
    def settled(self) -> bool:
        """Whether there have been enough answers to choose from since the start, or a restart over there."""
        return self._answers >= _SETTLED

    def ask(self, now_s: float) -> int:
        """ts1 (ns) of a request sent now."""
        ts1_ns = clock_ns(now_s)
        self._asked_ns.append(ts1_ns)
        return ts1_ns

    def answered(self, tc1_ns: int, ts1_ns: int, now_s: float) -> bool:
        """Take a reply; False when it answers nobody's question of ours (others on the link ask too)."""
        if ts1_ns not in self._asked_ns:
            return False
        self._asked_ns.remove(ts1_ns)
        sent_s = ts1_ns / _NS
        trip_s = max(now_s - sent_s, 0.0)
        offset_s = tc1_ns / _NS - 0.5 * (sent_s + now_s)
        if self._has_jumped(trip_s, offset_s):
            if abs(offset_s - min(self._trips)[1]) > _RESTART_S:
                self._answers = 0
            self._trips.clear()
        self._trips.append((trip_s, offset_s))
        self._answers += 1
        return True

    def to_ours(self, autopilot_s: float) -> float | None:
        """Our time of a moment told in the autopilot's; None before the first answer."""
        offset_s = self.offset_s
        return None if offset_s is None else autopilot_s - offset_s

    def forget(self) -> None:
        """The autopilot was lost: its clock may start anew."""
        self._trips.clear()
        self._asked_ns.clear()
        self._answers = 0

    def _has_jumped(self, trip_s: float, offset_s: float) -> bool:
        """Whether the two cannot both be right: the autopilot has restarted, or set its clock."""
        if not self._trips:
            return False
        best_trip_s, best_offset_s = min(self._trips)
        return abs(offset_s - best_offset_s) > 0.5 * (trip_s + best_trip_s) + _JUMP_MARGIN_S


def clock_ns(now_s: float) -> int:
    """Our time for TIMESYNC; never 0, which would read as a request."""
    return max(round(now_s * _NS), 1)
