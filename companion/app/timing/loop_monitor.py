"""A process that was stopped and goes on: by SIGSTOP, a card that does not answer, a suspended laptop.

The control loop reads what has arrived meanwhile before it plans. After a while that is not enough: the
socket's buffer keeps the oldest of what arrived, so the newest mode in it may be from before the autopilot's
failsafe, or the pilot, chose another. Then it waits for a heartbeat that comes in now.

The loop's clock stands still while the machine is suspended, so that nothing looks old afterwards; the clock
here goes on (CLOCK_BOOTTIME).
"""

import asyncio
from collections import deque
from collections.abc import Callable
from statistics import fmean
from typing import Final

from companion.app.timing.vision_pace import VisionPace
from companion.base.clock import Clock
from companion.base.messages import AutopilotSetup
from companion.link.autopilot_setup import SHORTEST_TIMEOUT_S
from companion.link.session import Session
from companion.link.transport import backlog_read
from companion.plan.inputs import ComputerLoad
from companion.plan.landing.contact import UNSEEN_S

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
        self._recent.append(late_s > 0.5 * period_s)
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
        return ComputerLoad(self._too_slow(latest_s), latest_s, self.woke)

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
