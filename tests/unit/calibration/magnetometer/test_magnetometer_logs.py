"""Logs of autopilots and of ours: what the compass measured is found under what was made of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.magnetometer.calibrate import Calibrated, TrueField, calibrate
from calibration.magnetometer.recording import (
    NAMES,
    MagnetometerRecording,
    Onboard,
    onboard_of,
    parameters_for,
)
from calibration.magnetometer.report import lines
from calibration.magnetometer.sources import read_recording
from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import FloatArray, vector3
from companion.base.messages import ImuSample, MagSample
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, VehicleConfig, find_file, load_model
from companion.config.magnetometer import Sensor
from companion.flightlog.record import FlightLog
from companion.link.codec import Codec, mavlink
from companion.pad import load_pad
from tests.unit.calibration.magnetometer.magnetometer_truth import Turned, turned
from tests.unit.flightlog.replay.log_files import DataFlash

CASE = turned(7, samples=400, half=False, noise=0.005)
FIELD = TrueField((20.0, 0.0, 43.634), "test")
ARDUPILOT = {
    "COMPASS_OFS_X": 120.0, "COMPASS_OFS_Y": -40.0, "COMPASS_OFS_Z": 33.0,
    "COMPASS_DIA_X": 1.05, "COMPASS_DIA_Y": 0.97, "COMPASS_DIA_Z": 1.02,
    "COMPASS_ODI_X": 0.03, "COMPASS_ODI_Y": -0.02, "COMPASS_ODI_Z": 0.01, "COMPASS_SCALE": 1.1,
}  # fmt: skip
PX4 = {
    "CAL_MAG0_ROT": 0.0,
    **{f"CAL_MAG0_{axis}OFF": value for axis, value in zip("XYZ", (0.1, -0.05, 0.02), strict=True)},
    **{f"CAL_MAG0_{axis}SCALE": value for axis, value in zip("XYZ", (1.02, 0.95, 1.1), strict=True)},
    **{f"CAL_MAG0_{axis}ODIAG": value for axis, value in zip("XYZ", (0.01, 0.02, -0.03), strict=True)},
}
PARAMETERS: dict[AutopilotKind, dict[str, float]] = {"ardupilot": ARDUPILOT, "px4": PX4}


def known(autopilot_kind: AutopilotKind) -> Onboard:
    found = onboard_of(autopilot_kind, PARAMETERS[autopilot_kind])
    assert found is not None
    return found


def heard(onboard: Onboard, raw: FloatArray) -> FloatArray:
    """What the autopilot makes of it, by its own formula."""
    made: FloatArray = (raw + onboard.offset_ut) @ onboard.matrix.T
    return made


def read(path: Path) -> MagnetometerRecording:
    rng = np.random.default_rng(0)
    return read_recording(path, columns=None, unit=None, sensor="other", field_ut=None, rng=rng)


def calibrated(recording: MagnetometerRecording, case: Turned = CASE) -> Calibrated:
    rng = np.random.default_rng(0)
    done = calibrate(recording, rng, field=FIELD, aligned=False, objective=None, tool="t", date="d")
    assert done.centre == pytest.approx(case.centre, abs=0.15)
    return done


# ---------------------------------------------------------------- parameters


def test_ardupilots_formula_is_its_own() -> None:
    onboard = known("ardupilot")
    x, y, z = (20.0 + 12.0, -30.0 - 4.0, 40.0 + 3.3)
    expected = (1.1 * (1.05 * x + 0.03 * y - 0.02 * z), 1.1 * (0.03 * x + 0.97 * y + 0.01 * z))
    assert heard(onboard, np.array([[20.0, -30.0, 40.0]]))[0, :2] == pytest.approx(expected)


def test_px4s_formula_is_its_own() -> None:
    onboard = known("px4")
    x, y, z = (20.0 - 10.0, -30.0 + 5.0, 40.0 - 2.0)
    expected = 1.02 * x + 0.01 * y + 0.02 * z
    assert heard(onboard, np.array([[20.0, -30.0, 40.0]]))[0, 0] == pytest.approx(expected)


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_the_parameters_say_what_the_fit_says(autopilot_kind: AutopilotKind) -> None:
    raw = CASE.raw[:20]
    parameters = parameters_for(autopilot_kind, CASE.matrix, CASE.centre)
    assert set(parameters) <= set(NAMES[autopilot_kind])
    onboard = onboard_of(autopilot_kind, parameters)
    assert onboard is not None
    assert heard(onboard, raw) == pytest.approx((raw - CASE.centre) @ CASE.matrix)


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_a_calibration_goes_on_top_of_the_autopilots(autopilot_kind: AutopilotKind) -> None:
    onboard = known(autopilot_kind)
    assert onboard.undo(heard(onboard, CASE.raw)) == pytest.approx(CASE.raw)
    matrix, centre = onboard.on_top(CASE.matrix, CASE.centre)
    on_top = (heard(onboard, CASE.raw) - centre) @ matrix.T
    assert on_top == pytest.approx((CASE.raw - CASE.centre) @ CASE.matrix)


def test_a_compass_that_is_turned_or_unknown_is_not_guessed() -> None:
    assert onboard_of("px4", {**PX4, "CAL_MAG0_ROT": 4.0}) is None
    assert onboard_of("ardupilot", {}) is None
    assert onboard_of("ardupilot", dict.fromkeys(ARDUPILOT, 0.0)) is not None  # 0 diagonals: none


# ---------------------------------------------------------------- files


def write_tlog(
    path: Path, autopilot_kind: AutopilotKind, field: FloatArray, *, parameters: bool = True
) -> Path:
    kind = mavlink.MAV_AUTOPILOT_PX4 if autopilot_kind == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    messages = [mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, kind, 0, 0, 0, 3)]
    if parameters:
        messages += [
            mavlink.MAVLink_param_value_message(name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32, 30, k)
            for k, (name, value) in enumerate(PARAMETERS[autopilot_kind].items())
        ]
    for k, row in enumerate(field.tolist()):
        us = 20_000 * k
        if autopilot_kind == "px4":
            gauss = [0.01 * value for value in row]
            messages.append(
                mavlink.MAVLink_highres_imu_message(
                    us, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0, *gauss, 0.0, 0.0, 0.0, 20.0, 0xFFFF
                )
            )
        else:
            mgauss = [round(10.0 * value) for value in row]
            messages.append(mavlink.MAVLink_raw_imu_message(us, 0, 0, -1000, 0, 0, 0, *mgauss))
    codec = Codec(1, 1)
    path.write_bytes(b"".join(b"\0\6\xfd\1\2\3\4\5" + codec.encode(message) for message in messages))
    return path


@pytest.mark.parametrize("autopilot_kind", ["ardupilot", "px4"])
def test_a_tlogs_compass_is_undone_and_the_file_goes_on_top(
    tmp_path: Path, autopilot_kind: AutopilotKind
) -> None:
    sent = heard(known(autopilot_kind), CASE.raw)
    recording = read(write_tlog(tmp_path / "a.tlog", autopilot_kind, sent))
    assert recording.sensor == "autopilot"
    assert recording.raw == pytest.approx(CASE.raw, abs=0.08)
    done = calibrated(recording)
    # the file is for what the app hears; the parameters are for the compass
    size = np.linalg.norm(done.file.apply(sent), axis=1)
    assert size == pytest.approx(FIELD.strength_ut, rel=0.03)
    new = onboard_of(autopilot_kind, done.parameters)
    assert new is not None
    assert np.linalg.norm(heard(new, CASE.raw), axis=1) == pytest.approx(FIELD.strength_ut, rel=0.03)
    assert done.file.autopilot_parameters == pytest.approx(PARAMETERS[autopilot_kind])


def test_a_refused_calibration_offers_no_parameters(tmp_path: Path) -> None:
    sent = heard(known("ardupilot"), CASE.raw)
    done = calibrated(read(write_tlog(tmp_path / "a.tlog", "ardupilot", sent)))
    good = done.file.quality.model_copy(update={"verdict": "good", "reasons": ()})
    accepted = replace(done, file=done.file.model_copy(update={"quality": good}))
    assert any("COMPASS_OFS_X" in line for line in lines(accepted))
    quality = done.file.quality.model_copy(update={"verdict": "refused", "reasons": ("too little turning",)})
    refused = replace(done, file=done.file.model_copy(update={"quality": quality}))
    assert lines(refused)[0] == "refused: too little turning"
    assert not any("COMPASS_" in line for line in lines(refused))


def test_without_parameters_the_calibration_is_of_what_is_heard(tmp_path: Path) -> None:
    recording = read(write_tlog(tmp_path / "a.tlog", "ardupilot", CASE.raw, parameters=False))
    assert "not known" in recording.notes[0]
    done = calibrated(recording)
    assert done.parameters == {}


def test_a_dataflash_logs_own_offsets_are_taken_off(tmp_path: Path) -> None:
    onboard, log = known("ardupilot"), DataFlash()
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.define("MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
    for name, value in ARDUPILOT.items():
        log.add("PARM", 0, name.encode(), value, value)
    motors, learnt = np.array([2.0, -1.0, 0.5]), np.array([1.0, 2.0, 3.0])
    for k, row in enumerate(CASE.raw):
        # the offsets change half way, as they are learnt
        offset = onboard.offset_ut + (learnt if k > 200 else 0.0)
        field = onboard.matrix @ (row + offset) + motors
        words = [round(10.0 * value) for value in (*field, *offset, *motors)]
        log.add("MAG", 50_000 * k, 0, *words, 1, 0)
    path = tmp_path / "00000001.BIN"
    path.write_bytes(log.data)
    recording = read(path)
    assert recording.raw == pytest.approx(CASE.raw, abs=0.12)
    assert "COMPASS_OFS_X" in calibrated(recording).parameters


def write_flight(folder: Path, settings: CompanionConfig, field: FloatArray) -> Path:
    log = FlightLog(folder, start_unix_s=1.7e9)
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    log.write_settings(config=settings, vehicle=vehicle, pad=load_pad(settings.pad))
    for k, row in enumerate(field.tolist()):
        log.write("imu", ImuSample(0.01 * k, (0.0,) * 3, (0.0, 0.0, -9.8), 20.0), 0.01 * k)
        log.write("mag", MagSample(0.01 * k, vector3(row)), 0.01 * k)
    log.close()
    return folder


def test_a_flight_of_ours_is_turned_back_into_the_sensors_axes(tmp_path: Path) -> None:
    body = CASE.raw * (1.0, -1.0, -1.0)  # the default mounting
    recording = read(write_flight(tmp_path / "flight", CompanionConfig(), body))
    assert recording.sensor == "mpu9250"
    assert recording.raw == pytest.approx(CASE.raw)
    assert recording.force is not None
    assert recording.force[0] == pytest.approx((0.0, 0.0, 9.8))


def with_calibration(sensor: Sensor, path: Path) -> CompanionConfig:
    section = "imu" if sensor == "mpu9250" else "autopilot"
    source = "boards" if sensor == "mpu9250" else "autopilot"
    return CompanionConfig.model_validate(
        {"sense": {"source": source, section: {"magnetometer_calibration": str(path)}}}
    )


def test_a_flight_with_a_calibration_is_read_as_if_without(tmp_path: Path) -> None:
    applied = calibrated(MagnetometerRecording("x", "autopilot", CASE.raw)).file
    file = tmp_path / "applied.yaml"
    file.write_text(applied.model_dump_json())
    settings = with_calibration("autopilot", file)
    path = write_flight(tmp_path / "flight", settings, applied.apply(CASE.raw))
    assert read(path).raw == pytest.approx(CASE.raw)
    file.unlink()
    with pytest.raises(ConfigError, match=r"applied\.yaml: cannot be read"):
        read(path)


@pytest.mark.parametrize(
    ("name", "write", "expected"),
    [
        ("a.tlog", lambda path: path.write_bytes(b"\0" * 100), "no magnetometer in it; expected RAW_IMU"),
        ("a.bin", lambda path: path.write_bytes(bytes(DataFlash().data)), "no MAG messages"),
        (
            "a.ulg",
            lambda path: path.write_bytes(b"ULog\x01\x12\x35\x01" + b"\0" * 8),
            "no magnetometer in it",
        ),
        ("a.mcap", lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "no magnetometer samples in the log"),
    ],
)
def test_logs_without_a_compass_are_reported_in_one_line(
    tmp_path: Path, name: str, write: Callable[[Path], object], expected: str
) -> None:
    path = tmp_path / name
    write(path)
    with pytest.raises(ConfigError, match=expected) as caught:
        read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "residual"), [("ck_acc_mag.csv", 0.01255), ("qmc5883l_noisy.csv", 0.0618)])
def test_real_logs_are_fitted_no_worse_than_published(name: str, residual: float) -> None:
    data = os.environ.get("COMPANION_DATA", CONFIG_FOLDER.parent.parent / "shared" / "data")
    path = Path(data) / "magnetometer" / name
    if not path.exists():
        pytest.skip(f"{path} is not there: somebody's recording, not part of the project")
    recording = read(path)
    done = calibrate(
        recording, np.random.default_rng(0), field=None, aligned=False, objective=None, tool="t", date="d"
    )
    assert done.file.quality.residual <= residual + 5e-6
