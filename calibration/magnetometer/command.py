"""`calibrate-magnetometer`: samples in, a calibration file, figures and pictures out."""

from __future__ import annotations

import asyncio
import os
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer
from rich.console import Console

from calibration.command_line import RefusedError, run
from calibration.magnetometer.collect.collecting import CollectionLimits, collect
from calibration.magnetometer.collect.live import open_autopilot, open_chip
from calibration.magnetometer.ellipsoid.fit import Objective
from calibration.magnetometer.read.recording import MagnetometerRecording
from calibration.magnetometer.read.sources import read_recording
from calibration.magnetometer.report.pictures import write_picture
from calibration.magnetometer.report.report import lines, result_table, yaml_text
from calibration.magnetometer.solve.calibrate import Calibrated, TrueField, UnfitError, calibrate
from calibration.magnetometer.solve.true_field import field_at, field_by, year_of
from companion.base.clock import start_unix_s
from companion.base.files import write_atomically
from companion.config import CompanionConfig, ConfigError, load_config
from companion.config.magnetometer import Sensor

PROGRAM: Final = "calibrate-magnetometer"
HELP: Final = """Calibrate a magnetometer: turn the vehicle about, or give a recording of that.

RECORDING is a table of text (CSV), .npz, .tlog, ArduPilot .bin, PX4 .ulg, or a flight of ours. Without one
the samples come live: from the MPU9250 (--bus, or --config for the bus of the settings) or from the autopilot
(--connect). Turn the vehicle slowly into all attitudes until it says that the sphere is covered.

\b
calibrate-magnetometer --config companion.yaml --position 47.40,8.55
calibrate-magnetometer --bus i2c:1 -o magnetometer.yaml --serve 8080
calibrate-magnetometer --connect udpin:0.0.0.0:14550 --position 47.40,8.55
calibrate-magnetometer turns.csv --unit mG --position 47.40,8.55,430 --date 2026-05-01
calibrate-magnetometer 00000042.BIN

Exit codes: 0 calibrated, 1 refused as not good enough (the picture shows why; a calibration is written with
--force alone), 2 something that you can mend, 130 interrupted.
"""
PICTURE_KINDS: Final = (".png", ".pdf", ".svg")
_PLAIN_WIDTH: Final = 140
_SEED: Final = 0  # of the robust start's random subsets: the same samples give the same file

cli = typer.Typer(
    add_completion=False, rich_markup_mode=None, context_settings={"help_option_names": ["--help"]}
)


@dataclass(frozen=True, slots=True)
class _Output:
    file: Path
    picture: Path | None
    force: bool


@cli.command(help=HELP)
def calibrate_command(
    recording: Annotated[
        Path | None, typer.Argument(metavar="[RECORDING]", help="A recording.", show_default=False)
    ] = None,
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Write the calibration here.", metavar="FILE")
    ] = Path("magnetometer.yaml"),
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="The picture; else beside the calibration, as .png.", metavar="FILE"),
    ] = None,
    no_plot: Annotated[bool, typer.Option("--no-plot", help="Without a picture.")] = False,
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
            "--config",
            help="The app's settings: which sensor, its bus, mounting, magnetic field.",
            metavar="FILE",
        ),
    ] = None,
    position: Annotated[
        str | None,
        typer.Option(
            "--position",
            help="Where: the field's strength and dip come from the World Magnetic Model.",
            metavar="LAT,LON[,ALT]",
        ),
    ] = None,
    date: Annotated[
        str | None, typer.Option("--date", help="When, for the model; else today.", metavar="YYYY-MM-DD")
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns", help="The magnetometer's in a table: headings or numbers.", metavar="X,Y,Z"
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit", help="Of a table: uT, G, mG, nT, T or counts; else found out.", metavar="UNIT"
        ),
    ] = None,
    sensor: Annotated[
        str, typer.Option("--sensor", help="Whose a table is: mpu9250, autopilot or other.", metavar="NAME")
    ] = "other",
    align: Annotated[
        bool, typer.Option("--align", help="Turn it into the accelerometer's axes as well.")
    ] = False,
    fit: Annotated[
        str,
        typer.Option("--fit", help="What is minimised: auto, likelihood or residual.", metavar="NAME"),
    ] = "auto",
    serve: Annotated[
        int | None,
        typer.Option("--serve", help="Show the coverage in a browser on this port.", metavar="PORT"),
    ] = None,
    time_limit_s: Annotated[
        float, typer.Option("--time-limit", help="Live: stop after so many seconds.", metavar="S", min=1.0)
    ] = 300.0,
    force: Annotated[
        bool, typer.Option("--force", help="Write a refused calibration all the same; the file says so.")
    ] = False,
) -> int:
    """Read or collect, calibrate, judge, write.

    Raises:
        ConfigError: something the user can mend.
        RefusedError: the calibration is not good enough.
    """
    # a file or a pipe has no width: no figure is broken across lines there
    console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else _PLAIN_WIDTH)
    settings = CompanionConfig() if config is None else load_config(config)
    wanted = _choice("--sensor", sensor, ("mpu9250", "autopilot", "other"))
    objective = _choice("--fit", fit, ("auto", "likelihood", "residual"))
    year = year_of(date)
    field = field_by(position, year, settings, config)
    picture = None if no_plot else plot or output.with_suffix(".png")
    _check_writable("--output", output)
    if picture is not None:
        _check_writable("--plot", picture)
        if picture.suffix.lower() not in PICTURE_KINDS:
            raise ConfigError(f"--plot {picture}: expected a name that ends in {', '.join(PICTURE_KINDS)}")
    taken: MagnetometerRecording
    if recording is not None:
        if bus is not None or connect is not None or serve is not None:
            raise ConfigError("RECORDING: expected it without --bus, --connect and --serve, which are live")
        strength = None if field is None else field.strength_ut
        as_sensor: Sensor = wanted  # type: ignore[assignment]
        taken = read_recording(
            recording, columns=columns, unit=unit, sensor=as_sensor, field_ut=strength, rng=_rng()
        )
    else:
        limits = CollectionLimits(time_limit_s, output.with_suffix(".coverage.png"), serve)
        taken = asyncio.run(_live(bus, connect, config is not None, settings, limits, console))
    if field is None and taken.place is not None:
        field = field_at(taken.place, year, f"{taken.source}'s own position")
    kind: Objective | None = None if objective == "auto" else objective  # type: ignore[assignment]
    done = _calibrated(taken, field, align, kind)
    console.print(result_table(done, field))
    for line in lines(done):
        console.print(line, highlight=False, markup=False)
    _write(done, _Output(output, picture, force), console)
    return 0


