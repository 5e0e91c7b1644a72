"""The result of a flight against the simulator, by the truth that the simulator reports."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from companion.base.messages import Outcome, Phase
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result, ResultEvent, build_result, from_start, start_s
from companion.sim.runner import SitlFlight
from companion.sim.trial import Trial

GIVEN_UP: Final = frozenset({Phase.HOLD.value, Phase.ABORT.value})


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
        contacts=[replace(contact, time_s=contact.time_s - begun_s) for contact in report.contacts],
        pad_speed_m_s=report.pad_speed_m_s,
        kept=kept,
        truth=truth,
        real_time_factor=flight.real_time_factor,
    )


def reason(result: Result, flight: SitlFlight) -> str:
    """Why a flight did not end in a landing: what ended the mission, and what was touched or broken.

    The app's own words go first wherever it gave up, whatever became of the vehicle afterwards.
    """
    failures, ended = flight.report.failures, _first_end(result.events)
    if not ended or result.outcome is Outcome.LANDED:
        return "; ".join(failures)
    if result.outcome is Outcome.ABORTED:
        failures = failures[1:]  # that it aborted
    return "; ".join((ended, *failures))


def _first_end(events: Iterable[ResultEvent]) -> str:
    """The event by which the mission went into the hold or abort that it ended in; empty: it did not.

    A hold ends in an abort whose own event is that it has come to rest; one that the mission went on from
    ended nothing.
    """
    ended = ""
    for event in events:
        if event.kind == "phase":
            phase, _, words = event.text.partition(": ")
            ended = (ended or words) if phase in GIVEN_UP else ""
    return ended
