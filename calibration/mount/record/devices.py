"""The sensors that a mount calibration needs: IMU, and camera if wanted. No autopilot."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager, closing
from dataclasses import dataclass

from companion.config import CameraConfig, CompanionConfig, find_file, load_model
from companion.sense.camera.source import FrameSource, open_camera
from companion.sense.imu.i2c import RegisterBus, open_bus


@dataclass(frozen=True, slots=True)
class MountSensors:
    """Open sensors; a simulator in the same process has the same interfaces."""

    imu_bus: RegisterBus
    frames: FrameSource | None = None


@asynccontextmanager
async def open_sensors(config: CompanionConfig, *, camera: bool) -> AsyncIterator[MountSensors]:
    """Open what the settings name, and close it again at the end.

    Raises:
        ConfigError: a bus or the camera is missing, taken or misspelt; one line says which.
    """
    vision = config.sense.vision
    with ExitStack() as opened:
        bus = opened.enter_context(closing(open_bus(config.sense.imu.bus)))
        frames: FrameSource | None = None
        if camera:
            lens = load_model(CameraConfig, find_file("cameras", config.camera))
            frames = opened.enter_context(
                closing(await open_camera(vision.source, lens, vision.unstamped_latency_s))
            )
        yield MountSensors(bus, frames)
