"""The autopilot's stamps, counted from its boot, as times of ours: each measurement's own instant. Pure.

`TimeSync` gives the offset of its clock from ours, and corrects itself with every answer. A small correction
is followed bit by bit; where that clock has stood still, the times jump ahead with it. They never go back:
what is newer by its stamp is newer by its time, and nothing is refused because the mapping was corrected.
Until TIMESYNC has settled, and from a restart of the autopilot until it has settled again, there are no
times: a stamp that makes a moment long past, or still to come, belongs to another clock.
"""

from typing import Final, NamedTuple

from companion.link.timing.clock_line import ClockLine
from companion.link.timing.timesync import TimeSync

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
        time_s = self.time_s(stamp_s, now_s)
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
        line = self._timesync.line
        if line is None or not self._timesync.settled:
            self._line = None
            return None
        unwrapped_s = self._unwrapped_s(stamp_s, now_s)
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
