"""The second sources' newest comparisons, from where they are measured, and what is announced of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from companion.app.sensing import Notify, Sensing
from companion.base.messages import LandedState, Quantity, SourceComparison
from companion.base.second_sources import announced
from companion.config import VehicleConfig
from companion.estimate.estimator import StateEstimator
from companion.link.session import Session

ECHO_NOISE_M: Final = 0.01  # of one that comes from near


class SourceWatch:
    """Ask it in every cycle; each quantity whose sources differ is announced once a mission."""

    def __init__(
        self,
        estimator: StateEstimator,
        session: Session,
        sensing: Sensing,
        vehicle: VehicleConfig,
        notify: Notify,
        *,
        nearest_echo_m: float,
    ) -> None:
        """`nearest_echo_m`: what is nearer shows as this."""
        self._estimator, self._session, self._sensing = estimator, session, sensing
        self._vehicle, self._notify, self._nearest_echo_m = vehicle, notify, nearest_echo_m
        self._announced: set[Quantity] = set()

    def begin(self) -> None:
        """A new mission."""
        self._announced.clear()
        self._estimator.begin_checks()

    @property
    def comparisons(self) -> tuple[SourceComparison, ...]:
        """The newest of each."""
        return (*self._estimator.comparisons, *self._of_the_link(), *self._of_the_legs())

    def look(self) -> tuple[SourceComparison, ...]:
        """The newest of each; announces what was not announced before."""
        found = self.comparisons
        for quantity, words in announced(found):
            if quantity not in self._announced:
                self._announced.add(quantity)
                self._notify("sources", words, "warning")
        return found

    def _of_the_link(self) -> Iterator[SourceComparison]:
        setup, line = self._session.setup, self._session.timesync.line
        if setup is not None and setup.hover_thrust is not None:
            told, own = self._vehicle.hover_thrust, setup.hover_thrust
            apart = 100.0 * abs(own / told - 1.0)
            yield SourceComparison(0.0, Quantity.HOVER_THRUST, f"{told:.2f}", f"{own:.2f}", apart, 0.0)
        if line is not None and self._session.timesync.settled:
            apart = 100.0 * abs(line.rate)
            yield SourceComparison(line.at_s, Quantity.CLOCK_RATE, "1", f"{1.0 + line.rate:.4f}", apart, 0.0)

    def _of_the_legs(self) -> Iterator[SourceComparison]:
        """Where it stands, on the ground or a pad, the echo comes from as far below as the legs are high."""
        echo, autopilot = self._sensing.last_range, self._session.state
        stands = autopilot.landed is LandedState.ON_GROUND and not autopilot.armed
        if echo is None or not stands or echo.distance_m <= self._nearest_echo_m + ECHO_NOISE_M:
            return
        told_m, seen_m = self._vehicle.leg_height_m, echo.distance_m + self._vehicle.range_position_body_m[2]
        yield SourceComparison(
            echo.time_s,
            Quantity.LEG_HEIGHT,
            f"{100.0 * told_m:.0f} cm",
            f"{100.0 * seen_m:.0f} cm",
            difference=100.0 * abs(seen_m - told_m),
            std=100.0 * ECHO_NOISE_M,
        )
