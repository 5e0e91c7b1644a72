"""Once a second: what became of the estimator's inputs, into the log; on the ground a new start.

A computer that is too slow is named as it happens: FIFO overflows and lost estimates follow from it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from companion.app.sensing import Notify
from companion.base.clock import Clock
from companion.base.messages import EstimatorInputs, LandedState
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.session import Session

PERIOD_S: Final = 1.0
# told from so many late cycles on, and again after fewer than half as many
TOO_SLOW_SHARE: Final = 0.2


class EstimateWatch:
    """`run` is a task of the app's."""

    def __init__(
        self,
        estimator: StateEstimator,
        session: Session,
        log: FlightLog,
        clock: Clock,
        notify: Notify,
    ) -> None:
        self._estimator, self._session, self._log = estimator, session, log
        self._clock, self._notify = clock, notify
        self.late_share: Callable[[], float] = lambda: 0.0
        self._too_slow = False

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            await asyncio.sleep(PERIOD_S)
            self.look(self._clock.now_s())

    def look(self, now_s: float) -> None:
        """Log the counts; an estimate that refuses all of an input starts again where nothing flies by it."""
        self._log.write("estimator_inputs", EstimatorInputs(now_s, self._estimator.tally.uses()), now_s)
        self._watch_load(self.late_share())
        autopilot = self._session.state
        if autopilot.armed or autopilot.landed is not LandedState.ON_GROUND:
            return
        if (words := self._estimator.recover(now_s)) is not None:
            self._notify("estimate", words, "warning")

    def _watch_load(self, late_share: float) -> None:
        if not self._too_slow and late_share >= TOO_SLOW_SHARE:
            words = f"{100.0 * late_share:.0f} % of the control cycles come late"
            self._notify("load", f"too slow a computer, or too busy: {words}", "warning")
            self._too_slow = True
        elif late_share < 0.5 * TOO_SLOW_SHARE:
            self._too_slow = False
