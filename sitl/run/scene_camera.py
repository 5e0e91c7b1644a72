"""A camera in a world: it exposes at its rate, and renders when the last row has been read.

Times are the world's (s); a frame is stamped with the mid-exposure of its middle row, and with the stamp
error of the scenario's camera.
"""

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from companion.base.clock import AT_ONCE
from companion.base.encoding import light_of_greys
from companion.base.geometry import FloatArray, Vector3, add
from companion.base.messages import Frame
from companion.config import CameraConfig, VehicleConfig, find_file, load_model
from companion.pad import load_pad
from sitl.camera import camera as optics
from sitl.camera.exposure import ImagingSettings
from sitl.external.world import ExternalWorld
from sitl.scenario.as_built import AS_BELIEVED, BuiltVehicle
from sitl.scenario.scenario import Scenario
from sitl.world.world import World


@dataclass(frozen=True, slots=True)
class CameraTruth:
    """The true parameters of the simulated camera: for tests and benches, never for the app.

    `lens` are its true intrinsics, `body_from_camera` (3, 3) and `position_body_m` (FRD) how it is mounted;
    `stamp_error_s` is what its frames' times are too large by.
    """

    lens: CameraConfig
    body_from_camera: FloatArray
    position_body_m: Vector3
    stamp_error_s: float


class SceneCamera:
    """Exposes at the camera's rate and renders when the last row has been read, by its `model`."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: VehicleConfig,
        world: World | ExternalWorld,
        noise_rng: np.random.Generator,
        latency_rng: np.random.Generator,
        lens_rng: np.random.Generator,
        start_s: float = 0.0,
        built: BuiltVehicle = AS_BELIEVED,
        begin: Callable[..., Future[None]] = AT_ONCE.submit,
    ) -> None:
        """Its first frame is a period after `start_s` (world time); `begin` has its pictures drawn."""
        settings = scenario.camera
        calibration = load_model(CameraConfig, find_file("cameras", settings.config))
        config = perturbed_lens(calibration, settings.calibration_error, lens_rng, built.focal_length)
        develop = ImagingSettings(
            exposure_s=settings.exposure_s,
            readout_s=settings.readout_s,
            noise_grey=settings.noise_grey,
            motion_blur=settings.blur,
            light=scenario.light,
            exposure=settings.exposure,
            dirt=settings.dirt,
        )
        vehicle = vehicle.model_copy(
            update={"camera_position_body_m": add(vehicle.camera_position_body_m, settings.mount_offset_m)}
        )
        self.model = optics.CameraModel(
            config,
            vehicle,
            built.pad(load_pad(scenario.pad.name)),
            develop,
            noise_rng,
            mount_error_deg=add(settings.mount_error_deg, built.camera_mount_deg),
        )
        self.truth = CameraTruth(
            config,
            self.model.body_from_camera,
            vehicle.camera_position_body_m,
            settings.stamp_error_s + built.stamp_s,
        )
        self._stamp_jitter_s, self._stamp_rng = built.stamp_jitter_s, lens_rng
        self._world = world
        self._settings = settings
        self._rng = latency_rng
        self._period_s = 1.0 / (settings.rate_hz or config.rate_hz)
        self._sequence = 0
        self._next_s = start_s + self._period_s
        self._begin, self._drawing = begin, AT_ONCE.submit(lambda: None)

    @property
    def exposed_s(self) -> float:
        """When the next frame's last row will have been read (world time)."""
        self.finish()  # an automatic exposure goes by the picture before
        return self._next_s + 0.5 * self.model.span_s

    def skip_to(self, now_s: float) -> None:
        """Drop the frames whose exposure ended before now_s (world time); they are counted."""
        missed = max(0, math.ceil((now_s - self.exposed_s) / self._period_s))
        self._next_s += missed * self._period_s
        self._sequence += missed

    def step(self, now_s: float) -> tuple[Frame, float] | None:
        """The frame whose exposure has just ended, and when it is to be delivered (world time).

        Its image is being drawn, until `finish` has returned.
        """
        if now_s < self._next_s or now_s < self.exposed_s:
            return None
        time_s = self._next_s
        self._next_s += self._period_s
        image = self.model.blank()
        self._drawing = self._begin(self.model.expose(time_s, self._scene_at), image)
        late = self._settings.latency_s + self._settings.latency_jitter_s * float(
            self._rng.uniform(-1.0, 1.0)
        )
        frame = Frame(
            time_s=time_s + self._stamp_error_s(), received_s=time_s, sequence=self._sequence, image=image
        )
        self._sequence += 1
        return frame, time_s + late

    def finish(self) -> None:
        """Wait until the newest frame's image is drawn."""
        self._drawing.result()

    def _stamp_error_s(self) -> float:
        error_s = self.truth.stamp_error_s
        if self._stamp_jitter_s:
            error_s += self._stamp_jitter_s * float(self._stamp_rng.uniform(-1.0, 1.0))
        return error_s

    def _scene_at(self, time_s: float) -> optics.ScenePose:
        truth = self._world.truth_at(time_s)
        return optics.ScenePose(
            vehicle_position_ned_m=truth.vehicle_position_ned_m,
            vehicle_attitude=truth.vehicle_attitude,
            pad_position_ned_m=truth.pad_position_ned_m,
            pad_heading_rad=truth.pad_heading_rad,
            pad_roll_rad=truth.pad_roll_rad,
            pad_pitch_rad=truth.pad_pitch_rad,
        )


def perturbed_lens(
    calibration: CameraConfig, error: float, rng: np.random.Generator, built: float = 1.0
) -> CameraConfig:
    """The true camera, which differs from the calibration by `error`, a standard deviation of the focal
    length, and by the factor `built`.

    And by its encoding, as much as the calibration says that it may.
    """
    longer, right, down = (error * rng.standard_normal(3)).tolist()
    longer = built * (1.0 + longer) - 1.0 if built != 1.0 else longer
    exponent = 1.0 + calibration.encoding_error * float(rng.standard_normal())
    return calibration.model_copy(
        update={
            "fx_px": calibration.fx_px * (1.0 + longer),
            "fy_px": calibration.fy_px * (1.0 + longer),
            "cx_px": calibration.cx_px + right * calibration.fx_px,
            "cy_px": calibration.cy_px + down * calibration.fy_px,
            "encoding": tuple((light_of_greys(calibration.encoding) ** exponent).tolist()),
        }
    )
