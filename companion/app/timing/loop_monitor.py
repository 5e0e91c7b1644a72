"""A process that was stopped and goes on: by SIGSTOP, a card that does not answer, a suspended laptop.

The control loop reads what has arrived meanwhile before it plans. After `STALL_S` that is not enough: the
socket's buffer keeps the oldest of what arrived, so the newest mode in it may be from before the autopilot's
failsafe, or the pilot, chose another. Then it waits for a heartbeat that comes in now.

The loop's clock stands still while the machine is suspended, so that nothing looks old afterwards; the clock
here goes on (CLOCK_BOOTTIME).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Final

from companion.base.clock import Clock
from companion.link.session import Session
from companion.link.transport import backlog_read

# PX4 leaves OFFBOARD after COM_OF_LOSS_T (1 s) without setpoints; Linux' usual buffer holds more than this.
STALL_S: Final = 1.0
_LOOK_S: Final = 0.02
LATELY: Final = 90  # three seconds
CYCLES: Final = 600  # twenty seconds at 30 Hz


class LoopMonitor:
    """`turn` in every control cycle; what is to be sent asks `silent` first.

    `heard` counts what was read from the link.
    """

    def __init__(self, session: Session, clock: Clock) -> None:
        self._session, self._clock = session, clock
        self.heard = 0
        self._turned_s: float | None = None
        self._slept_s = clock.suspended_s()
        self.woke = False  # this cycle is the first after a suspension: what is known is from long before
        self._recent: deque[bool] = deque(maxlen=CYCLES)

    def turn(self, late_s: float, period_s: float) -> None:
        """A cycle begins, so late."""
        self._turned_s = self._now_s()
        self._recent.append(late_s > 0.5 * period_s)

    def end(self) -> None:
        """The loop has ended: what is to be sent after it does not wait for it."""
        self._turned_s = None

    @property
    def late_share(self) -> float:
        """Share of the last `CYCLES` that came late by more than half a period: as the machine is now."""
        return sum(self._recent) / max(1, len(self._recent))

    def recently_late(self) -> float:
        """The same share, of the last `LATELY` cycles: what is so now, and no stall of a minute ago."""
        lately = list(self._recent)[-LATELY:]
        return sum(lately) / LATELY

    @property
    def silent(self) -> bool:
        """Whether the control loop stands still: what other tasks send now would be by old knowledge."""
        return self._turned_s is not None and self._now_s() - self._turned_s > STALL_S

    def slept_s(self) -> float:
        """How long (s) the machine has been suspended since this was asked last."""
        before, self._slept_s = self._slept_s, self._suspended_s()
        slept_s = self._slept_s - before
        self.woke = slept_s > STALL_S
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
        if late_s <= STALL_S:
            return False
        heard = self._session.heartbeats
        until_s = self._clock.now_s() + self._session.heartbeat_timeout_s
        while self._session.heartbeats == heard and self._clock.now_s() < until_s:
            self._turned_s = self._now_s()
            alive()
            await asyncio.sleep(_LOOK_S)
        return True
