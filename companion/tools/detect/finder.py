"""One picture through the vision stage: the markers, and the pad's pose as the camera has it. Pure.

Nothing is known of the vehicle here, so there is no expectation of the pad and no direction of gravity: what
is found is what the app would find in its first look. Camera axes are OpenCV's (x right, y down, z ahead).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import Vision, body_from_camera

# without an expectation, vision looks in turn for what is far and what is near
LOOKS: Final = 2
# the camera alone: it is the vehicle's reference point, and the body's axes are turned from its own
CAMERA_ALONE: Final = VehicleConfig(
    name="camera", camera_position_body_m=(0.0, 0.0, 0.0), range_position_body_m=(0.0, 0.0, 0.0),
    leg_height_m=0.02, hover_thrust=0.5,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PadView:
    """The pad as one picture shows it, in camera axes.

    `position_m` (3,) is the pad's centre, `camera_from_pad` (3, 3) its rotation. `along_std_m` is the stated
    standard deviation along the line of sight, `across_std_m` in each direction across it.
    """

    position_m: FloatArray
    camera_from_pad: FloatArray
    along_std_m: float
    across_std_m: float
    reprojection_error_px: float

    @property
    def distance_m(self) -> float:
        """From the camera to the pad's centre."""
        return float(np.linalg.norm(self.position_m))

    @property
    def slant_deg(self) -> float:
        """Angle between the line of sight and the pad's normal: 0 is straight above it."""
        cosine = float(self.camera_from_pad[:, 2] @ self.position_m) / self.distance_m
        return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


@dataclass(frozen=True, slots=True)
class Found:
    """What one picture gave. `markers` are those of the pose; without a pose, those that were read."""

    markers: tuple[Detection, ...]
    view: PadView | None


class PadFinder:
    """The app's vision over single pictures."""

    def __init__(self, pad: Pad, camera: CameraConfig, config: VisionConfig) -> None:
        self.pad = pad
        self.camera = camera
        self.lens = Lens(camera)
        self._vision = Vision(pad, camera, CAMERA_ALONE, config)
        self._camera_from_body = matrix_from_quat(body_from_camera(CAMERA_ALONE)).T

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height that the calibration is for."""
        return self.lens.size_px

    def find(self, image: NDArray[np.uint8]) -> Found:
        """Look for what is far and for what is near, as the app does in two frames that follow each other.

        Raises:
            ValueError: the image (height, width) is not of the calibrated size.
        """
        read: tuple[Detection, ...] = ()
        for _ in range(LOOKS):
            result = self._vision.step(Frame(0.0, 0.0, 0, image), None)
            if result.sighting is not None:
                return Found(result.used, self._view(result.sighting))
            read = max(read, result.read, key=len)
        return Found(read, None)

    def _view(self, sighting: PadSighting) -> PadView:
        turn = self._camera_from_body
        position = turn @ np.array(sighting.pad_position_body_m)
        covariance = turn @ sighting.covariance[:3, :3] @ turn.T
        ray = position / np.linalg.norm(position)
        along = float(ray @ covariance @ ray)
        across = 0.5 * max(float(np.trace(covariance)) - along, 0.0)
        return PadView(
            position, turn @ matrix_from_quat(sighting.body_from_pad), math.sqrt(along), math.sqrt(across),
            sighting.reprojection_error_px,
        )  # fmt: skip
