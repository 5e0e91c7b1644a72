"""The check over the pad, whole, in virtual time: what is wrong with a vehicle is named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.geometry import IDENTITY
from companion.base.messages import Frame, PadPrior, PadSighting
from companion.config import CameraConfig, ConfigError, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import load_pad
from companion.sense.vision.pipeline import Vision, VisionResult
from companion.tools.pad_check.job import verdict_line
from companion.tools.pad_check.session import MirrorWatch, draw
from companion.tools.pad_check.wizard import Wizard
from tests.unit.tools.pad_check.hand_check import MOUNTING, check, mirrored, settings, vehicle_file


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


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"deaf": True}, "no autopilot heard within 10 s; expected its heartbeat, or --no-link"),
        ({"silent_from_s": 5.0}, "has fallen silent for 10 s; expected its heartbeat"),  # it may be armed
        ({"arm": True}, "the autopilot says armed"),
    ],
)
def test_without_an_autopilot_that_says_disarmed_it_ends(line: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        check(linked=True, motion="still", camera={"rate_hz": 1.0}, **line)


# ---------------- The watch on whether the eyes are shown a mirror image

IMAGE = np.tile(np.arange(64, dtype=np.uint8), (48, 1))


class CountingVision:
    """Sees nothing, and notes at which turn of the search it was shown a mirrored frame."""

    def __init__(self) -> None:
        self.turn = 0
        self.mirrored_at: list[int] = []

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
        self.turn += 1
        if frame.image[0, 0] > frame.image[0, -1]:
            self.mirrored_at.append(self.turn)
        return VisionResult(None, {"F": 0, "M": 0, "C": 0}, searched_whole_frame=True)


def test_a_mirrored_pad_is_looked_for_far_and_near() -> None:
    vision: Any = CountingVision()
    eyes = MirrorWatch(vision)
    for k in range(60):
        eyes.step(Frame(k / 30, k / 30, k, IMAGE), None)
    turns = [turn % 2 for turn in vision.mirrored_at]
    assert len(turns) >= 8
    assert abs(turns.count(0) - turns.count(1)) <= 1


# ---------------- The live picture shows what the app takes for forward and right

GREEN, RED = (80, 220, 80), (60, 60, 255)  # forward, right; blue, green, red
PAD = load_pad("moving_1300")
BLACK = Frame(0.0, 0.0, 0, np.zeros((480, 640), np.uint8))
SIGHTING = PadSighting(
    time_s=0.0,
    sequence=0,
    pad_position_body_m=(0.03, 0.0, 1.0),  # under the camera
    body_from_pad=IDENTITY,
    covariance=np.eye(6),
    group="F",
    marker_ids=(0,),
    marker_count={"F": 1, "M": 0, "C": 0},
    reprojection_error_px=0.1,
)


def middle_of(
    colour: tuple[int, int, int], camera_yaw_deg: float, sighting: PadSighting | None
) -> np.ndarray:
    """Where a colour is in the picture (right, down), from the image's middle (px)."""
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    shipped = load_model(VehicleConfig, find_file("vehicles", "x500"))
    vehicle = shipped.model_copy(update={"camera_yaw_deg": camera_yaw_deg})
    image = draw(BLACK, sighting, Vision(PAD, camera, vehicle, VisionConfig()), PAD, Wizard(MOUNTING, 0.0))
    assert image.shape == (480, 640, 3)
    rows, columns = np.nonzero((image == np.array(colour)).all(axis=2))
    assert len(rows) > 50
    return np.array((columns.mean() - 321.4, rows.mean() - 238.2))


@pytest.mark.parametrize("sighting", [SIGHTING, None])
def test_the_arrows_point_where_the_settings_say(sighting: PadSighting | None) -> None:
    forward, right = (middle_of(colour, 0.0, sighting) for colour in (GREEN, RED))
    assert forward[1] < -20.0 < 20.0 < right[0]
    # a camera whose image's top is to the right shows forward to the left
    forward, right = (middle_of(colour, 90.0, sighting) for colour in (GREEN, RED))
    assert forward[0] < -20.0
    assert right[1] < -20.0


def test_a_pad_that_is_out_of_view_draws_nothing_wrong() -> None:
    behind = replace(SIGHTING, pad_position_body_m=(0.0, 0.0, -1.0))
    camera = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
    image = draw(BLACK, behind, Vision(PAD, camera, vehicle, VisionConfig()), PAD, Wizard(MOUNTING, 0.0))
    assert not (image[40:] != 0).any()
