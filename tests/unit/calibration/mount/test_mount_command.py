"""`calibrate-mount` from its words to its files, on a hand-held vehicle, and the refusals of its files."""

import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.mount import record_motion
from calibration.mount.imu_calibration import calibrate_accelerometer, faces_from
from calibration.mount.record_motion import MotionCoverage, MotionProgress
from calibration.mount.recording import read_recording
from calibration.mount.result import shutter_s
from calibration.mount.solver import solve
from companion.base.clock import run_in_virtual_time
from companion.base.geometry import IDENTITY, matrix_from_quat
from companion.base.messages import ImuSample, PadSighting
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    InertialCalibration,
    MountCalibration,
    VehicleConfig,
    find_file,
    load_model,
    load_vehicle,
    validate,
)
from companion.flightlog.record import FlightLog
from companion.pad import load_pad
from companion.sense.vision.pipeline import body_from_camera
from tests.programs import ProgramHere, exit_code
from tests.unit.calibration.mount.mount_world import HandHeld, record_sway, scenario_of

calibrate = partial(exit_code, "calibrate-mount")


# ----------------
# `calibrate-mount` from its words to its files, on a hand-held vehicle, and the refusals of its files.

MOUNT_DEG = (2.0, -3.0, 1.5)
STAMP_S = 0.018


@pytest.fixture(scope="module")
def swayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, HandHeld]:
    """A recording of 16 s, by the program, and who held the vehicle."""
    folder = tmp_path_factory.mktemp("mount") / "swayed"
    camera = {"mount_error_deg": MOUNT_DEG, "stamp_error_s": STAMP_S, "calibration_error": 0.001}
    held = HandHeld(scenario_of({"camera": camera}), 11, "sway")
    record_sway(held, CompanionConfig(), folder, 16.0)
    return folder, held


