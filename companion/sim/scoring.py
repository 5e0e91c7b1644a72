"""The result of a flight against the simulator, by the truth that the simulator reports."""

from __future__ import annotations

from dataclasses import asdict

from companion.base.messages import Outcome
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result, ResultContact, build_result, from_start, start_s
from companion.sim.runner import SitlFlight
from companion.sim.trial import Trial
from sitl.world.score import ContactResult


def score(trial: Trial, flight: SitlFlight, log: FlightLog) -> Result:
    """The result contract of a flight; times count from the app's first cycle."""
    report = flight.report
    begun_s = start_s(log.kept, report.truth)
    kept, truth = from_start(log.kept, report.truth)
    return build_result(
        scenario=trial.scenario.name,
        seed=trial.seed,
        outcome=report.outcome,
        touchdown=report.touchdown,
        as_built=report.as_built,
        contacts=[_counted_from(contact, begun_s) for contact in report.contacts],
        pad_speed_m_s=report.pad_speed_m_s,
        kept=kept,
        truth=truth,
        real_time_factor=flight.real_time_factor,
    )


def _counted_from(contact: ContactResult, start_s: float) -> ResultContact:
    values = asdict(contact)
    return ResultContact(**{**values, "time_s": contact.time_s - start_s})


def reason(result: Result, flight: SitlFlight) -> str:
    """Why a flight did not end in a landing: the mission's own words, or what was touched or broken."""
    said = [event.text.removeprefix("abort: ") for event in result.events if event.kind == "phase"]
    failures = flight.report.failures
    if result.outcome is Outcome.ABORTED and said:
        failures = (said[-1], *failures[1:])
    return "; ".join(failures)
