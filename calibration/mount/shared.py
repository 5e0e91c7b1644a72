"""Shared by the subcommands of `calibrate-mount`: sensors, the verdict, the output file."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import typer
import yaml

from calibration.command_line import RefusedError
from calibration.mount.command import NAME
from companion.base.clock import start_unix_s
from companion.base.files import write_atomically
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    InertialCalibration,
    StrictModel,
    find_file,
    load_model,
)
from companion.flightlog.log_file import LOG_NAMES
from companion.flightlog.record import FlightLog
from companion.sense.camera.source import FrameSource, open_camera
from companion.sense.imu.i2c import RegisterBus, open_bus


def connected_sensors(config: CompanionConfig, camera: bool) -> AbstractAsyncContextManager[MountSensors]:
    """The vehicle's own boards.

    Raises:
        ConfigError: the settings take the inertial samples from the autopilot.
    """
    if config.sense.source != "boards":
        raise ConfigError(
            f"sense.source: '{config.sense.source}'; live it takes boards, expected those or the log of a "
            "flight over the pad"
        )
    return open_sensors(config, camera=camera)


def new_log(folder: Path, *, virtual: bool) -> FlightLog:
    """A log in a folder that has none yet.

    Raises:
        ConfigError: it holds one, or cannot be written.
    """
    if (folder / LOG_NAMES[0]).exists():
        raise ConfigError(f"{folder}: holds a recording already; expected a new or empty folder")
    return FlightLog(folder, start_unix_s(virtual=virtual))


def inertial_file(path: Path) -> InertialCalibration:
    """Read what an earlier run wrote.

    Raises:
        ConfigError: it is missing or wrong.
    """
    return load_model(InertialCalibration, path)


def judge(against: tuple[str, ...], *, force: bool) -> None:
    """Say the verdict.

    Raises:
        RefusedError: something speaks against it, and it is not forced.
    """
    if against and not force:
        raise RefusedError("; ".join(against))
    for reason in against:
        typer.echo(f"forced, though: {reason}")
    if not against:
        typer.echo("verdict       good")


def write_file(path: Path, calibration: StrictModel, setting: str) -> None:
    """Write a calibration; `setting` is a format of what the settings say then, for people.

    Raises:
        ConfigError: it cannot be written.
    """
    text = yaml.safe_dump(calibration.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=110)
    write_atomically(
        path, f"# Written by {NAME}; the app reads it by the setting {setting.format(path)}\n{text}"
    )
    typer.echo(f"written       {path}; the settings then say {setting.format(path)}")


def now() -> str:
    """Today, UTC."""
    return datetime.fromtimestamp(start_unix_s(virtual=True), UTC).isoformat(timespec="seconds")


# ---------------------------------------------------------------- devices
# The sensors that a mount calibration needs: IMU, and camera if wanted. No autopilot.


@dataclass(frozen=True, slots=True)
class MountSensors:
    """Open sensors; a simulator in the same process has the same interfaces."""

    imu_bus: RegisterBus
    frames: FrameSource | None = None


SensorOpener = Callable[[CompanionConfig, bool], AbstractAsyncContextManager[MountSensors]]


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
