"""The bench of the real firmwares: what is flown, how rows are judged, and its exit status."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from benchmarks.firmware import bench_firmware
from benchmarks.firmware.bench_firmware import (
    CASES,
    SETPOINTS,
    FirmwareCase,
    judge,
    line,
    main,
    median_bar,
    write_flights,
)
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun
from sitl.campaign.rows import Row
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.scenario import Scenario, load_scenario
from tests.unit.sitl.campaign.campaign_parts import row
from tests.unit.sitl.firmware.fake_firmware import fake

CALM, WINDY = (next(case for case in CASES if case.windy is windy) for windy in (False, True))


def landings(*lateral_cm: float, name: str = "case") -> list[Row]:
    return [row(name, seed, lateral_m=0.01 * size) for seed, size in enumerate(lateral_cm)]


# ---------------------------------------------------------------- bars


@pytest.mark.parametrize(
    ("case", "lateral_cm", "holds"),
    [
        (CALM, (1.0, 5.0, 90.0), True),
        (CALM, (1.0, 5.1, 6.0), False),
        (WINDY, (1.0, 8.0, 90.0), True),
        (WINDY, (1.0, 8.1, 9.0), False),
        (CALM, (), False),
    ],
)
def test_the_median_has_a_bar_that_wind_widens(
    case: FirmwareCase, lateral_cm: Sequence[float], holds: bool
) -> None:
    assert median_bar("case", case, landings(*lateral_cm)).holds is holds


def test_a_bar_says_what_was_measured_and_what_was_asked() -> None:
    assert str(median_bar("px4-attitude-line", CALM, landings(1.0, 2.0, 3.0))) == (
        "px4-attitude-line lateral p50 2.0 (<= 5) cm holds"
    )
    assert "inf (<= 8) cm FAILS" in str(median_bar("x", WINDY, [row(outcome="crashed")]))


def test_a_line_has_medians_worsts_and_the_other_ends() -> None:
    rows = [
        *landings(1.0, 2.0, 9.0),
        row("case", 3, "timeout"),
        row("case", 4, "crashed"),
        row("case", 5, "timeout"),
    ]
    assert line("case", rows) == ["case", "3/6", "2.0 9.0", "-", "-", "crashed, timeout"]
    assert line("case", []) == ["case", "0/0", "-", "-", "-", ""]


# ---------------------------------------------------------------- the whole


def options(folder: Path, **given: Any) -> argparse.Namespace:
    words = {
        "seeds": 2,
        "first": 5,
        "case": "",
        "setpoint": "",
        "sensors": "boards",
        "as_believed": True,
        "jobs": 1,
        "out": folder,
    }
    return argparse.Namespace(**{**words, **given})


def flown(
    monkeypatch: pytest.MonkeyPatch,
    lateral_cm: float = 1.0,
    failing: frozenset[tuple[str, int]] = frozenset(),
) -> list[CampaignRun]:
    """Make rows up instead of flying; returns the flights that are asked for, once they have been."""
    asked: list[CampaignRun] = []

    def fly(flights: Sequence[CampaignRun], *_: object) -> list[Row]:
        asked.extend(flights)
        return [
            row(f.scenario, f.seed, "crashed")
            if (f.scenario, f.seed) in failing
            else row(f.scenario, f.seed, lateral_m=0.01 * lateral_cm)
            for f in flights
        ]

    monkeypatch.setattr(bench_firmware, "fly", fly)
    return asked


def judged(specs: Sequence[FirmwareSpec], given: argparse.Namespace) -> tuple[int, str]:
    """Exit status and what is said."""
    report = BenchReport(width=200)
    with report.capture() as said:
        judge(specs, given, report)
    return report.exit_status, said.get()


def test_every_case_is_flown_by_every_setpoint_of_every_firmware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds: tuple[AutopilotKind, ...] = ("px4", "ardupilot")
    specs = [fake(kind, tmp_path).spec for kind in kinds]
    asked = flown(monkeypatch)
    status, said = judged(specs, options(tmp_path / "out"))
    assert status == 0
    assert {(f.scenario, f.seed) for f in asked} == {
        (f"{kind}-{setpoint}-{case.name}", seed)
        for kind in kinds
        for setpoint in SETPOINTS[kind]
        for case in CASES
        for seed in (5, 6)
    }
    paths = {spec.kind: spec.path for spec in specs}
    for f in asked:
        assert f.firmware is not None
        assert f.firmware.path == paths[f.firmware.kind]
        assert f.scenario.startswith(f.firmware.kind)
        # its own default: the bench does not tell it the truth
        own = {"px4": ("MPC_THR_HOVER", 0.5), "ardupilot": ("MOT_THST_HOVER", 0.35)}
        assert f.firmware.parameters == (own[f.firmware.kind],)
    assert "FAILS" not in said
    assert f"px4 attitude landed {2 * len(CASES)} of {2 * len(CASES)} (>= 98 %) holds" in said


def test_as_built_every_flight_is_by_a_vehicle_that_is_not_as_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = fake("ardupilot", tmp_path).spec
    asked = flown(monkeypatch)
    status, said = judged([spec], options(tmp_path / "out", as_believed=False, case="static"))
    assert status == 0
    assert [f.scenario for f in asked] == ["ardupilot-attitude-as_built-static"] * 2
    assert all(load_scenario(f.source).as_built is not None and f.firmware == spec for f in asked)
    assert "(>= 97 %)" in said
    assert "unplanned contacts 0 holds" in said


def test_one_bar_that_does_not_hold_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = fake("px4", tmp_path).spec
    flown(monkeypatch, lateral_cm=6.0)  # more than calm air allows, less than wind does
    status, said = judged([spec], options(tmp_path / "out", case="line", setpoint="attitude"))
    assert status == 1
    assert "px4-attitude-line_1 lateral p50 6.0 (<= 5) cm FAILS" in said
    assert "px4-attitude-line_2_wind_8 lateral p50 6.0 (<= 8) cm holds" in said


def test_landings_count_over_all_cases_of_a_setpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = fake("px4", tmp_path).spec
    flown(monkeypatch, failing=frozenset({("px4-acceleration-static", 7)}))
    # of 8 cases one does not land: one in 80 is within the bar, one in 40 is not
    assert judged([spec], options(tmp_path / "a", seeds=10))[0] == 0
    status, said = judged([spec], options(tmp_path / "b", seeds=5))
    assert status == 1
    assert "px4 acceleration landed 39 of 40 (>= 98 %) FAILS" in said
    assert "px4 attitude landed 40 of 40 (>= 98 %) holds" in said


def test_nothing_flown_is_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown(monkeypatch)
    assert judged([fake("px4", tmp_path).spec], options(tmp_path / "out", case="nosuch"))[0] == 1


def test_the_apps_sensors_may_be_the_autopilots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = flown(monkeypatch)
    given = options(tmp_path / "out", case="static", setpoint="velocity", sensors="autopilot")
    assert judged([fake("ardupilot", tmp_path).spec], given)[0] == 0
    assert {f.scenario for f in asked} == {"ardupilot-velocity-telemetry-static"}


def test_the_scenarios_that_are_left_are_those_of_the_cases(tmp_path: Path) -> None:
    spec = fake("ardupilot", tmp_path).spec
    flights = list(write_flights(spec, "velocity", "boards", CASES, range(1), tmp_path))
    for flight, case in zip(flights, CASES, strict=True):
        scenario = load_scenario(flight.source)
        assert scenario == Scenario.model_validate(case.scenario("ardupilot", "velocity"))
        assert (flight.scenario, flight.time_limit_s) == (scenario.name, scenario.time_limit_s)


def test_without_a_firmware_it_says_what_is_expected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["bench_firmware"])
    with pytest.raises(ConfigError, match="expected --px4 BIN, --arducopter BIN or both"):
        main()
    monkeypatch.setattr(sys, "argv", ["bench_firmware", "--px4", str(tmp_path / "nosuch")])
    with pytest.raises(ConfigError, match="expected the program that a SITL build made"):
        main()
