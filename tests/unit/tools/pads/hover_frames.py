"""Frames of a pad as a hovering vehicle's camera takes them: poses spread as the prediction assumes them."""

import math

import numpy as np

from companion.base.geometry import add, quat_conjugate, quat_from_euler, quat_multiply, quat_rotate, subtract
from companion.base.messages import Frame, PadPrior
from companion.config import CameraConfig, VehicleConfig, VisionConfig, find_file, load_model
from companion.pad import Pad
from companion.sense.vision.pipeline import Vision
from companion.tools.pads.coverage import HOVER, HoverSpread
from sitl.camera.camera import CameraModel, ScenePose
from sitl.camera.exposure import ImagingSettings

BOARD = (0.0, 0.0, -0.1)


class Hover:
    """A camera that hovers over a pad, and the eyes that look for it where it is expected, as in flight."""

    def __init__(self, pad: Pad, camera_name: str, seed: int, spread: HoverSpread = HOVER) -> None:
        self._camera = load_model(CameraConfig, find_file("cameras", camera_name))
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", "x500"))
        self._rng, self._spread = np.random.default_rng(seed), spread
        self._model = CameraModel(self._camera, self._vehicle, pad, ImagingSettings(), self._rng)
        self._vision = Vision(pad, self._camera, self._vehicle, VisionConfig())

    def recall(self, height_m: float, frames: int) -> float:
        """Share of the frames from a height in which the pad was recognised."""
        seen = 0
        for _ in range(frames):
            frame, prior = self.picture(height_m)
            seen += self._vision.step(frame, prior).sighting is not None
        return seen / frames

    def picture(self, height_m: float) -> tuple[Frame, PadPrior]:
        """A frame, and where the eyes expect the pad."""
        rng, spread = self._rng, self._spread
        roll, pitch = np.radians(rng.normal(0.0, spread.tilt_deg, 2)).tolist()
        yaw, course = rng.uniform(-math.pi, math.pi, 2).tolist()
        attitude = quat_from_euler(roll, pitch, yaw)
        std = math.hypot(spread.offset_m, spread.offset_share * height_m)
        aside_x, aside_y = rng.normal(0.0, std, 2).tolist()
        # the prediction turns the camera about the place over which it is: so here, at its own height
        lens = add(BOARD, (aside_x, aside_y, -height_m))
        start = subtract(lens, quat_rotate(attitude, self._vehicle.camera_position_body_m))
        vx, vy = spread.speed_m_s * math.cos(course), spread.speed_m_s * math.sin(course)

        def scene(time_s: float) -> ScenePose:
            x, y, z = start
            return ScenePose((x + vx * time_s, y + vy * time_s, z), attitude, BOARD, 0.0)

        to_body = quat_conjugate(attitude)
        std_m = 0.005 + 0.01 * height_m
        error_x, error_y, error_z = rng.normal(0.0, std_m, 3).tolist()
        prior = PadPrior(
            0.0,
            quat_rotate(to_body, (0.0, 0.0, 1.0)),
            add(quat_rotate(to_body, subtract(BOARD, start)), (error_x, error_y, error_z)),
            quat_multiply(to_body, quat_from_euler(0.0, 0.0, 0.0)),
            std_m,
        )
        return Frame(0.0, 0.0, 0, self._model.render(0.0, scene)), prior
