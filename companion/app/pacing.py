"""When control cycles begin, what one does that comes late, and how much of the computer vision may take."""

import asyncio
import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from statistics import fmean, median
from typing import Final

from companion.base.clock import Clock
from companion.base.messages import AutopilotSetup
from companion.link.autopilot_setup import SHORTEST_TIMEOUT_S
from companion.link.codec import Severity
from companion.link.session import Session
from companion.link.transport import backlog_read
from companion.plan.inputs import ComputerLoad
from companion.plan.landing.contact import UNSEEN_S

# ---------------------------------------------------------------- how much of the computer vision may take
# Vision and control share the processor, where it has one core or is held back. While control is late by more
# than a period, so that cycles are lost, each step leaves the processor alone for one more of vision's own
# times after a frame; a step back follows after long enough without a late cycle. A cycle that is a little
# late costs less than an old sighting. Each step is announced, and so is control that is late all the same:
# FIFO overflows and lost estimates follow from it.

FRAMES: Final = 10  # by which vision's time is known
JUDGED_CYCLES: Final = 30  # control's, by which a step is judged; the next one after as many
CALM_CYCLES: Final = 600  # twenty seconds at 30 Hz
LATE_SHARE: Final = 0.5  # of a period: a cycle is late


class VisionPace:
    """`took` and `rest` after each frame, `judge` in each control cycle."""

    def __init__(self, notify: Callable[[str, str, Severity], None]) -> None:
        self._notify = notify
        self._took_s: deque[float] = deque(maxlen=FRAMES)
        self._late_s: deque[float] = deque(maxlen=JUDGED_CYCLES)
        self._calm = 0
        self._told = False  # that no fewer frames are left to take
        self.rests = 0  # of vision's own times after a frame

    @property
    def vision_s(self) -> float | None:
        """How long (s) a frame takes from its receipt until it is used; None until some have come."""
        return median(self._took_s) if len(self._took_s) == FRAMES else None

    async def rest(self, took_s: float) -> None:
        """A frame took so long: leave the processor to control for a while, while frames are not too rare."""
        self._took_s.append(took_s)
        if self.rests:
            await asyncio.sleep(min(self.rests * took_s, max(0.0, UNSEEN_S - took_s)))

    def judge(self, late_s: float, period_s: float) -> None:
        """A control cycle begins, so late."""
        self._late_s.append(late_s)
        self._calm = self._calm + 1 if late_s <= LATE_SHARE * period_s else 0
        if len(self._late_s) < JUDGED_CYCLES:
            return
        mean_s = fmean(self._late_s)
        late = mean_s > period_s
        more = late and self._fewer_left
        if late and not more and not self._told:
            self._told = True
            words = f"control {1e3 * mean_s:.0f} ms late, vision already at its lowest rate"
            self._notify("computer", words, "warning")
        if self._calm >= CALM_CYCLES:
            self._told = False
        if more or (self.rests and self._calm >= CALM_CYCLES):
            self.rests += 1 if more else -1
            self._late_s.clear()
            self._calm = 0
            share = "every frame" if not self.rests else f"1 of {1 + self.rests} frames"
            why = f"control {1e3 * mean_s:.0f} ms late" if more else "control in time"
            self._notify("computer", f"{why}: vision takes {share}", "warning" if more else "info")

    @property
    def _fewer_left(self) -> bool:
        """Whether fewer frames still follow one another closely enough to fly by."""
        vision_s = self.vision_s
        return vision_s is not None and (1 + self.rests) * vision_s < UNSEEN_S


# ---------------------------------------------------------------- when control cycles begin
# By a timer alone a cycle begins at any phase of the camera's, and what a frame shows waits up to a period
# for it. Here a cycle begins as soon as a frame is fused, a little before or after the timer is due; the
# timer is drawn towards the frames, and stands where few come too late. A camera whose rate does not fit (25
# frames a second beside 30 cycles), or that is silent, changes nothing: the timer goes on.

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
        """Wait until the next is to begin."""
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


# ---------------------------------------------------------------- a process that was stopped and goes on
# By SIGSTOP, a card that does not answer, a suspended laptop. The control loop reads what has arrived
# meanwhile before it plans. After a while that is not enough: the socket's buffer keeps the oldest of what
# arrived, so the newest mode in it may be from before the autopilot's failsafe, or the pilot, chose another.
# Then it waits for a heartbeat that comes in now. The loop's clock stands still while the machine is
# suspended, so that nothing looks old afterwards; the clock here goes on (CLOCK_BOOTTIME).

