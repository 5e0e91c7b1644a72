"""The check over the pad, whole, in virtual time: what is wrong with a vehicle is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.base.messages import Frame
from companion.config import ConfigError
from companion.tools.pad_check.job import verdict_line
from tests.unit.tools.pad_check.hand_check import check, mirrored, settings, vehicle_file


# the whole check of a right vehicle, and wrong settings on its samples: test_pad_check_samples.py
@pytest.mark.slow
def test_wrong_settings_are_named_with_what_would_fit(tmp_path: Path) -> None:
    wrong = settings(
        vehicle=vehicle_file(tmp_path, camera_yaw_deg=90.0),
        sense={"imu": {"body_from_sensor_deg": [0.0, 0.0, 0.0]}},
    )
    checked = check(wrong, linked=True)
    assert {"level is level", "right is right", "forward is forward", "roll right"} <= checked.failed
    assert checked.failed.isdisjoint({"up is up", "height, low", "height, high", "compass"})
    assert "camera_yaw_deg" in checked.cause("forward is forward")
    assert "is 90; 0 would fit (-90)" in checked.cause("forward is forward")
    assert "body_from_sensor_deg is [0, 0, 0]; [180, 0, 0] would fit" in checked.cause("level is level")
    assert "not ready to fly" in verdict_line(checked.report)


def test_a_mirrored_image_is_named() -> None:
    checked = check(change=mirrored)
    assert checked.failed == {"the pad is seen"}
    assert "mirrored" in checked.cause("the pad is seen")


def test_a_pad_that_is_never_seen_ends_by_time_and_is_reported() -> None:
    def dark(frame: Frame) -> Frame:
        return replace(frame, image=np.zeros_like(frame.image))

    checked = check(change=dark, motion="still", camera={"rate_hz": 2.0})
    assert checked.failed == {"the pad is seen"}
    assert "moving_1300" in checked.cause("the pad is seen")
    assert sum("not seen" in said.text for said in checked.said) > 5


def test_without_an_autopilot_it_says_how_to_do_without() -> None:
    with pytest.raises(
        ConfigError, match="no autopilot heard within 10 s; expected its heartbeat, or --no-link"
    ):
        check(linked=True, deaf=True, camera={"rate_hz": 1.0})


def test_an_autopilot_that_falls_silent_may_be_armed() -> None:
    with pytest.raises(ConfigError, match="has fallen silent for 10 s; expected its heartbeat"):
        check(linked=True, silent_from_s=5.0, motion="still", camera={"rate_hz": 1.0})


def test_an_armed_vehicle_is_refused() -> None:
    with pytest.raises(ConfigError, match="the autopilot says armed"):
        check(linked=True, arm=True, motion="still", camera={"rate_hz": 1.0})
