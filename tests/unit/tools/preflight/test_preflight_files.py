"""Calibrations: there, fitting, fresh."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.base import files
from companion.config import CONFIG_FOLDER, CompanionConfig, load_config
from companion.tools.preflight.calibrations import check_files
from companion.tools.preflight.findings import Finding, FindingState
from tests.unit.calibration.test_calibrations_on_record import INERTIAL, MOUNT

NOW = datetime(2026, 6, 1, tzinfo=UTC)
CAMERA = yaml.safe_load((CONFIG_FOLDER / "cameras" / "sitl_640x480.yaml").read_text())
CALIBRATION = {
    "board": "b", "board_bow_m": 0.0, "corners": 900, "rms_px": 0.2, "rms_all_px": 0.3,
    "held_out_rms_px": 0.3,
    "fx_std_px": 0.1, "fy_std_px": 0.1, "cx_std_px": 0.1, "cy_std_px": 0.1, "distortion_std": [0.0] * 5,
    "projection_std_px": 0.1, "coverage": 0.9, "largest_tilt_deg": 40.0,
}  # fmt: skip


def dated(date: str) -> dict[str, Any]:
    return {"tool": "t", "source": "s", "date": date, "samples": 1}


def written(
    folder: Path,
    *,
    camera: str = "2026-05-01T10:00:00+00:00",
    mount: str = "2026-05-02T10:00:00+00:00",
    settings: dict[str, Any] | None = None,
) -> CompanionConfig:
    """Settings with a calibrated camera, a mount and an inertial calibration of these dates."""
    calibration = {**CALIBRATION, "provenance": {**dated(camera), "source": "v4l2:0"}}
    files = {
        "camera.yaml": {**CAMERA, "calibration": calibration},
        "mount.yaml": {**MOUNT.model_dump(mode="json"), "provenance": dated(mount)},
        "inertial.yaml": {**INERTIAL.model_dump(mode="json"), "provenance": dated(mount)},
        "mine.yaml": {
            "camera": "camera.yaml",
            "mount": "mount.yaml",
            "sense": {"imu": {"inertial_calibration": "inertial.yaml"}},
            **(settings or {}),
        },
    }
    for name, content in files.items():
        (folder / name).write_text(yaml.safe_dump(content))
    return load_config(folder / "mine.yaml")


def found(config: CompanionConfig, now: datetime = NOW) -> dict[str, Finding]:
    return {f"{f.group} {f.name}": f for f in check_files(config, Path("mine.yaml"), now)[2]}


def test_fresh_calibrations_are_well(tmp_path: Path) -> None:
    detail = found(written(tmp_path))
    well = {name for name, finding in detail.items() if finding.state is FindingState.OK}
    assert well == {"settings file", "calibration camera", "calibration mount", "calibration inertial"}
    assert detail["settings vehicle"].state is FindingState.WARNING  # the shipped, simulated one
    assert detail["calibration magnetometer"].state is FindingState.WARNING  # none named


@pytest.mark.parametrize(
    ("dates", "now", "name", "words"),
    [
        ({"camera": "2026-05-10T10:00:00+00:00"}, NOW, "mount", "older than the camera's calibration"),
        ({}, datetime(2027, 9, 1, tzinfo=UTC), "camera", "days old"),
        ({}, datetime(2020, 1, 1, tzinfo=UTC), "camera", "in the future"),
        ({"mount": "yesterday"}, NOW, "inertial", "without a date"),
    ],
)
def test_what_is_not_fresh_is_reported(
    dates: dict[str, Any], now: datetime, name: str, words: str, tmp_path: Path
) -> None:
    finding = found(written(tmp_path, **dates), now)[f"calibration {name}"]
    assert finding.state is FindingState.WARNING
    assert words in finding.detail
    assert "calibrate-" in finding.hint or "clock" in finding.hint


def test_a_camera_calibrated_on_another_device_is_reported(tmp_path: Path) -> None:
    config = written(tmp_path, settings={"sense": {"vision": {"source": "picamera2:0"}}})
    assert "sense.vision.source is picamera2:0" in found(config)["calibration camera"].detail


def test_a_mount_of_another_camera_fails(tmp_path: Path) -> None:
    config = written(tmp_path, settings={"camera": "hd_1280x720"})
    detail = found(config)
    assert detail["settings vehicle"].state is FindingState.FAIL
    assert detail["calibration mount"].state is FindingState.FAIL


def test_files_that_are_missing_or_wrong_fail_one_by_one(tmp_path: Path) -> None:
    config = written(tmp_path, settings={"pad": "no_such_pad", "camera": "none.yaml", "mount": None})
    camera, _, findings = check_files(config, Path("mine.yaml"), NOW)
    assert camera is None
    fails = {f.name for f in findings if f.state is FindingState.FAIL}
    assert fails == {"camera", "pad"}
    assert all("\n" not in f.detail for f in findings)


def test_of_an_installed_version_the_file_to_copy_is_named_by_the_link_to_the_one_in_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        files, "CONFIG_FOLDER", Path("/opt/companion/versions/1.0/.venv/lib/companion/configs")
    )
    shown = files.shipped_file("vehicles/x500.yaml")
    assert shown == Path("/opt/companion/current/configs/vehicles/x500.yaml")
