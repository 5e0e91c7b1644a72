"""`calibrate-mount`: options, help, and the subcommands `record` and `camera`.

Thin: options in, files and messages out. The computation is in the folders beside it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Final

import cv2
import numpy as np
import typer

from calibration.command_line import RefusedError, run
from calibration.mount.imu.command import (
    ACCELEROMETER_HELP,
    GYRO_HELP,
    accelerometer_command,
    gyro_command,
)
from calibration.mount.record.coverage import MotionProgress
from calibration.mount.record.live import MountRecorder, ShowImage
from calibration.mount.record.recording import read_recording
from calibration.mount.report.plots import write_mount_plots
from calibration.mount.report.result import (
    configured_rotation,
    mount_calibration,
    mount_lines,
    prior_of,
    shutter_s,
)
from calibration.mount.shared import (
    NAME,
    SETTINGS,
    ConfigOption,
    ForceOption,
    OutputOption,
    SensorOpener,
    check_output,
    connected_sensors,
    judge,
    new_log,
    now,
    write_file,
)
from calibration.mount.solve.solve import NoSolutionError, solve
from calibration.mount.solve.verdict import reasons
from companion.base.command_line import VersionOption, new_app
from companion.base.formats.mjpeg import MjpegServer
from companion.config import CameraConfig, CompanionConfig, ConfigError, find_file, load_config, load_model

HELP: Final = """Calibrate the IMU and the camera mount (camera-IMU extrinsics and time offset) in the field.

First calibrate the IMU (once, on a table). Then record while you move the vehicle over the pad, and solve
for the camera. No step needs a screen. The log of a flight that hovered over the pad also works.

\b
calibrate-mount accelerometer -o inertial.yaml
calibrate-mount record swayed
calibrate-mount camera swayed -o mount.yaml --plots pictures
calibrate-mount gyro -o inertial.yaml

The settings then say: mount: mount.yaml, and sense.imu.inertial_calibration: inertial.yaml.

Exit codes: 0 calibrated, 1 refused (the message says why), 2 user error, 130 interrupted.
"""
RECORD_HELP: Final = """Record IMU samples and pad sightings to DIR/flight.mcap.

Hold the vehicle over the pad with the camera facing it, and move it as the program says. It stops by itself.
It needs no autopilot.

\b
calibrate-mount record swayed
calibrate-mount record swayed --config mine.yaml --serve 8080
"""
CAMERA_HELP: Final = """Solve for the camera's rotation, position and time offset from a recording.

LOG is the folder or flight.mcap of 'calibrate-mount record', or of a flight that hovered over the pad.

\b
calibrate-mount camera swayed -o mount.yaml
calibrate-mount camera flights/hover -o mount.yaml --plots pictures
calibrate-mount camera swayed -o mount.yaml --camera my_camera.yaml
"""
cli = new_app()


@cli.callback(help=HELP)
def calibrate_mount(*, version: VersionOption = False) -> None:
    """What all subcommands have in common."""


cli.command(
    "accelerometer",
    help=ACCELEROMETER_HELP,
    short_help="Calibrate the accelerometer on six faces, and the gyro bias.",
)(accelerometer_command)
cli.command("gyro", help=GYRO_HELP, short_help="Calibrate the gyro bias only.")(gyro_command)

# ---------------------------------------------------------------- record


@cli.command("record", help=RECORD_HELP, short_help="Record motion over the pad.")
def record_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.", show_default=False)],
    *,
    config: ConfigOption = SETTINGS,
    seconds: Annotated[
        float, typer.Option("--seconds", min=5.0, max=1800.0, help="Maximum duration.")
    ] = 180.0,
    serve: Annotated[
        int | None,
        typer.Option("--serve", min=0, max=65535, help="Show the image in a browser on this port."),
    ] = None,
) -> None:
    """Record until the motion is enough.

    Raises:
        ConfigError: the folder holds a recording, or a device does not answer.
        RefusedError: the time was not enough.
    """
    settings = load_config(config)
    cv2.setNumThreads(1)
    progress = asyncio.run(record(settings, folder, seconds, serve, connected_sensors, virtual=False))
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


# ---------------------------------------------------------------- camera


@cli.command(
    "camera", help=CAMERA_HELP, short_help="Solve for the camera's rotation, position and time offset."
)
def camera_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Recording to solve.", show_default=False)],
    *,
    output: OutputOption = Path("mount.yaml"),
    camera: Annotated[
        str | None,
        typer.Option("--camera", help="Camera file to use instead of the recording's.", metavar="FILE"),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", help="Write plots to this folder.", metavar="DIR")
    ] = None,
    position_std: Annotated[
        float,
        typer.Option(
            "--position-std", min=0.001, max=1.0, help="Standard deviation of the configured position, m."
        ),
    ] = 0.02,
    max_rotation_deg: Annotated[
        float,
        typer.Option(
            "--max-rotation-deg", min=0.1, max=180.0, help="Maximum rotation from the configured mount."
        ),
    ] = 10.0,
    force: ForceOption = False,
) -> None:
    """Solve, show, judge and write.

    Raises:
        ConfigError: the recording is none, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    check_output(output)
    lens = None if camera is None else load_model(CameraConfig, find_file("cameras", camera))
    recording = read_recording(log, lens)
    place = np.array(recording.vehicle.camera_position_body_m)
    prior = prior_of(recording, position_std)
    try:
        found = solve(recording.inertial, recording.sightings, place, shutter_s(recording), prior)
    except NoSolutionError as error:
        raise RefusedError(f"{log}: {error}") from error
    configured = configured_rotation(recording)
    against = reasons(found, configured, place, max_rotation_deg)
    calibration = mount_calibration(found, recording, against, now())
    for line in mount_lines(calibration, found, recording):
        typer.echo(line)
    if plots is not None:
        pictures = write_mount_plots(plots, found, recording.inertial, configured)
        typer.echo(f"pictures      {', '.join(str(path) for path in pictures)}")
    judge(against, force=force)
    write_file(output, calibration, "mount: {}")


def main() -> None:
    """Entry point."""
    run(cli, NAME)


if __name__ == "__main__":
    main()
