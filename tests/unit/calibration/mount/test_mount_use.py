"""What the app makes of the angles and stamps of a mount."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calibration.mount.result import camera_angles_deg
from companion.base.geometry import matrix_from_quat
from companion.base.messages import Frame
from companion.config import (
    VehicleConfig,
    find_file,
    load_model,
)
from companion.sense.camera.source import at_exposure
from companion.sense.vision.pipeline import body_from_camera
from sitl.camera.camera import body_from_camera as simulated_body_from_camera


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (5.0, -3.0, 20.0), (-30.0, 20.0, 170.0)])
def test_the_angles_mean_the_same_to_the_app_and_to_the_simulator(angles: tuple[float, float, float]) -> None:
    roll, tilt, yaw = angles
    vehicle = load_model(VehicleConfig, find_file("vehicles", "x500")).model_copy(
        update={"camera_roll_deg": roll, "camera_tilt_deg": tilt, "camera_yaw_deg": yaw}
    )
    ours = matrix_from_quat(body_from_camera(vehicle))
    theirs = simulated_body_from_camera(math.radians(yaw), math.radians(tilt), math.radians(roll))
    assert ours == pytest.approx(theirs, abs=1e-12)
    assert camera_angles_deg(ours) == pytest.approx(angles, abs=1e-9)


def test_a_rolled_camera_looks_to_the_left() -> None:
    assert simulated_body_from_camera(0.0, 0.0, 0.3)[1, 2] < 0.0


def test_late_stamps_are_set_back_by_a_negative_offset() -> None:
    frame = Frame(10.02, 10.05, 1, np.zeros((2, 2), np.uint8))
    assert at_exposure(frame, -0.02).time_s == pytest.approx(10.0)
    assert at_exposure(frame, 0.0) is frame
