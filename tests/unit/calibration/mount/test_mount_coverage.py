"""What `calibrate-mount` asks for next, and how a recording ends that lacks something."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.mount import record_motion
from calibration.mount.record_motion import MotionCoverage, MotionProgress
from companion.base.geometry import IDENTITY
from companion.base.messages import ImuSample, PadSighting
from tests.unit.calibration.mount.mount_words import calibrate


def test_the_coverage_asks_for_what_is_missing() -> None:
    coverage = MotionCoverage()
    assert coverage.progress().advice == "waiting for the inertial sensor"
    coverage.add_imu(ImuSample(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 20.0))
    assert "pad is not seen" in coverage.progress().advice
    sighting = PadSighting(
        0.0, 1, (0.0, 0.0, 1.0), IDENTITY, np.eye(6), "M", (1,), {"F": 0, "M": 1, "C": 0}, 0.1
    )
    move(coverage, sighting, 0.0, 15.0, (0.0, 0.5, 0.5))
    assert coverage.progress().advice == "roll it left and right"
    move(coverage, sighting, 15.0, 36.0, (0.4, 0.0, 0.0))
    assert coverage.progress().advice == "enough"
    assert coverage.progress().complete


def test_slow_motion_is_not_enough() -> None:
    coverage = MotionCoverage()
    sighting = PadSighting(
        0.0, 1, (0.0, 0.0, 1.0), IDENTITY, np.eye(6), "M", (1,), {"F": 0, "M": 1, "C": 0}, 0.1
    )
    move(coverage, sighting, 0.0, 40.0, (0.2, 0.2, 0.2))
    assert coverage.progress().advice == "the same again, more quickly"


def move(
    coverage: MotionCoverage,
    sighting: PadSighting,
    from_s: float,
    to_s: float,
    rate: tuple[float, float, float],
) -> None:
    for k in range(round(50 * (to_s - from_s))):
        time_s = from_s + k / 50.0
        coverage.add_sighting(replace(sighting, time_s=time_s))
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
