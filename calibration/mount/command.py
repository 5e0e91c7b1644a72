"""`calibrate-mount`: its subcommands, their options and help."""

from pathlib import Path
from typing import Annotated, Final

import typer

from calibration.command_line import ForceOption, PlotsOption, run
from calibration.mount import EXPECTED, FACES, NAME
from companion.base.command_line import ServeOption, VersionOption, new_app
from companion.base.errors import ConfigError
from companion.base.files import (
    DEFAULT_SETTINGS,
    find_file,
    make_folder,
    must_be_readable,
    must_be_writable,
    must_exist,
)

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
cli = new_app()


@cli.callback(help=HELP)
def calibrate_mount(*, version: VersionOption = False) -> None:
    """What all subcommands have in common."""


ConfigOption = Annotated[Path, typer.Option("--config", help="The app's settings.", metavar="FILE")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", help="File to write.", metavar="FILE")]

ACCELEROMETER_HELP: Final = """Calibrate accelerometer offset, scale and skew on six faces, and the gyro bias.

Without LOG it works live: it says which face to lay the vehicle on, and detects when the vehicle is still.
LOG is a flight.mcap or a table (CSV or .npz) of t, ax, ay, az, gx, gy, gz in sensor axes.

\b
calibrate-mount accelerometer -o inertial.yaml
calibrate-mount accelerometer rests.csv -o inertial.yaml --gyro-unit deg/s
"""
GYRO_HELP: Final = """Calibrate the gyro bias only, while the vehicle is still. The accelerometer part stays.

\b
calibrate-mount gyro -o inertial.yaml
calibrate-mount gyro still.csv -o inertial.yaml
"""

KeepOption = Annotated[
    Path | None, typer.Option("--keep", help="Live: also save the samples here.", metavar="DIR")
]
GyroUnitOption = Annotated[
    str | None,
    typer.Option("--gyro-unit", help="Gyro unit of a table: rad/s or deg/s. Default: as in its header."),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", help="Columns of a table, in order: t,ax,ay,az,gx,gy,gz; - skips one."),
]
RateOption = Annotated[
    float | None, typer.Option("--rate", min=1.0, help="Sample rate in Hz of a table without a time column.")
]
LogArgument = Annotated[
    Path | None, typer.Argument(metavar="[LOG]", help="Recording. Default: live.", show_default=False)
]


@cli.command(
    "accelerometer", help=ACCELEROMETER_HELP, short_help="Calibrate accelerometer and gyro bias on six faces."
)
def accelerometer_command(
    log: LogArgument = None,
    *,
    output: OutputOption = Path("inertial.yaml"),
    config: ConfigOption = DEFAULT_SETTINGS,
    order: Annotated[
        str | None,
        typer.Option("--order", help=f"Order of the faces in LOG, to check the mounting: {','.join(FACES)}."),
    ] = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gyro_unit: GyroUnitOption = None,
    keep: KeepOption = None,
    force: ForceOption = False,
) -> None:
    must_be_writable("-o", output, ".yaml")
    _check(log, config, gyro_unit)
    from calibration.mount.imu_calibration import ImuJob, calibrate_on_faces  # noqa: PLC0415 - once the files are there

    calibrate_on_faces(ImuJob(log, config, output, columns, rate, gyro_unit, keep, force=force), order)


@cli.command("gyro", help=GYRO_HELP, short_help="Calibrate the gyro bias only.")
def gyro_command(
    log: LogArgument = None,
    *,
    output: OutputOption = Path("inertial.yaml"),
    config: ConfigOption = DEFAULT_SETTINGS,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gyro_unit: GyroUnitOption = None,
    keep: KeepOption = None,
    force: ForceOption = False,
) -> None:
    must_be_writable("-o", output, ".yaml")
    _check(log, config, gyro_unit)
    from calibration.mount.imu_calibration import ImuJob, calibrate_gyro_bias  # noqa: PLC0415 - once the files are there

    calibrate_gyro_bias(ImuJob(log, config, output, columns, rate, gyro_unit, keep, force=force))


def _check(log: Path | None, config: Path, gyro_unit: str | None) -> None:
    """Whether all that is named is there: what calibrates takes long to import."""
    if gyro_unit not in {None, "rad/s", "deg/s"}:
        raise ConfigError(f"--gyro-unit {gyro_unit}: expected rad/s or deg/s")
    must_be_readable(config)
    if log is not None:
        must_exist(log, "expected a flight.mcap, or a table of t, ax, ay, az, gx, gy, gz")


RECORD_HELP: Final = """Record IMU samples and pad sightings to DIR/flight.mcap.

Hold the vehicle over the pad with the camera facing it, and move it as the program says. It stops by itself.
It needs no autopilot.

\b
calibrate-mount record swayed
calibrate-mount record swayed --config mine.yaml --serve 8080
"""


@cli.command("record", help=RECORD_HELP, short_help="Record motion over the pad.")
def record_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.", show_default=False)],
    *,
    config: ConfigOption = DEFAULT_SETTINGS,
    seconds: Annotated[
        float, typer.Option("--seconds", min=5.0, max=1800.0, help="Maximum duration.")
    ] = 180.0,
    serve: ServeOption = None,
) -> None:
    must_be_readable(config)
    from calibration.mount.record_motion import record_motion  # noqa: PLC0415 - once the settings are there

    record_motion(config, folder, seconds, serve)


CAMERA_HELP: Final = """Solve for the camera's rotation, position and time offset from a recording.

LOG is the folder or flight.mcap of 'calibrate-mount record', or of a flight that hovered over the pad.

\b
calibrate-mount camera swayed -o mount.yaml
calibrate-mount camera flights/hover -o mount.yaml --plots pictures
calibrate-mount camera swayed -o mount.yaml --camera my_camera.yaml
"""


@cli.command("camera", help=CAMERA_HELP, short_help="Solve for the camera's mounting and time offset.")
def camera_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Recording to solve.", show_default=False)],
    *,
    output: OutputOption = Path("mount.yaml"),
    camera: Annotated[
        str | None,
        typer.Option("--camera", help="Camera file to use instead of the recording's.", metavar="FILE"),
    ] = None,
    plots: PlotsOption = None,
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
    must_be_writable("-o", output, ".yaml")
    if plots is not None:
        must_be_writable("--plots", make_folder("--plots", plots) / "mount_rates.png")
    must_exist(log, EXPECTED)
    lens = None if camera is None else find_file("cameras", camera)
    from calibration.mount.result import solve_mount  # noqa: PLC0415 - once the files are there

    solve_mount(log, output, lens, plots, position_std, max_rotation_deg, force=force)


def main() -> None:
    run(cli, NAME)


if __name__ == "__main__":
    main()
