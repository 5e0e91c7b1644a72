"""The simulation's time steps on the running loop.

In virtual time the loop jumps from step to step. In real time a step that comes late is made up for: to the
app that is a burst of late samples, each with its right time. A world that stood still instead would set
back the autopilot's clock, which no real one does: 0.1 s of it in a turn made 3 deg of attitude error.
Only a step later than `LATE_S` is not made up for, since a burst of motion would overflow the vehicle's
buffers. It is said, and what is flown then counts for nothing.
"""

import asyncio
import sys
from collections.abc import Callable
from typing import Final

from companion.base.clock import Clock

# a simulator that falls behind by this much hands out frames and samples too late to fly by; well within what
# the MPU9250's FIFO holds (0.18 s)
LATE_S: Final = 0.1


class TickTimer:
    """Calls the simulation every `period_s`. Make it inside the running loop.

    `start_s` is the loop's time at simulation time 0, `count` the number of ticks done, `latest_s` the
    largest delay of a tick behind the clock: 0 in virtual time.
    """

    def __init__(self, period_s: float) -> None:
        self._clock = Clock()
        self._period_s = period_s
        self.start_s = self._clock.now_s()
        self.count = 0
        self.latest_s = 0.0

    @property
    def now_s(self) -> float:
        return self._clock.now_s()

    @property
    def elapsed_s(self) -> float:
        """Simulation time by the clock, not by the last tick: TIMESYNC is answered by it."""
        return max(0.0, self._clock.now_s() - self.start_s)

    def restart(self) -> None:
        """Simulation time 0 is now."""
        self.start_s = self._clock.now_s()

    async def run(self, tick: Callable[[], None]) -> None:
        """Tick until cancelled, by the loop's timers: a task that sleeps in between costs three times as
        much.
        """
        loop = asyncio.get_running_loop()
        failed: asyncio.Future[None] = loop.create_future()

        def on_timer(due_s: float) -> None:
            if failed.done():
                return
            try:
                self.keep_pace(loop.time() - due_s)
                tick()
            except Exception as error:  # of whatever kind, it ends `run`
                failed.set_exception(error)
                return
            self.count += 1
            loop.call_at(self._due_s(), on_timer, self._due_s())

        loop.call_at(self._due_s(), on_timer, self._due_s())
        await failed

    def _due_s(self) -> float:
        """When the next tick is due: half a tick early, so that simulation time differs from the clock by no
        more than that. An error of milliseconds in a sample's age is an attitude that does not fit the
        frames."""
        return self.start_s + (self.count + 0.5) * self._period_s

    def keep_pace(self, late_s: float) -> None:
        """Shift simulation time by a delay that is too long to make up for; the first such is said."""
        if late_s > LATE_S:
            if self.latest_s <= LATE_S:
                words = f"companion-sitl: {late_s:.1f} s late: too busy a machine for real time"
                print(words, file=sys.stderr, flush=True)
            self.start_s += late_s
        self.latest_s = max(self.latest_s, late_s)