BUFFER_S: Final = 1.0  # Linux' usual buffer holds more than this
_LOOK_S: Final = 0.02
RECENT_CYCLES: Final = 90  # three seconds, in which an autopilot's failsafe shows
CYCLES: Final = 600  # twenty seconds at 30 Hz
LATELY: Final = 30  # cycles, by which the computer is judged

# The delay margin that control promises (docs/explanation/margins.md): later, the vehicle swings.
LATEST_S: Final = 0.1


class LoopMonitor:
    """`turn` in every control cycle; what is to be sent asks `silent` first.

    `heard` counts what was read from the link.
    """

    def __init__(self, session: Session, clock: Clock, pace: VisionPace | None = None) -> None:
        self._session, self._clock, self._pace = session, clock, pace
        self.heard = 0
        self._turned_s: float | None = None
        self._slept_s = clock.suspended_s()
        self.woke = False  # this cycle is the first after a suspension: what is known is from long before
        self._recent: deque[bool] = deque(maxlen=CYCLES)
        self._late_s: deque[float] = deque(maxlen=RECENT_CYCLES)

    @property
    def stall_s(self) -> float:
        """So long a halt (s) is a stall: by then the autopilot flies by itself, or the buffer overflows."""
        keeps_s = (self._session.setup or AutopilotSetup()).keeps_setpoint_s
        # one that is set shorter than any should be does not make every cycle a stall
        return min(BUFFER_S, max(SHORTEST_TIMEOUT_S, keeps_s))

    def turn(self, late_s: float, period_s: float) -> None:
        """A cycle begins, so late."""
        self._turned_s = self._now_s()
        self._recent.append(late_s > LATE_SHARE * period_s)
        self._late_s.append(late_s)
        if self._pace is not None:
            self._pace.judge(late_s, period_s)

    def end(self) -> None:
        """The loop has ended: what is to be sent after it does not wait for it."""
        self._turned_s = None

    @property
    def late_share(self) -> float:
        """Share of the last `CYCLES` that came late by more than half a period: as the machine is now."""
        return sum(self._recent) / max(1, len(self._recent))

    @property
    def load(self) -> ComputerLoad:
        """Whether the computer keeps up, for the planner."""
        latest_s = max(self._late_s, default=0.0)
        return ComputerLoad(self._too_slow(latest_s), latest_s, next(reversed(self._late_s), 0.0), self.woke)

    def _too_slow(self, latest_s: float) -> str | None:
        """In words, that it is too slow to fly by. One stall is not: what stands still again and again is."""
        vision_s = None if self._pace is None else self._pace.vision_s
        if latest_s > LATEST_S and len(self._late_s) >= LATELY and (late_s := self._lately_s()) > LATEST_S:
            late_ms, most_ms = 1e3 * late_s, 1e3 * LATEST_S
            return f"computer too slow: control {late_ms:.0f} ms late, limit {most_ms:.0f}"
        if vision_s is not None and vision_s > UNSEEN_S:
            took_ms, most_ms = 1e3 * vision_s, 1e3 * UNSEEN_S
            return f"computer too slow: vision {took_ms:.0f} ms a frame, limit {most_ms:.0f}"
        return None

    def _lately_s(self) -> float:
        """How late the last cycles were on average, no stall counting for more than it takes to be one."""
        stall_s = self.stall_s
        return fmean([min(late_s, stall_s) for late_s in list(self._late_s)[-LATELY:]])

    @property
    def silent(self) -> bool:
        """Whether the control loop stands still: what other tasks send now would be by old knowledge."""
        return self._turned_s is not None and self._now_s() - self._turned_s > self.stall_s

    def slept_s(self) -> float:
        """How long (s) the machine has been suspended since this was asked last."""
        before, self._slept_s = self._slept_s, self._suspended_s()
        slept_s = self._slept_s - before
        self.woke = slept_s > self.stall_s
        return slept_s

    def _now_s(self) -> float:
        return self._clock.now_s() + self._suspended_s()

    def _suspended_s(self) -> float:
        """Held up between the two clocks that it is read from, it would be too little."""
        return max(self._slept_s, self._clock.suspended_s())

    async def catch_up(self, late_s: float, alive: Callable[[], None]) -> bool:
        """Read what has arrived; after a stall wait for the next heartbeat. Returns whether it was one.

        Without a heartbeat within its time-out the link counts as lost, and the planner learns that.
        """
        await backlog_read(lambda: self.heard)
        if late_s <= self.stall_s:
            return False
        heard = self._session.heartbeats
        until_s = self._clock.now_s() + self._session.heartbeat_timeout_s
        while self._session.heartbeats == heard and self._clock.now_s() < until_s:
            self._turned_s = self._now_s()
            alive()
            await asyncio.sleep(_LOOK_S)
        return True
