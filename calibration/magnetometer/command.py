"""`calibrate-magnetometer`: options and help. Samples in, calibration file, figures and picture out."""

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from calibration.command_line import ForceOption, run
from calibration.magnetometer import PROGRAM
from companion.base.command_line import ServeOption, VersionOption, new_app
from companion.base.files import must_be_readable, must_exist

HELP: Final = """Calibrate a magnetometer (hard and soft iron): live, or from a recording of a rotation.

RECORDING is a text table (CSV), .npz, .tlog, ArduPilot .bin, PX4 .ulg, or a flight log of the app. Without
RECORDING, samples come live: from the MPU9250 (--bus, or --config for the bus in the settings) or from the
autopilot (--connect). Turn the vehicle slowly into all attitudes until the sphere is covered.

\b
calibrate-magnetometer --config companion.yaml --position 47.40,8.55
calibrate-magnetometer --bus i2c:1 -o magnetometer.yaml --serve 8080
calibrate-magnetometer --connect udpin:0.0.0.0:14550 --position 47.40,8.55
calibrate-magnetometer turns.csv --unit mG --position 47.40,8.55,430 \\
    --date 2026-05-01
calibrate-magnetometer 00000042.BIN

Exit codes: 0 calibrated, 1 refused as not good enough (the picture shows why; only --force writes it), or
none at all (samples in a plane: --force has nothing to write either), 2 user error, 130 interrupted.
"""

cli = new_app()


@cli.command(help=HELP)
def calibrate_command(
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="RECORDING", help="Recording to calibrate from.", show_default=False),
    ] = None,
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Calibration file to write.", metavar="FILE")
    ] = Path("magnetometer.yaml"),
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", help="Picture to write. Default: beside the calibration, as .png.", metavar="FILE"
        ),
    ] = None,
    no_plot: Annotated[bool, typer.Option("--no-plot", help="Do not write a picture.")] = False,
    bus: Annotated[
        str | None,
        typer.Option("--bus", help="Live from the MPU9250 on i2c:N, spi:B.C or socket:PATH.", metavar="BUS"),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            help="Live from the autopilot: serial:PATH:BAUD, udp:, udpin: or tcp:HOST:PORT.",
            metavar="LINK",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", help="The app's settings: sensor, bus, mounting, magnetic field.", metavar="FILE"
        ),
    ] = None,
    position: Annotated[
        str | None,
        typer.Option(
            "--position",
            help="Position, for the field strength and dip of the World Magnetic Model.",
            metavar="LAT,LON[,ALT]",
        ),
    ] = None,
    date: Annotated[
        str | None, typer.Option("--date", help="Date for the model. Default: today.", metavar="YYYY-MM-DD")
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns", help="Magnetometer columns of a table: headings or numbers.", metavar="X,Y,Z"
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            help="Unit of a table: uT, G, mG, nT, mT, T or counts. Default: detected.",
            metavar="UNIT",
        ),
    ] = None,
    sensor: Annotated[
        Literal["mpu9250", "autopilot", "other"], typer.Option("--sensor", help="Sensor of a table.")
    ] = "other",
    align: Annotated[
        bool, typer.Option("--align", help="Also correct the misalignment to the accelerometer.")
    ] = False,
    fit: Annotated[
        Literal["auto", "likelihood", "residual"], typer.Option("--fit", help="Objective to minimise.")
    ] = "auto",
    serve: ServeOption = None,
    time_limit_s: Annotated[
        float, typer.Option("--time-limit", help="Live: stop after this many seconds.", metavar="S", min=1.0)
    ] = 300.0,
    force: ForceOption = False,
    version: VersionOption = False,
) -> None:
    if recording is not None:
        must_exist(recording, "expected a recording")
    if config is not None:
        must_be_readable(config)
    # what computes is imported once the files are there
    from calibration.magnetometer.job import (  # noqa: PLC0415
        MagnetometerCalibrationJob,
        calibrate_magnetometer,
    )

    job = MagnetometerCalibrationJob(
        recording,
        columns,
        unit,
        sensor,
        bus,
        connect,
        time_limit_s,
        serve,
        config,
        position,
        date,
        align,
        fit,
        output,
        None if no_plot else plot or output.with_suffix(".png"),
        force=force,
    )
    calibrate_magnetometer(job)


def main() -> None:
    run(cli, PROGRAM)


if __name__ == "__main__":
    main()
