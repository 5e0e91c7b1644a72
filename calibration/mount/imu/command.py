"""`calibrate-mount accelerometer` and `gyro`: their options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from calibration.mount.imu import FACES
from calibration.mount.options import SETTINGS, ConfigOption, ForceOption, OutputOption, check_output
from companion.base.errors import ConfigError
from companion.base.files import must_be_readable, must_exist

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


def accelerometer_command(
    log: LogArgument = None,
    *,
    output: OutputOption = Path("inertial.yaml"),
    config: ConfigOption = SETTINGS,
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
    """Collect static intervals, fit, judge and write.

    Raises:
        ConfigError: no samples, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    check_output(output)
    _check(log, config, gyro_unit)
    from calibration.mount.imu.job import ImuJob, calibrate_on_faces  # noqa: PLC0415 - once the files are there

    calibrate_on_faces(ImuJob(log, config, output, columns, rate, gyro_unit, keep, force=force), order)


def gyro_command(
    log: LogArgument = None,
    *,
    output: OutputOption = Path("inertial.yaml"),
    config: ConfigOption = SETTINGS,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gyro_unit: GyroUnitOption = None,
    keep: KeepOption = None,
    force: ForceOption = False,
) -> None:
    """Take the mean at rest, judge and write.

    Raises:
        ConfigError: no samples, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    check_output(output)
    _check(log, config, gyro_unit)
    from calibration.mount.imu.job import ImuJob, calibrate_gyro_bias  # noqa: PLC0415 - once the files are there

    calibrate_gyro_bias(ImuJob(log, config, output, columns, rate, gyro_unit, keep, force=force))


def _check(log: Path | None, config: Path, gyro_unit: str | None) -> None:
    """Whether all that is named is there: what calibrates takes long to import."""
    if gyro_unit not in {None, "rad/s", "deg/s"}:
        raise ConfigError(f"--gyro-unit {gyro_unit}: expected rad/s or deg/s")
    must_be_readable(config)
    if log is not None:
        must_exist(log, "expected a flight.mcap, or a table of t, ax, ay, az, gx, gy, gz")
