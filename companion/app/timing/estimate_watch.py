"""Once a second: what became of the estimator's inputs, into the log; on the ground a new start."""

import asyncio
from typing import Final

from companion.app.sensing import Notify
from companion.base.clock import Clock
from companion.base.messages import EstimatorInputs, LandedState
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.session import Session

PERIOD_S: Final = 1.0


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

    async def run(self) -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            self.look(self._clock.now_s())

    def look(self, now_s: float) -> None:
        """Log the counts; an estimate that refuses all of an input starts again where nothing flies by it."""
        self._log.write("estimator_inputs", EstimatorInputs(now_s, self._estimator.tally.uses()), now_s)
        autopilot = self._session.state
        if autopilot.armed or autopilot.landed is not LandedState.ON_GROUND:
            return
        if (words := self._estimator.recover(now_s)) is not None:
            self._notify("estimate", words, "warning")