@pytest.fixture(scope="module")
def mounted(swayed: tuple[Path, HandHeld], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mount file of that recording, in a folder with its pictures."""
    output = tmp_path_factory.mktemp("calibrated") / "mount.yaml"
    assert calibrate("camera", swayed[0], "-o", output, "--plots", output.parent / "pictures") == 0
    return output


def test_a_recording_is_calibrated_end_to_end(swayed: tuple[Path, HandHeld], mounted: Path) -> None:
    _, held = swayed
    found = load_model(MountCalibration, mounted)
    assert abs(found.time_offset_s + STAMP_S) < 0.002
    vehicle = load_vehicle("x500", str(mounted), "sitl_640x480")
    rotation = matrix_from_quat(body_from_camera(vehicle))
    off_deg = np.degrees(np.arccos(0.5 * (np.trace(rotation @ held.body_from_camera.T) - 1.0)))
    assert off_deg < 0.7  # what the simulated chip's axes are askew by included
    assert off_deg < 3.0 * math.hypot(*found.std.rotation_deg)
    assert found.provenance.samples > 300
    assert found.forced == ()
    pictures = {path.name for path in (mounted.parent / "pictures").iterdir()}
    assert pictures == {"mount_rates.png", "mount_residuals.png"}


def test_a_refused_one_is_written_only_when_forced(
    swayed: tuple[Path, HandHeld],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, _ = swayed
    recording = read_recording(folder)
    place = np.array(recording.vehicle.camera_position_body_m)
    found = solve(recording.inertial, recording.sightings, place, shutter_s(recording))
    monkeypatch.setattr("calibration.mount.result.solve", lambda *_: found)  # twice the same: once is enough
    output = tmp_path / "mount.yaml"
    words = ("camera", folder, "-o", output, "--max-rotation-deg", "1")
    assert calibrate(*words) == 1
    said = re.search(r"refused: the camera is turned by (\d\.\d)°", capsys.readouterr().err)
    assert said is not None
    assert float(said[1]) == pytest.approx(math.hypot(*MOUNT_DEG), abs=0.5)
    assert not output.exists()
    assert calibrate(*words, "--force") == 0
    assert load_model(MountCalibration, output).forced[0].startswith("the camera is turned by")


def test_frames_are_looked_at_again_through_another_lens(swayed: tuple[Path, HandHeld]) -> None:
    folder, _ = swayed
    lens = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    again = read_recording(folder, lens.model_copy(update={"fx_px": 533.0}))
    logged = read_recording(folder)
    assert "looked again" in again.notes[0]
    assert 50 < len(again.sightings) < len(logged.sightings)
    nearest = np.abs(again.sightings.time_s[:, None] - logged.sightings.time_s[None]).argmin(axis=1)
    apart_s = again.sightings.time_s - logged.sightings.time_s[nearest]
    assert np.median(np.abs(apart_s)) < 1e-5  # the log's UTC is brought back to its clock


def test_faces_are_calibrated_live_against_the_simulated_chip(tmp_path: Path) -> None:
    held = HandHeld(scenario_of({"sensors": {"calibrated": False}}), 3, "faces")
    output = tmp_path / "inertial.yaml"
    kept = tmp_path / "kept"
    rested = run_in_virtual_time(faces_from(CompanionConfig(), kept, held.boards, virtual=True))
    calibrate_accelerometer(replace(rested, asked=(), answers=()), output, force=False)
    found = load_model(InertialCalibration, output)
    assert held.vehicle is not None
    truth = held.vehicle.simulation.sensor_truth.boards
    assert found.accelerometer is not None
    assert found.accelerometer.offset_m_s2 == pytest.approx(truth.accelerometer.offset, abs=0.03)
    assert found.gyro.bias_rad_s == pytest.approx(truth.gyroscope.offset, abs=math.radians(0.1))
    again = tmp_path / "again.yaml"
    assert calibrate("accelerometer", kept, "-o", again) == 0
    assert load_model(InertialCalibration, again).accelerometer == found.accelerometer
    # the bias alone leaves the accelerometer's part, and says where that is from
    for _ in range(2):
        assert calibrate("gyro", kept, "-o", again) == 0
    renewed = load_model(InertialCalibration, again)
    assert renewed.accelerometer == found.accelerometer
    assert renewed.provenance.source.startswith(f"{kept}; accelerometer of {kept}, 20")
    assert renewed.provenance.source.count("accelerometer of") == 1
    # and what that was forced through is not forgotten
    again.write_text(yaml.safe_dump({**yaml.safe_load(again.read_text()), "forced": ["never lay still"]}))
    assert calibrate("gyro", kept, "-o", again) == 0
    assert load_model(InertialCalibration, again).forced == ("never lay still",)


def hold_still(monkeypatch: pytest.MonkeyPatch, part: str) -> None:
    """The sensors that a command finds are those of a vehicle which nobody moves."""
    held = HandHeld(scenario_of({}), 0, "still")
    monkeypatch.setattr(f"calibration.mount.{part}.connected_sensors", held.boards)
    monkeypatch.setattr(f"calibration.mount.{part}.run_until_stopped", run_in_virtual_time)


def test_interrupted_rests_leave_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hold_still(monkeypatch, "imu_calibration")

    def interrupted(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("calibration.mount.imu_calibration.FaceGuide.take", interrupted)
    assert calibrate("accelerometer", "--keep", tmp_path / "kept", "-o", tmp_path / "out.yaml") == 130
    assert list(tmp_path.iterdir()) == []


def test_an_autopilot_s_rests_are_not_the_chip_s(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = FlightLog(tmp_path / "flown", 0.0)
    log.write_settings(
        config=validate(CompanionConfig, {"sense": {"source": "autopilot"}}, "test"),
        vehicle=load_model(VehicleConfig, find_file("vehicles", "x500")),
        pad=load_pad("moving_1300"),
    )
    for k in range(1000):
        log.write("imu", ImuSample(0.01 * k, (1e-5 * (k % 7), 0.0, 0.0), (0.0, 0.0, -9.8), 20.0), 0.01 * k)
    log.close()
    assert calibrate("gyro", tmp_path / "flown", "-o", tmp_path / "out.yaml") == 2
    assert "its inertial samples are the autopilot's" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("camera", "absent"), "cannot be read"),
        (("camera", "README.md"), "no recording of flights"),
        (("accelerometer", "README.md"), "expected a table"),
        (("accelerometer", "absent.csv"), "cannot be read"),
        (("accelerometer", "rests.csv", "-o", "rests.csv"), "-o rests.csv: expected a .yaml file"),
        (("gyro", "rests.csv", "-o", "rests.csv"), "-o rests.csv: expected a .yaml file"),
        (("camera", "flight.mcap", "-o", "flight.mcap"), "-o flight.mcap: expected a .yaml file"),
        (("accelerometer", "absent.csv", "--gyro-unit", "rpm"), "--gyro-unit rpm: expected rad/s or deg/s"),
        (("record", "full"), "holds a recording already"),
        (("camera",), "Missing argument 'LOG'"),
    ],
)
def test_what_a_user_can_mend_is_one_line(
    words: tuple[str, ...],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    program: ProgramHere,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "README.md").write_text("nothing")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "flight.mcap").write_bytes(b"")
    hold_still(monkeypatch, "record_motion")
    assert line in program("calibrate-mount", *words).refusal


def test_an_autopilot_s_samples_come_by_a_flight_s_log(tmp_path: Path, program: ProgramHere) -> None:
    settings = tmp_path / "mine.yaml"
    settings.write_text("sense: {source: autopilot}\n")
    told = program("calibrate-mount", "record", tmp_path / "new", "--config", settings).refusal
    assert "expected those or the log of a flight over the pad" in told


def test_an_interrupted_recording_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hold_still(monkeypatch, "record_motion")

    def interrupted(_self: MotionCoverage) -> MotionProgress:
        raise KeyboardInterrupt

    monkeypatch.setattr(MotionCoverage, "progress", interrupted)
    assert calibrate("record", tmp_path / "new") == 130
    assert capsys.readouterr().err == "calibrate-mount: interrupted; nothing was written\n"
    assert not (tmp_path / "new").exists()


def test_a_card_that_is_full_at_the_end_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hold_still(monkeypatch, "record_motion")

    def full(_file: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("companion.flightlog.record._McapFile.close", full)
    assert calibrate("record", tmp_path / "new", "--seconds", "5") == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_order_of_faces_must_fit_the_rests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0], (800, 1))
    rows += 0.001 * np.random.default_rng(0).standard_normal(rows.shape)
    path = tmp_path / "rests.csv"
    np.savetxt(path, rows, delimiter=",", header="ax,ay,az,gx,gy,gz", comments="")
    words = partial(calibrate, "accelerometer", path, "--rate", "200", "-o", tmp_path / "out.yaml", "--order")
    assert words("level,sideways") == 2
    assert "no face 'sideways'" in capsys.readouterr().err
    assert words("level,nose-down") == 2
    assert "2 faces, but it lay still 1 times" in capsys.readouterr().err
    assert words("nose-down") == 1
    assert "body_from_sensor_deg is [180, 0, 0]" in capsys.readouterr().err


# ---------------------------------------------------------------- what the app makes of it


def test_another_camera_s_calibration_is_refused(mounted: Path) -> None:
    with pytest.raises(ConfigError, match="is for the camera 'sitl_640x480', expected 'hd_1280x720'"):
        load_vehicle("x500", str(mounted), "hd_1280x720")
    content = yaml.safe_load(mounted.read_text())
    with pytest.raises(ConfigError, match="time_offset_s"):
        validate(MountCalibration, {**content, "time_offset_s": 3.0}, "mount.yaml")


# ---------------------------------------------------------------- what to do next


def test_the_output_s_folder_is_looked_for_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (("accelerometer",), ("gyro",), ("camera", tmp_path / "none")):
        assert calibrate(*words, "-o", tmp_path / "none" / "x.yaml") == 2
        assert "expected a .yaml file in an existing folder" in capsys.readouterr().err
    taken = tmp_path / "taken"
    taken.write_text("a letter")
    assert calibrate("camera", tmp_path / "none", "-o", tmp_path / "x.yaml", "--plots", taken) == 2
    assert f"--plots {taken}: cannot be made" in capsys.readouterr().err


# ---------------- What `calibrate-mount` asks for next, and how a recording ends that lacks something


SIGHTING = PadSighting(0.0, 1, (0.0, 0.0, 1.0), IDENTITY, np.eye(6), "M", (1,), {"F": 0, "M": 1, "C": 0}, 0.1)


def test_the_coverage_asks_for_what_is_missing() -> None:
    coverage = MotionCoverage()
    assert coverage.progress().advice == "waiting for the inertial sensor"
    coverage.add_imu(ImuSample(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 20.0))
    assert "pad is not seen" in coverage.progress().advice
    move(coverage, 0.0, 15.0, (0.0, 0.5, 0.5))
    assert coverage.progress().advice == "roll it left and right"
    move(coverage, 15.0, 36.0, (0.4, 0.0, 0.0))
    assert coverage.progress().advice == "enough"
    assert coverage.progress().complete


def test_slow_motion_is_not_enough() -> None:
    coverage = MotionCoverage()
    move(coverage, 0.0, 40.0, (0.2, 0.2, 0.2))
    assert coverage.progress().advice == "the same again, more quickly"


def move(coverage: MotionCoverage, from_s: float, to_s: float, rate: tuple[float, float, float]) -> None:
    for k in range(round(50 * (to_s - from_s))):
        time_s = from_s + k / 50.0
        coverage.add_sighting(replace(SIGHTING, time_s=time_s))
        coverage.add_imu(ImuSample(time_s, rate, (0.0, 0.0, -9.8), 20.0))


def test_a_recording_that_lacks_something_when_time_is_up_ends_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async def recorded(*_: object, **__: object) -> MotionProgress:
        return MotionProgress(9.0, 0, (0.0, 0.0, 0.0), 0.0, "the pad is not seen", complete=False)

    monkeypatch.setattr(record_motion, "record", recorded)
    assert calibrate("record", tmp_path / "swayed") == 1
    said = capsys.readouterr()
    assert "refused: time is up, and it lacks: the pad is not seen" in said.err
    assert "next:" not in said.out
