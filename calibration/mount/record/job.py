"""What `calibrate-mount record` does: boards in, a recording out."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import typer

from calibration.command_line import RefusedError
from calibration.mount.options import NAME
from calibration.mount.record.coverage import MotionProgress
from calibration.mount.record.live import MountRecorder, ShowImage
from calibration.mount.shared import SensorOpener, connected_sensors, new_log
from companion.base.formats.mjpeg import MjpegServer
from companion.base.signals import run_until_stopped
from companion.config import CompanionConfig, ConfigError, load_config


def record_motion(config: Path, folder: Path, seconds: float, serve: int | None) -> None:
    """Record from the vehicle's boards until the motion is enough.

    Raises:
        ConfigError: the folder holds a recording, or a device does not answer.
        RefusedError: the time was not enough.
    """
    settings = load_config(config)
    cv2.setNumThreads(1)
    progress = run_until_stopped(record(settings, folder, seconds, serve, connected_sensors, virtual=False))
    if not progress.complete:
        raise RefusedError(f"time is up, and it lacks: {progress.advice}; what there is of it is in {folder}")
    typer.echo(f"recorded in {folder}; next: {NAME} camera {folder} -o mount.yaml")


async def record(
    config: CompanionConfig,
    folder: Path,
    longest_s: float,
    serve: int | None,
    sensors_of: SensorOpener,
    *,
    virtual: bool,
) -> MotionProgress:
    """Record from boards into a folder; returns how far it came.

    Raises:
        ConfigError: the folder holds a recording, or a device does not answer.
    """
    async with sensors_of(config, True) as sensors, _served(serve) as show:
        log = new_log(folder, virtual=virtual)
        try:
            progress = await MountRecorder(config, sensors, log, typer.echo, show).run(longest_s)
        except BaseException:  # Ctrl-C as well: half a recording is none
            log.discard()
            raise
        log.close()
        if log.problem is not None:  # the last of it is written at the end
            log.discard()
            raise ConfigError(f"{folder}: {log.problem}; expected room for the recording")
    return progress


@asynccontextmanager
async def _served(port: int | None) -> AsyncIterator[ShowImage | None]:
    """What shows a picture in browsers, if a port was given."""
    if port is None:
        yield None
        return
    server = MjpegServer()
    try:
        taken = await server.start(port)
    except OSError as error:
        raise ConfigError(f"--serve {port}: {error.strerror}; expected a free port") from error
    typer.echo(f"picture at http://127.0.0.1:{taken}/")
    try:
        yield server.show
    finally:
        await server.close()
