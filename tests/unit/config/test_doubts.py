"""Calibrations that were written by force are told at every start."""

from pathlib import Path

import pytest
import yaml

from companion.app.calibration_warnings import forced_calibrations
from companion.config import CameraConfig, CompanionConfig, find_file, load_model

PROVENANCE = {"tool": "t", "source": "s", "date": "2026-01-01T00:00:00+00:00", "samples": 4}
QUALITY = {
    **{"board": "charuco", "board_bow_m": 0.0, "corners": 90, "rms_px": 0.1, "rms_all_px": 0.1},
    **{"held_out_rms_px": None, "fx_std_px": 9.0, "fy_std_px": 9.0, "cx_std_px": 9.0, "cy_std_px": 9.0},
    **{"distortion_std": [0.1] * 5, "projection_std_px": 9.0, "coverage": 0.3, "largest_tilt_deg": 9.0},
}


def settings(tmp_path: Path, verdict: list[str], forced: list[str]) -> CompanionConfig:
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480")).model_dump(mode="json")
    camera["calibration"] = {**QUALITY, "provenance": PROVENANCE, "verdict": verdict}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(camera))
    inertial = {
        "gyro": {"bias_rad_s": [0.0] * 3, "std_rad_s": 0.1, "temperature_c": 20.0},
        "forced": forced,
        "provenance": PROVENANCE,
    }
    (tmp_path / "inertial.yaml").write_text(yaml.safe_dump(inertial))
    return CompanionConfig.model_validate(
        {
            "camera": str(tmp_path / "mine.yaml"),
            "sense": {"imu": {"inertial_calibration": str(tmp_path / "inertial.yaml")}},
        }
    )


@pytest.mark.parametrize(
    ("verdict", "forced", "words"),
    [
        ([], [], []),
        (["too few views"], [], ["mine.yaml was written by force: too few views"]),
        ([], ["it moved"], ["inertial.yaml was written by force: it moved"]),
    ],
)
def test_forced_calibrations_are_reported(
    verdict: list[str], forced: list[str], words: list[str], tmp_path: Path
) -> None:
    lines = list(forced_calibrations(settings(tmp_path, verdict, forced)))
    assert len(lines) == len(words)
    assert all(line.endswith(word) for line, word in zip(lines, words, strict=True))


def test_what_is_shipped_is_beyond_doubt() -> None:
    assert list(forced_calibrations(CompanionConfig())) == []
