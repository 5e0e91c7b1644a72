"""The autopilot's stamps, counted from its boot, as times of ours: each measurement's own instant. Pure.

TIMESYNC tells the offset between the clocks, a little better or worse from answer to answer; followed at
once it would put samples out of order, so small changes are followed slowly and only a jump at once.
Until TIMESYNC has settled, and from a restart of the autopilot until it has settled again, there are no
times: a stamp that makes a moment long past, or still to come, belongs to another clock.
"""

from __future__ import annotations

from typing import Final

from companion.link.timesync import TimeSync

OLDEST_S: Final = 1.0
FUTURE_S: Final = 0.05  # half a round trip of a slow link
JUMP_S: Final = 0.02
SLEW: Final = 0.02  # seconds a second: 0.1 ms between two samples at 200 Hz
RESTART_S: Final = 2.0  # a stamp that goes back further is not late, it counts from a new boot
WRAP_S: Final = 2**32 * 1e-3  # of time_boot_ms: 49.7 days


class BootClock:
    """Turns stamps into our time, strictly rising within each stream; None for one that is not to be used."""

    def __init__(self, timesync: TimeSync) -> None:
        self._timesync = timesync
        self._offset_s: float | None = None
        self._followed_s = 0.0
        self._last: dict[str, tuple[float, float]] = {}

    def time_s(self, stream: str, stamp_s: float, now_s: float) -> float | None:
        """Our time of a stamp (s since boot) heard now; None: unknown clock, repeated, late or impossible.

        A stamp of 32 bits in ms may have wrapped: it is taken as the moment nearest to now.
        """
        offset_s = self._offset(now_s)
        if offset_s is None:
            return None
        expected_s = now_s + offset_s
        unwrapped_s = stamp_s + round((expected_s - stamp_s) / WRAP_S) * WRAP_S
        ours_s = unwrapped_s - offset_s
        if not -OLDEST_S <= ours_s - now_s <= FUTURE_S:
            return None
        if (last := self._last.get(stream)) is not None:
            last_stamp_s, last_ours_s = last
            if 0.0 <= last_stamp_s - unwrapped_s < RESTART_S or ours_s <= last_ours_s:
                return None
        self._last[stream] = (unwrapped_s, ours_s)
        return ours_s

    def _offset(self, now_s: float) -> float | None:
        target_s = self._timesync.offset_s
        if target_s is None or not self._timesync.settled:
            self._offset_s = None
            return None
        if self._offset_s is None or abs(target_s - self._offset_s) > JUMP_S:
            self._offset_s = target_s
        else:
            reach_s = SLEW * max(now_s - self._followed_s, 0.0)
            self._offset_s += max(-reach_s, min(reach_s, target_s - self._offset_s))
        self._followed_s = now_s
        return self._offset_s