def _calibrated(
    taken: MagnetometerRecording, field: TrueField | None, aligned: bool, objective: Objective | None
) -> Calibrated:
    now = datetime.fromtimestamp(start_unix_s(virtual=True), UTC)
    try:
        return calibrate(
            taken,
            _rng(),
            field=field,
            aligned=aligned,
            objective=objective,
            tool=f"{PROGRAM} {_version()}",
            date=now.strftime("%Y-%m-%dT%H:%M:%SZ"),
        )
    except UnfitError as error:
        raise RefusedError(f"{taken.source}: {error}") from error


def _write(done: Calibrated, output: _Output, console: Console) -> None:
    file = done.file
    refused = file.quality.verdict == "refused"
    problem = _draw(done, output.picture, console)
    if refused and not output.force:
        raise RefusedError(f"{done.recording.source}: {file.quality.reasons[0]}")
    if refused:
        file = file.model_copy(update={"quality": file.quality.model_copy(update={"forced": True})})
    write_atomically(output.file, yaml_text(file))
    console.print(f"calibration in {output.file}", highlight=False, markup=False)
    if problem is not None:
        raise problem


def _draw(done: Calibrated, picture: Path | None, console: Console) -> ConfigError | None:
    """Write the picture, if one is wanted; what kept it from being written must not cost the calibration."""
    if picture is None:
        return None
    try:
        write_picture(picture, done)
    except ConfigError as error:
        return error
    console.print(f"picture in {picture}", highlight=False, markup=False)
    return None


async def _live(
    bus: str | None,
    connect: str | None,
    configured: bool,
    settings: CompanionConfig,
    limits: CollectionLimits,
    console: Console,
) -> MagnetometerRecording:
    """Collect from whichever device is named, by an option or as the one that the settings use."""
    if bus is not None and connect is not None:
        raise ConfigError("--bus and --connect: expected one of them")
    if connect is None and bus is None and configured and settings.sense.source == "autopilot":
        connect = settings.link.connection
    if connect is not None:
        async with open_autopilot(connect) as source:
            return await collect(source, limits, console)
    if bus is None and not configured:
        raise ConfigError("nothing to calibrate: expected RECORDING, --bus, --connect or --config")
    imu = settings.sense.imu if bus is None else settings.sense.imu.model_copy(update={"bus": bus})
    async with open_chip(imu) as source:
        return await collect(source, limits, console)


def _rng() -> np.random.Generator:
    return np.random.default_rng(_SEED)


def _choice(option: str, word: str, known: tuple[str, ...]) -> str:
    if word not in known:
        raise ConfigError(f"{option} {word}: expected {', '.join(known[:-1])} or {known[-1]}")
    return word


def _version() -> str:
    try:
        return version("companion")
    except PackageNotFoundError:
        return "(not installed)"


def _check_writable(option: str, path: Path) -> None:
    """Before anybody turns a vehicle about for minutes."""
    folder = path.resolve().parent
    if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise ConfigError(f"{option} {path}: cannot be written; expected a file in a folder of yours")


def main() -> None:
    """The console script's entry point."""
    run(cli, PROGRAM)


if __name__ == "__main__":
    main()
