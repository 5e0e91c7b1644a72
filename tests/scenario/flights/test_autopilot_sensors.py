"""Flights on the autopilot's own sensors, by its telemetry: no MPU9250, NEO-6M or ultrasonic of ours."""

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import Outcome, Phase
from sitl.mavlink.sensor_telemetry import SensorMessages
from tests.scenario.flights.test_faults import failing
from tests.scenario.flights.test_wirings import CountingLog
from tests.scenario.flying import (
    FEW_PICTURES,
    FlownCommand,
    figures,
    fly,
    fly_logged,
    notices,
    run_here,
    scenario_file,
)

LATERAL_M = 0.15
IN_DESCENT_S = 26.0
SENSE: dict[str, Any] = {"source": "autopilot"}
FIFTY_HZ: dict[str, Any] = {**SENSE, "autopilot": {"imu_rate_hz": 50.0}}


def by_telemetry(autopilot_kind: AutopilotKind, sense: dict[str, Any]) -> dict[str, Any]:
    return {**FEW_PICTURES, "autopilot": autopilot_kind, "companion": {"sense": sense}}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FlownCommand]:
    """A landing in `static` on PX4's sensors, and the folder of its log and its scenario."""
    folder = tmp_path_factory.mktemp("telemetry")
    scenario = scenario_file(folder, "static", by_telemetry("px4", SENSE))
    return folder, fly(scenario, 0, folder, "--record", folder / "log")


def test_lands_on_px4s_sensors(recorded: tuple[Path, FlownCommand]) -> None:
    _, flown = recorded
    assert flown.landing["touchdown"]["lateral_error_m"] <= LATERAL_M, flown


@pytest.mark.parametrize(
    ("autopilot_kind", "scenario", "sense"),
    [
        ("ardupilot", "static", SENSE),
        ("px4", "circle", SENSE),
        ("ardupilot", "circle", SENSE),
        ("px4", "circle", FIFTY_HZ),
        ("ardupilot", "circle", FIFTY_HZ),
    ],
)
def test_lands_on_the_autopilots_sensors(
    autopilot_kind: AutopilotKind, scenario: str, sense: dict[str, Any], tmp_path: Path
) -> None:
    flown = fly(scenario_file(tmp_path, scenario, by_telemetry(autopilot_kind, sense)), 0, tmp_path)
    assert flown.landing["touchdown"]["lateral_error_m"] <= LATERAL_M, flown


def test_a_replay_gives_the_flights_estimates_again_to_the_bit(
    recorded: tuple[Path, FlownCommand], tmp_path: Path
) -> None:
    folder, _ = recorded
    replayed = run_here("replay", folder / "log", "-o", tmp_path, result=tmp_path / "replay.json")
    assert replayed.result is not None, replayed
    assert replayed.result["repetition"]["identical"], replayed
    assert all(replayed.result["samples"][kind] for kind in ("imu", "mag", "gps", "range")), replayed


def test_our_ultrasonic_may_stay_beside_the_autopilots_other_sensors(tmp_path: Path) -> None:
    sense = {**SENSE, "autopilot": {"range_source": "boards"}}
    log = CountingLog()
    flight, _ = fly_logged(scenario_file(tmp_path, "static", by_telemetry("ardupilot", sense)), log)
    assert flight.report.outcome is Outcome.LANDED, flight.report.failures
    assert log.counts["range"] > 3.5 * flight.report.duration_s
    assert "ultrasonic" not in notices(log)


def test_an_imu_stream_that_stops_in_the_descent_hands_the_vehicle_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = SensorMessages.build

    def until_then(self: SensorMessages, message_id: int, now_s: float) -> Any:
        gone = message_id == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU and now_s > IN_DESCENT_S - 3.0
        return None if gone else build(self, message_id, now_s)

    monkeypatch.setattr(SensorMessages, "build", until_then)
    flight, log = fly_logged(scenario_file(tmp_path, "static", by_telemetry("px4", SENSE)))
    assert flight.report.outcome is Outcome.ABORTED, flight.report.failures
    assert "no current vehicle estimate" in notices(log)
    assert notices(log).count("autopilot's sensors: no HIGHRES_IMU received; expected 200 Hz") == 1


@pytest.mark.parametrize(("autopilot_kind", "name"), [("px4", "HIGHRES_IMU"), ("ardupilot", "RAW_IMU")])
def test_an_imu_stream_that_never_comes_is_reported_once_and_nothing_is_armed(
    autopilot_kind: AutopilotKind, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    has = SensorMessages.__contains__
    monkeypatch.setattr(
        SensorMessages, "__contains__", lambda self, number: number != missing and has(self, number)
    )
    changes = {**by_telemetry(autopilot_kind, SENSE), "time_limit_s": 15.0}
    flight, log = fly_logged(scenario_file(tmp_path, "static", changes))
    assert flight.report.outcome is Outcome.TIMEOUT, flight.report.failures
    assert [plan.phase for plan in log.kept["plan"]][-1] is Phase.CONNECT
    assert notices(log).count(f"autopilot's sensors: no {name} received; expected 200 Hz") == 1
    assert notices(log).count("autopilot's sensors") == 1


def test_no_board_of_ours_is_read_and_the_same_seed_gives_the_same_flight(
    recorded: tuple[Path, FlownCommand], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from sitl.devices.mpu9250 import Mpu9250Device

    broken = failing(Mpu9250Device.read, OSError("nobody reads this bus"), lambda _: True)
    monkeypatch.setattr(Mpu9250Device, "read", broken)
    folder, flown = recorded
    again = fly(folder / "static_changed.yaml", 0, tmp_path)
    assert again.landing["events"] == flown.landing["events"]
    assert figures(again) == figures(flown)
