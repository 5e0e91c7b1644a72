"""A number that two sources contradict is not flown with: refused on the ground, handed back in flight."""

from pathlib import Path
from typing import Any

from companion.base.messages import Outcome, Phase
from companion.flightlog.record import FlightLog
from tests.scenario.flying import FEW_PICTURES, fly_logged, notices, scenario_file


def flown(folder: Path, name: str = "static", **changes: Any) -> tuple[Outcome, FlightLog]:
    flight, log = fly_logged(scenario_file(folder, name, {**FEW_PICTURES, **changes}))
    return flight.report.outcome, log


def began_s(log: FlightLog, phase: Phase) -> float:
    return float(next(step.time_s for step in log.kept["plan"] if step.phase is phase))


def test_a_board_that_lies_12_deg_askew_does_not_take_off(tmp_path: Path) -> None:
    turned = {"kind": "imu_turned", "start_s": 0.0, "rotation_body_deg": [0.0, 12.0, 0.0]}
    outcome, log = flown(
        tmp_path, faults=[turned], companion={"plan": {"mission": {"phases": {"connect_s": 20.0}}}}
    )
    assert outcome is Outcome.ABORTED
    assert {step.phase for step in log.kept["plan"]} == {Phase.CONNECT, Phase.ABORT}
    assert "waiting: attitude: our horizon roll" in notices(log)
    assert "12." in notices(log)


def test_a_board_that_slips_by_20_deg_in_the_approach_returns_control_within_a_second(tmp_path: Path) -> None:
    slips = {
        "kind": "imu_turned",
        "phase": "approach",
        "rotation_body_deg": [20.0, 0.0, 0.0],
        "slips_for_s": 0.3,
    }
    outcome, log = flown(tmp_path, faults=[slips])
    assert outcome is Outcome.ABORTED
    assert began_s(log, Phase.ABORT) - began_s(log, Phase.APPROACH) < 1.0
    assert "estimate disputed: attitude: our horizon roll" in notices(log)


def test_a_pad_printed_at_71_percent_is_given_up_by_its_name(tmp_path: Path) -> None:
    outcome, log = flown(tmp_path, camera={"rate_hz": 30.0}, faults=[{"kind": "pad_resized", "start_s": 0.0}])
    assert outcome is Outcome.ABORTED
    assert "pad disputed: pad's scale: the pad's file 100 %" in notices(log)
    assert began_s(log, Phase.ABORT) - began_s(log, Phase.APPROACH) < 15.0
