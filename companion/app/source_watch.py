"""What is announced of the second sources' comparisons; and, once a second, what the estimator uses."""

import asyncio
from collections.abc import Iterator
from typing import Final

from companion.app.sensing import Notify
from companion.base.clock import Clock, unix_time_s
from companion.base.geometry import Vector3
from companion.base.magnetic_field import compare_declination
from companion.base.messages import EstimatorInputs, LandedState, Quantity, SourceComparison
from companion.base.second_sources import announced
from companion.config import EstimateConfig, VehicleConfig
from companion.estimate.estimator import StateEstimator
from companion.flightlog.record import FlightLog
from companion.link.session import Session
from companion.plan.landing.standing_height import StandingHeight


class SourceWatch:
    """Ask it in every cycle; each quantity whose sources differ is announced once a mission."""

    def __init__(
        self,
        estimator: StateEstimator,
        session: Session,
        standing_height: StandingHeight,
        config: EstimateConfig,
        vehicle: VehicleConfig,
        notify: Notify,
    ) -> None:
        self._estimator, self._session, self._standing_height = estimator, session, standing_height
        self._config, self._vehicle, self._notify = config, vehicle, notify
        self._declination: tuple[Vector3, SourceComparison] | None = None  # and where
        self._announced: set[Quantity] = set()

    def begin(self) -> None:
        """A new mission."""
        self._announced.clear()
        self._estimator.begin_checks()

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """The newest of each."""
        return (
            *self._estimator.comparisons,
            *self._of_the_place(),
            *self._of_the_link(),
            *self._standing_height.comparisons,
        )

    def look(self) -> tuple[SourceComparison, ...]:
        """The newest of each; announces what was not announced before."""
        found = self.comparisons
        for quantity, words in announced(found):
            if quantity not in self._announced:
                self._announced.add(quantity)
                self._notify("sources", words, "warning")
        return found

    def _of_the_place(self) -> Iterator[SourceComparison]:
        """The geomagnetic field that was told, where the first fix is; looked up once."""
        place, told = self._estimator.origin, self._config.magnetic_field_ned_ut
        if place is None or told is None:
            return
        if self._declination is None or self._declination[0] != place:
            std_ut = self._config.ekf.field_std_ut
            self._declination = place, compare_declination(told, std_ut, place, unix_time_s())
        yield self._declination[1]

    def _of_the_link(self) -> Iterator[SourceComparison]:
        setup, line = self._session.setup, self._session.timesync.line
        if setup is not None and setup.hover_thrust is not None:
            told, own = self._vehicle.hover_thrust, setup.hover_thrust
            apart = 100.0 * abs(own / told - 1.0)
            yield SourceComparison(0.0, Quantity.HOVER_THRUST, f"{told:.2f}", f"{own:.2f}", apart, 0.0)
        if line is not None and self._session.timesync.settled:
            apart = 100.0 * abs(line.rate)
            yield SourceComparison(line.at_s, Quantity.CLOCK_RATE, "1", f"{1.0 + line.rate:.4f}", apart, 0.0)


# ---------------------------------------------------------------- the estimator's inputs

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
