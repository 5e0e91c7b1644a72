"""Live against the simulator's devices: the vehicle is turned about by hand, in virtual time."""

import io
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from calibration.magnetometer.calibrate import Calibrated, TrueField, UnfitError, calibrate
from calibration.magnetometer.collect import ENOUGH, collect
from calibration.magnetometer.live import AutopilotCompass, Mpu9250Compass
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.report import yaml_text
from companion.app.sensing import Sensing, load_used_magnetometer
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_euler
from companion.base.messages import MagSample
from companion.config import CompanionConfig, ConfigError, ImuConfig, SenseConfig
from companion.config.magnetometer import MagnetometerCalibration, Sensor, load_magnetometer_calibration
from companion.link.transport import memory_pair
from companion.sense.imu.mpu9250 import Mpu9250
from sitl.run.in_process import InProcess, carried
from sitl.scenario.scenario import USUAL_HOMES, Scenario, load_scenario, magnetic_field_ned_ut
from sitl.vehicle import HandMotion
from tests.unit.calibration.magnetometer.magnetometer_truth import turned
from tests.unit.sense.imu.imu_rig import FIELD, REST, STILL, ImuRig
from tests.virtual_time import in_virtual_time

SITL_FIELD = TrueField(magnetic_field_ned_ut(USUAL_HOMES["px4"]), "the simulator's")


def uncalibrated() -> Scenario:
    scenario = load_scenario("static")
    return scenario.model_copy(update={"sensors": scenario.sensors.model_copy(update={"calibrated": False})})


def carry(
    motion: HandMotion, task: Callable[[InProcess], Awaitable[Any]], *, seed: int = 3, link: Any = None
) -> Any:
    async def main() -> Any:
        async with carried(uncalibrated(), seed, motion, camera=False, link=link) as vehicle:
            return await task(vehicle)

    return main()


def calibrated(recording: Any) -> Calibrated:
    rng = np.random.default_rng(0)
    return calibrate(recording, rng, field=SITL_FIELD, aligned=False, tool="t", date="d")


def offset_error(done: Calibrated, truth: FloatArray) -> float:
    """Of the hard iron, as a share of the field."""
    return float(np.linalg.norm(done.centre - truth)) / SITL_FIELD.strength_ut


def test_the_chip_turned_about_is_calibrated_to_the_truth(tmp_path: Path) -> None:
    shown = io.StringIO()
    picture = tmp_path / "coverage.png"

    async def collected(vehicle: InProcess) -> Any:
        source = Mpu9250Compass(vehicle.imu_bus, ImuConfig())
        recording = await collect(source, Console(file=shown, width=200), 150.0, picture)
        return recording, vehicle.simulation.sensor_truth.boards.magnetometer

    recording, flaws = run_in_virtual_time(carry("tumble", collected))
    done = calibrated(recording)
    assert done.file.quality.verdict == "good"
    assert done.figures.coverage >= ENOUGH
    assert offset_error(done, flaws.offset) < 0.003
    # what the app reads undoes what the sensor does, rotation and all
    assert done.file.matrix @ flaws.matrix == pytest.approx(np.eye(3), abs=4e-3)
    assert done.figures.dip is not None
    assert done.figures.dip.median_deg == pytest.approx(SITL_FIELD.dip_deg, abs=1.0)
    lines = [line for line in shown.getvalue().splitlines() if "covered," in line]
    # it stopped by itself, and told its way there in plain lines
    assert len(lines) > 5
    assert float(lines[-1].split("s")[0]) < 145.0
    assert any("nose" in line or "roll" in line for line in lines)
    assert picture.exists()


def test_the_calibration_makes_the_drivers_field_true() -> None:
    async def collected(vehicle: InProcess) -> Any:
        recording = await collect(
            Mpu9250Compass(vehicle.imu_bus, ImuConfig()), Console(file=io.StringIO()), 30.0
        )
        file = calibrated(recording).file
        clock, driver, found = Clock(), Mpu9250(vehicle.imu_bus, ImuConfig(), file), []
        for _ in range(300):
            found += driver.poll(clock.now_s)[1]
            await clock.sleep_until(clock.now_s() + 0.01)
        return [np.linalg.norm(sample.field_body_ut) for sample in found[5:]]

    sizes = run_in_virtual_time(carry("tumble", collected))
    assert len(sizes) > 50
    assert np.mean(sizes) == pytest.approx(SITL_FIELD.strength_ut, rel=0.01)


@in_virtual_time
async def test_an_autopilots_compass_is_calibrated_over_mavlink() -> None:
    ours, theirs = memory_pair()

    async def collected(vehicle: InProcess) -> Any:
        source = AutopilotCompass(ours, "the line")
        try:
            recording = await collect(source, Console(file=io.StringIO()), 60.0)
        finally:
            source.close()
        return recording, vehicle.simulation.sensor_truth.autopilot.magnetometer

    recording, flaws = await carry("tumble", collected, link=theirs)
    assert recording.source == "the line (HIGHRES_IMU)"
    done = calibrated(recording)
    assert done.file.axes == "body"
    assert offset_error(done, flaws.offset) < 0.006
    assert done.matrix @ flaws.matrix == pytest.approx(np.eye(3), abs=8e-3)


def test_a_vehicle_that_stands_still_is_refused() -> None:
    async def collected(vehicle: InProcess) -> Any:
        return await collect(Mpu9250Compass(vehicle.imu_bus, ImuConfig()), Console(file=io.StringIO()), 20.0)

    recording = run_in_virtual_time(carry("still", collected))
    with pytest.raises(UnfitError, match="was it turned about at all"):
        calibrated(recording)


class DeadBus:
    """Nobody answers."""

    def read(self, address: int, register: int, length: int) -> bytes:
        raise OSError(121, "Remote I/O error")

    def write(self, address: int, register: int, value: int) -> None:
        raise OSError(121, "Remote I/O error")


def test_a_chip_or_an_autopilot_that_is_not_there_is_reported() -> None:
    async def chip() -> None:
        await collect(Mpu9250Compass(DeadBus(), ImuConfig()), Console(file=io.StringIO()), 60.0)

    with pytest.raises(ConfigError, match=r"MPU9250 on i2c:1: .*Remote I/O error; expected its magnetometer"):
        run_in_virtual_time(chip())

    async def autopilot() -> None:
        source = AutopilotCompass(memory_pair()[0], "the line")
        try:
            await collect(source, Console(file=io.StringIO()), 60.0)
        finally:
            source.close()

    with pytest.raises(ConfigError, match="the line: no heartbeat for 8 s"):
        run_in_virtual_time(autopilot())


# ---------------- The app reads the file: the right sensor's is applied, any other is refused in one line

CASE = turned(5, samples=2000, half=False)


def made(sensor: Sensor) -> MagnetometerCalibration:
    recording = MagnetometerRecording("test", sensor, CASE.raw)
    rng = np.random.default_rng(0)
    return calibrate(recording, rng, field=None, aligned=False, tool="t", date="d").file


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
