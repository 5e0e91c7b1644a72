"""A camera in a world: it exposes at its rate, and renders when the last row has been read.

Times are the world's (s); a frame is stamped with the mid-exposure of its middle row.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.messages import Frame, Truth
from companion.pad import load_pad
from sitl import camera as lens
from sitl.exposure import CameraSettings
from sitl.scenario import Scenario


class Scene(Protocol):
    """A world as the camera sees it."""

    def truth_at(self, time_s: float) -> Truth:
        """Vehicle and pad at a time of the last 0.3 s, s of the world."""
        ...


class SceneCamera:
    """Exposes at the camera's rate and renders when the last row has been read."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: VehicleConfig,
        world: Scene,
        noise_rng: np.random.Generator,
        latency_rng: np.random.Generator,
        lens_rng: np.random.Generator,
        start_s: float = 0.0,
    ) -> None:
        """Its first frame is a period after `start_s` (world time)."""
        settings = scenario.camera
        calibration = load_model(CameraConfig, find_file("cameras", settings.config))
        config = ground_otherwise(calibration, settings.calibration_error, lens_rng)
        develop = CameraSettings(
            exposure_s=settings.exposure_s,
            readout_s=settings.readout_s,
            noise_grey=settings.noise_grey,
            motion_blur=settings.blur,
            light=scenario.light,
            exposure=settings.exposure,
            dirt=settings.dirt,
        )
        self._model = lens.CameraModel(config, vehicle, load_pad(scenario.pad.name), develop, noise_rng)
        self._world = world
        self._settings = settings
        self._rng = latency_rng
        self._period_s = 1.0 / (settings.rate_hz or config.rate_hz)
        self._sequence = 0
        self._next_s = start_s + self._period_s

    @property
    def exposed_s(self) -> float:
        """When the next frame's last row will have been read (world time)."""
        return self._next_s + 0.5 * self._model.span_s

    def skip_to(self, now_s: float) -> None:
        """Drop the frames whose exposure ended before now_s (world time); they are counted."""
        missed = max(0, math.ceil((now_s - self.exposed_s) / self._period_s))
        self._next_s += missed * self._period_s
        self._sequence += missed

    def step(self, now_s: float) -> tuple[Frame, float] | None:
        """The frame whose exposure has just ended, and when it is to be delivered (world time)."""
        if now_s < self.exposed_s:
            return None
        time_s = self._next_s
        self._next_s += self._period_s
        image = self._model.render(time_s, self._scene_at)
        late = self._settings.latency_s + self._settings.latency_jitter_s * float(
            self._rng.uniform(-1.0, 1.0)
        )
        frame = Frame(time_s=time_s, received_s=time_s, sequence=self._sequence, image=image)
        self._sequence += 1
        return frame, time_s + late

    def _scene_at(self, time_s: float) -> lens.ScenePose:
        truth = self._world.truth_at(time_s)
        return lens.ScenePose(
            vehicle_position_ned_m=truth.vehicle_position_ned_m,
            vehicle_attitude=truth.vehicle_attitude,
            pad_position_ned_m=truth.pad_position_ned_m,
            pad_heading_rad=truth.pad_heading_rad,
            pad_roll_rad=truth.pad_roll_rad,
            pad_pitch_rad=truth.pad_pitch_rad,
        )


def ground_otherwise(calibration: CameraConfig, error: float, rng: np.random.Generator) -> CameraConfig:
    """The lens itself, which no calibration meets; `error` is a standard deviation, of the focal length."""
    longer, right, down = (error * rng.standard_normal(3)).tolist()
    return calibration.model_copy(
        update={
            "fx_px": calibration.fx_px * (1.0 + longer),
            "fy_px": calibration.fy_px * (1.0 + longer),
            "cx_px": calibration.cx_px + right * calibration.fx_px,
            "cy_px": calibration.cy_px + down * calibration.fy_px,
        }
    )
