"""When control cycles begin: by a timer that follows the camera.

By a timer alone a cycle begins at any phase of the camera's, and what a frame shows waits up to a period for
it. Here a cycle begins as soon as a frame is fused, a little before or after the timer is due; the timer is
drawn towards the frames, and stands where few come too late. A camera whose rate does not fit (25 frames a
second beside 30 cycles), or that is silent, changes nothing: the timer goes on.
"""

import asyncio
import math
from collections import deque
from contextlib import suppress
from statistics import fmean, median
from typing import Final

from companion.base.clock import Clock

# Shares of a period by which a cycle begins before it is due, or waits: one lasts 0.7 to 1.4 periods. The
# controller takes the time since its last step as it is; an early frame waits for a steadier one.
EARLIEST: Final = 0.1
LATEST: Final = 0.3
# Shares of a frame's distance from the time due by which the timer is drawn: more towards late ones, since a
# frame too late for its cycle waits for a whole period
DRAWN_EARLIER: Final = 0.1
DRAWN_LATER: Final = 0.3
FITS: Final = 0.03  # of a period, that whole frames may last longer or shorter
INTERVALS: Final = 30  # by which the frames' rate is known
LOST: Final = 1.75  # of the middle one of them: a longer one has lost a frame
SILENT_FRAMES: Final = 2.5  # intervals without a frame after which none is waited for


class ControlTimer:
    """`restart` at first and after a stall, `next_cycle` after each cycle; `frame_fused` as they come."""

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock, self.period_s = clock, period_s
        self._due_s = self._begin_s = clock.now_s()  # by the timer alone; and with a frame
        self._fused_s = -math.inf
        self._intervals_s: deque[float] = deque(maxlen=INTERVALS)
        self._frame = asyncio.Event()

    @property
    def late_s(self) -> float:
        """How long ago (s) the cycle was to begin."""
        return self._clock.now_s() - self._begin_s

    def restart(self) -> None:
        """A cycle begins now; what was missed is not made up for."""
        self._due_s = self._begin_s = self._clock.now_s()

    def frame_fused(self) -> None:
        """The estimate knows what the newest frame shows."""
        now_s = self._clock.now_s()
        if math.isfinite(self._fused_s):
            self._intervals_s.append(now_s - self._fused_s)
        self._fused_s = now_s
        self._frame.set()

    async def next_cycle(self) -> None:
        self._due_s += self.period_s
        earliest_s = self._due_s - EARLIEST * self.period_s
        latest_s = self._due_s + LATEST * self.period_s
        interval_s = self._interval_s()
        if interval_s is None or self._clock.now_s() - self._fused_s > SILENT_FRAMES * interval_s:
            self._begin_s = self._due_s
            await self._clock.sleep_until(self._begin_s)
            return
        await self._clock.sleep_until(earliest_s)
        near = self._due_s - self._fused_s <= 0.5 * interval_s  # no other frame is nearer to the time due
        frame_s = self._fused_s if near else await self._next_frame(latest_s)
        self._begin_s = min(max(frame_s, earliest_s), latest_s)
        off_s = min(frame_s, latest_s) - self._due_s
        self._due_s += (DRAWN_LATER if off_s > 0.0 else DRAWN_EARLIER) * off_s

    async def _next_frame(self, latest_s: float) -> float:
        """Wait until one is fused, or so long; returns when that was."""
        self._frame.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout_at(latest_s):
                await self._frame.wait()
                return self._fused_s
        return latest_s

    def _interval_s(self) -> float | None:
        """The time between frames, if a whole number of them fits into a period; else None."""
        if len(self._intervals_s) < INTERVALS:
            return None
        middle_s = median(self._intervals_s)
        interval_s = fmean([t for t in self._intervals_s if t <= LOST * middle_s])
        frames = max(1, round(self.period_s / max(interval_s, 1e-3)))
        fits = abs(frames * interval_s - self.period_s) <= FITS * self.period_s
        return interval_s if fits else None
