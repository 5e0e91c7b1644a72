"""The result of a flight against the simulator, by the truth that the simulator reports."""

from __future__ import annotations

from companion.base.messages import Outcome
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result, build_result, from_start
from companion.sim.runner import SitlFlight
from companion.sim.trial import Trial


def score(trial: Trial, flight: SitlFlight, log: FlightLog) -> Result:
    """The result contract of a flight; times count from the app's first cycle."""
    report = flight.report
    kept, truth = from_start(log.kept, report.truth)
    return build_result(
        scenario=trial.scenario.name,
        seed=trial.seed,
        outcome=report.outcome,
        touchdown=report.touchdown,
        pad_speed_m_s=report.pad_speed_m_s,
        kept=kept,
        truth=truth,
        real_time_factor=flight.real_time_factor,
    )


def reason(result: Result, flight: SitlFlight) -> str:
    """Why a flight did not end in a landing: the mission's own words, or the bounds that were broken."""
    said = [event.text.removeprefix("abort: ") for event in result.events if event.kind == "phase"]
    return said[-1] if result.outcome is Outcome.ABORTED and said else "; ".join(flight.report.failures)
