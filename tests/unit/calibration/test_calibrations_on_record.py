"""What a log says of the calibrations that its samples went through, and whose they are on the desk."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from calibration.mount.recording import read_recording
from calibration.mount.result import prior_of
from companion.config import (
    CONFIG_FOLDER,
    AccelerometerCalibration,
    CompanionConfig,
    GyroCalibration,
    InertialCalibration,
    MountCalibration,
    MountStd,
    merge,
    validate,
)
from companion.config.calibration import Provenance
from companion.flightlog.record import FlightLog
from companion.flightlog.replay.mcap_log import read_mcap
from companion.flightlog.replay.settings import choose
from companion.sim.runner import fly
from companion.sim.settings import calibrations_left_out, sitl_settings
from companion.sim.trial import Trial
from tests.unit.calibration.mount.mount_world import HandHeld, record_sway, scenario_of

ORIGIN = Provenance(tool="t", source="s", date="d", samples=1)
INERTIAL = InertialCalibration(
    accelerometer=AccelerometerCalibration(
        offset_m_s2=(0.0, 0.0, 0.0),
        matrix=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        residual_m_s2=0.01,
        faces=6,
    ),
    gyro=GyroCalibration(bias_rad_s=(0.0, 0.0, 0.0), std_rad_s=0.001, temperature_c=20.0),
    provenance=ORIGIN,
)
# steeper than a vehicle's file used to allow
MOUNT = MountCalibration(
    camera="sitl_640x480",
    camera_roll_deg=0.5,
    camera_tilt_deg=60.0,
    camera_yaw_deg=-0.5,
    camera_position_body_m=(0.03, 0.0, 0.08),
    time_offset_s=-0.02,
    std=MountStd(rotation_deg=(0.2, 0.2, 0.2), position_m=(0.01, 0.01, 0.01), time_offset_s=0.001),
    residual=1.0,
    provenance=ORIGIN,
)


def written(path: Path, model: InertialCalibration | MountCalibration) -> str:
    path.write_text(yaml.safe_dump(model.model_dump(mode="json")))
    return str(path)


@pytest.fixture
def named(tmp_path: Path) -> dict[str, Any]:
    """Settings that name a mount and an inertial file."""
    inertial = written(tmp_path / "inertial.yaml", INERTIAL)
    return {
        "mount": written(tmp_path / "mount.yaml", MOUNT),
        "sense": {"imu": {"inertial_calibration": inertial}},
    }


def trial_of(tmp_path: Path, **changes: Any) -> Trial:
    base = yaml.safe_load((CONFIG_FOLDER / "scenarios" / "static.yaml").read_text())
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(merge(base, {"time_limit_s": 5.0, **changes})))
    return Trial.load(str(path), 0)


def test_a_real_vehicle_s_calibrations_are_not_the_simulated_one_s(
    tmp_path: Path, named: dict[str, Any]
) -> None:
    settings = tmp_path / "mine.yaml"
    settings.write_text(yaml.safe_dump(named))
    flown = sitl_settings(settings, trial_of(tmp_path), fast=True)
    assert flown.mount is None
    assert flown.sense.imu.inertial_calibration is None
    assert calibrations_left_out(settings, flown) == ["mount", "sense.imu.inertial_calibration"]
    # a scenario whose sensors are off knows its own
    scenario = trial_of(tmp_path, companion={"mount": named["mount"]})
    by_scenario = sitl_settings(settings, scenario, fast=True)
    assert by_scenario.mount == named["mount"]
    assert calibrations_left_out(settings, by_scenario) == ["sense.imu.inertial_calibration"]


def test_a_flight_s_log_holds_what_was_applied_and_replays_without_the_files(
    tmp_path: Path, named: dict[str, Any]
) -> None:
    trial = trial_of(tmp_path, companion=named)
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    log = FlightLog(tmp_path / "flight", 0.0)
    fly(config, trial, log, lambda _status: None, fast=True)
    log.close()
    for file in tmp_path.glob("*.yaml"):
        file.unlink()
    record = read_mcap(tmp_path / "flight" / "flight.mcap")
    rig = choose(record, None).rig
    assert rig.vehicle.camera_tilt_deg == MOUNT.camera_tilt_deg
    assert rig.vehicle.camera_time_offset_s == MOUNT.time_offset_s
    recording = read_recording(tmp_path / "flight")
    assert recording.calibrated == INERTIAL


def test_a_recording_is_solved_where_its_inertial_file_is_not(tmp_path: Path, named: dict[str, Any]) -> None:
    config = validate(CompanionConfig, {"sense": named["sense"]}, "test")
    held = HandHeld(scenario_of({}), 0, "sway")
    record_sway(held, config, tmp_path / "swayed", 5.0)
    (tmp_path / "inertial.yaml").unlink()
    recording = read_recording(tmp_path / "swayed")
    assert recording.calibrated == INERTIAL
    plain = replace(recording, calibrated=None)
    assert prior_of(recording, 0.02).accel_bias_m_s2 < prior_of(plain, 0.02).accel_bias_m_s2
