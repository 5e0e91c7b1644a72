"""The shipped pad, camera and airframe, and pictures of the pad with what is true in them."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from companion.base.geometry import (
    Quaternion,
    Vector3,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
)
from companion.base.messages import Frame
from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.pad import Pad, load_pad
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings

# the vehicle's position (from the pad's surface, NED) and attitude, the pad's heading -> frame, truth
TakePicture = Callable[..., tuple[Frame, Vector3, Quaternion]]


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="session")
def pad() -> Pad:
    return load_pad("moving_1300")


@pytest.fixture(scope="session")
def camera() -> CameraConfig:
    return load_model(CameraConfig, find_file("cameras", "sitl_640x480"))


@pytest.fixture(scope="session")
def vehicle() -> VehicleConfig:
    return load_model(VehicleConfig, find_file("vehicles", "x500"))


@pytest.fixture(scope="session")
def take_picture(pad: Pad, camera: CameraConfig, vehicle: VehicleConfig) -> TakePicture:
    """A picture at time 0 with the default noise; truth: the pad in body axes, and body-from-pad."""
    models: dict[VehicleConfig, CameraModel] = {}
    noise = np.random.default_rng(0)

    def take(
        position_m: Vector3,
        attitude: Quaternion,
        heading_rad: float = 0.0,
        *,
        velocity_m_s: Vector3 = (0.0, 0.0, 0.0),
        mounted: VehicleConfig = vehicle,
        at_s: float = 0.0,
        seed: int = 4,
    ) -> tuple[Frame, Vector3, Quaternion]:
        def scene(time_s: float) -> ScenePose:
            x, y, z = (p + v * time_s for p, v in zip(position_m, velocity_m_s, strict=True))
            return ScenePose((x, y, z - 0.3), attitude, (0.0, 0.0, -0.3), heading_rad)

        # a camera draws from it as it is made: its pixels are the same ones, whichever tests ran before
        noise.bit_generator.state = np.random.default_rng(0).bit_generator.state
        if mounted not in models:
            models[mounted] = CameraModel(camera, mounted, pad, ImagingSettings(), noise)
        # and a picture's noise is its own
        noise.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        image = models[mounted].render(0.0, scene)
        to_body = quat_conjugate(attitude)
        x, y, z = (p + v * at_s for p, v in zip(position_m, velocity_m_s, strict=True))
        truth = quat_rotate(to_body, (-x, -y, -z))
        return (
            Frame(0.0, 0.03, 7, image),
            truth,
            quat_multiply(to_body, quat_from_euler(0.0, 0.0, heading_rad)),
        )

    return take
