"""The live picture shows what the app takes for forward and right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import IDENTITY
from companion.base.messages import Frame, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import load_pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pad_check.session import draw
from companion.tools.pad_check.wizard import Wizard
from tests.unit.tools.pad_check.hand_check import MOUNTING

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
