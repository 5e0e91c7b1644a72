"""Why a flight did not land, as a campaign's row has it: what ended the mission, not how the hold ended."""

import pytest

from companion.base.messages import Outcome
from companion.flightlog.result import Result, ResultEvent
from companion.sim.runner import SitlFlight
from companion.sim.scoring import reason
from sitl.campaign.rows import make_row
from sitl.campaign.worker import RunResult
from sitl.run.report import SimulationReport
from tests.unit.sitl.campaign.campaign_parts import flight
from tests.unit.sitl.campaign.fake_flights import result

SEARCH = "search: control granted: OFFBOARD"
HELD = "hold: pad disputed: camera's rotation: 45 deg apart"
RESTS = "abort: clear: at rest"
ABORTED = ("the app aborted",)


def row_reason(outcome: Outcome, failures: tuple[str, ...], *phases: str) -> str:
    texts = [("phase", text) for text in phases]
    said = [*texts[:1], ("climb", "climbing 1.0 m clear of the pad"), *texts[1:]]
    events = tuple(ResultEvent(time_s=1.0 + k, kind=kind, text=text) for k, (kind, text) in enumerate(said))
    report = SimulationReport(outcome, failures, None, 0.0, 30.0, 0.0, ())
    why = reason(Result.model_construct(outcome=outcome, events=events), SitlFlight(report, 1.0, 0.0))
    return make_row(RunResult(flight(1), 1.0, result(1, "static", outcome.value), why), "0.1.0").reason


@pytest.mark.parametrize(
    ("phases", "told"),
    [
        ((SEARCH, HELD, RESTS), "pad disputed: camera's rotation: 45 deg apart"),
        ((SEARCH, "abort: taken over: mode POSCTL"), "taken over: mode POSCTL"),
        # it went on from the first hold, which ended nothing
        (
            (SEARCH, "hold: link lost: 1.2 s", "search: link up: 0.1 s", "hold: stop requested: told", RESTS),
            "stop requested: told",
        ),
        ((), "the app aborted"),
    ],
)
def test_the_reason_of_an_aborted_flight_is_the_first_event_that_ended_it(
    phases: tuple[str, ...], told: str
) -> None:
    assert row_reason(Outcome.ABORTED, ABORTED, *phases) == told


def test_what_was_touched_stands_beside_it() -> None:
    touched = "touched 1.0 m off at 0.9 m/s"
    aborted = row_reason(Outcome.ABORTED, (*ABORTED, touched), SEARCH, HELD, RESTS)
    assert aborted == f"pad disputed: camera's rotation: 45 deg apart; {touched}"
    crashed = row_reason(Outcome.CRASHED, ("crashed", touched), SEARCH, HELD)
    assert crashed == f"pad disputed: camera's rotation: 45 deg apart; crashed; {touched}"


def test_a_flight_that_gave_nothing_up_has_what_it_failed_by_alone() -> None:
    went_on = (SEARCH, HELD, SEARCH, "landed: disarmed: by LAND")
    assert row_reason(Outcome.MISSED, ("0.9 m off",), *went_on) == "0.9 m off"
    assert row_reason(Outcome.LANDED, (), SEARCH, "landed: disarmed: by LAND") == ""
