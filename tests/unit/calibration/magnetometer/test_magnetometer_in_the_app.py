"""The app reads the file: the right sensor's is applied, any other is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration.magnetometer.calibrate import calibrate
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.report import yaml_text
from companion.app.sensing import Sensing, load_used_magnetometer
from companion.base.geometry import matrix_from_quat, quat_from_euler
from companion.base.messages import MagSample
from companion.config import CompanionConfig, ConfigError, ImuConfig, SenseConfig
from companion.config.magnetometer import MagnetometerCalibration, Sensor, load_magnetometer_calibration
from companion.sense.imu.mpu9250 import Mpu9250
from tests.unit.calibration.magnetometer.magnetometer_truth import turned
from tests.unit.sense.imu.imu_rig import FIELD, REST, STILL, ImuRig

CASE = turned(5, samples=2000, half=False)


def made(sensor: Sensor) -> MagnetometerCalibration:
    recording = MagnetometerRecording("test", sensor, CASE.raw)
    rng = np.random.default_rng(0)
    return calibrate(recording, rng, field=None, aligned=False, objective=None, tool="t", date="d").file


def sense(sensor: Sensor, path: Path, *, source: str) -> SenseConfig:
    section = "imu" if source == "boards" else "autopilot"
    path.write_text(yaml_text(made(sensor)))
    settings = {"sense": {"source": source, section: {"magnetometer_calibration": str(path)}}}
    return CompanionConfig.model_validate(settings).sense


def test_without_a_name_nothing_is_applied() -> None:
    assert load_used_magnetometer(SenseConfig()) is None


@pytest.mark.parametrize(("sensor", "source"), [("mpu9250", "boards"), ("autopilot", "autopilot")])
def test_the_file_of_the_sensor_in_use_is_read_as_it_was_made(
    tmp_path: Path, sensor: Sensor, source: str
) -> None:
    assert load_used_magnetometer(sense(sensor, tmp_path / "a.yaml", source=source)) == made(sensor)


@pytest.mark.parametrize(
    ("sensor", "source"), [("autopilot", "boards"), ("other", "boards"), ("mpu9250", "autopilot")]
)
def test_another_sensors_file_is_refused(tmp_path: Path, sensor: Sensor, source: str) -> None:
    settings = sense(sensor, tmp_path / "a.yaml", source=source)
    with pytest.raises(
        ConfigError, match=rf"magnetometer_calibration: .*a\.yaml is of sensor {sensor}"
    ) as told:
        load_used_magnetometer(settings)
    assert "\n" not in str(told.value)


def test_one_in_counts_and_one_that_mirrors_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    file = made("mpu9250")
    path.write_text(yaml_text(file.model_copy(update={"raw_unit": "counts"})))
    with pytest.raises(ConfigError, match="raw in counts; expected sensor mpu9250 in sensor axes, raw in uT"):
        load_magnetometer_calibration(str(path), "mpu9250", "key")
    mirrored = ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    path.write_text(yaml_text(file.model_copy(update={"soft_iron": mirrored})))
    with pytest.raises(ConfigError, match="expected a matrix of positive determinant"):
        load_magnetometer_calibration(str(path), "mpu9250", "key")


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, -120.0])
def test_the_driver_applies_it_in_the_sensors_axes_before_the_mounting(yaw_deg: float) -> None:
    config = ImuConfig(body_from_sensor_deg=(180.0, 0.0, yaw_deg))
    plain, corrected = ImuRig(config), ImuRig(config)
    file = made("mpu9250")
    corrected.driver = Mpu9250(corrected.device, config, file)
    for rig in (plain, corrected):
        rig.run(0.7, lambda _now_s: (REST, STILL, FIELD))
    angles = (np.radians(180.0), 0.0, np.radians(yaw_deg))
    body_from_sensor = matrix_from_quat(quat_from_euler(*angles))
    for one, other in zip(plain.mag[-5:], corrected.mag[-5:], strict=True):
        raw = body_from_sensor.T @ np.array(one.field_body_ut)
        expected = body_from_sensor @ file.apply(raw[None])[0]
        assert other.field_body_ut == pytest.approx(expected, abs=1e-9)


def test_telemetry_is_corrected_in_body_axes() -> None:
    sensing = object.__new__(Sensing)
    file = made("autopilot")
    sensing._magnetometer = file
    raw = (20.0, -3.0, 41.0)
    found = sensing._calibrated(MagSample(1.5, raw))
    assert found.time_s == 1.5
    assert found.field_body_ut == pytest.approx(file.apply(np.array([raw]))[0])
    sensing._magnetometer = None
    assert sensing._calibrated(MagSample(1.5, raw)).field_body_ut == raw
