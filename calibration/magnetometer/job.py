"""What `calibrate-magnetometer` does: read or collect samples, calibrate, judge and write."""

import sys
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from calibration.command_line import RefusedError, today
from calibration.magnetometer import PROGRAM
from calibration.magnetometer.calibrate import (
    Calibrated,
    TrueField,
    UnfitError,
    calibrate,
    field_at,
    field_by,
    year_of,
)
from calibration.magnetometer.collect import collect
from calibration.magnetometer.ellipsoid import Asked
from calibration.magnetometer.live import AutopilotCompass, Mpu9250Compass
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.report import lines, result_table, write_picture, yaml_text
from calibration.magnetometer.sources import read_recording
from companion import __version__
from companion.base.files import must_be_writable, write_atomically
from companion.base.signals import run_until_stopped
from companion.config import CompanionConfig, ConfigError, load_config
from companion.config.magnetometer import Sensor
from companion.link.transport import open_transport
from companion.sense.imu.i2c import open_bus

PICTURE_KINDS: Final = (".png", ".pdf", ".svg")
_PLAIN_WIDTH: Final = 140
_SEED: Final = 0  # of the robust start's random subsets: the same samples give the same file


@dataclass(frozen=True, slots=True)
class MagnetometerCalibrationJob:
    """One run: a recording with what its table holds, or a live sensor; reference field, fit, results."""

    recording: Path | None
    columns: str | None
    unit: str | None
    sensor: Sensor
    bus: str | None
    connect: str | None
    time_limit_s: float
    serve_port: int | None
    config: Path | None
    position: str | None
    date: str | None
    align: bool
    objective: Asked
    output: Path
    picture: Path | None
    force: bool


def calibrate_magnetometer(job: MagnetometerCalibrationJob) -> None:
    """Read or collect, calibrate, judge and write."""
    # a file or a pipe has no width: no figure is broken across lines there
    console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else _PLAIN_WIDTH)
    settings = CompanionConfig() if job.config is None else load_config(job.config)
    year = year_of(job.date)
    field = field_by(job.position, year, settings, job.config)
    _check_outputs(job)
    taken = _samples(job, field, settings, console)
    if field is None and taken.place is not None:
        field = field_at(taken.place, year, f"{taken.source}'s own position")
    done = _calibrated(taken, field, job)
    console.print(result_table(done, field))
    refused = done.file.quality.verdict == "refused" and not job.force
    for line in lines(done, refused=refused):
        console.print(line, highlight=False, markup=False)
    _write(done, job, console)


def _check_outputs(job: MagnetometerCalibrationJob) -> None:
    """Check before anybody turns a vehicle for minutes."""
    must_be_writable("--output", job.output, ".yaml")
    if job.picture is not None:
        must_be_writable("--plot", job.picture)
        if job.picture.suffix.lower() not in PICTURE_KINDS:
            kinds = ", ".join(PICTURE_KINDS)
            raise ConfigError(f"--plot {job.picture}: expected a name that ends in {kinds}")


def _samples(
    job: MagnetometerCalibrationJob, field: TrueField | None, settings: CompanionConfig, console: Console
) -> MagnetometerRecording:
    if job.recording is None:
        return run_until_stopped(_live(job, settings, console))
    if job.bus is not None or job.connect is not None or job.serve_port is not None:
        raise ConfigError("RECORDING: expected it without --bus, --connect and --serve, which are live")
    return read_recording(
        job.recording,
        columns=job.columns,
        unit=job.unit,
        sensor=job.sensor,
        field_ut=None if field is None else field.strength_ut,
        rng=np.random.default_rng(_SEED),
    )


async def _live(
    job: MagnetometerCalibrationJob, settings: CompanionConfig, console: Console
) -> MagnetometerRecording:
    """Collect from the sensor that an option names, else from the one that the settings use."""
    picture = job.output.with_suffix(".coverage.png")
    bus, connect, configured = job.bus, job.connect, job.config is not None
    if bus is not None and connect is not None:
        raise ConfigError("--bus and --connect: expected one of them")
    if connect is None and bus is None and configured and settings.sense.source == "autopilot":
        connect = settings.link.connection
    if connect is not None:
        with (
            closing(await open_transport(connect)) as transport,
            closing(AutopilotCompass(transport, connect)) as autopilot,
        ):
            return await collect(autopilot, console, job.time_limit_s, picture, job.serve_port)
    if bus is None and not configured:
        raise ConfigError("nothing to calibrate: expected RECORDING, --bus, --connect or --config")
    imu = settings.sense.imu if bus is None else settings.sense.imu.model_copy(update={"bus": bus})
    with closing(open_bus(imu.bus)) as opened:
        return await collect(Mpu9250Compass(opened, imu), console, job.time_limit_s, picture, job.serve_port)


def _calibrated(
    taken: MagnetometerRecording, field: TrueField | None, job: MagnetometerCalibrationJob
) -> Calibrated:
    try:
        return calibrate(
            taken,
            np.random.default_rng(_SEED),
            field=field,
            aligned=job.align,
            objective=job.objective,
            tool=f"{PROGRAM} {__version__}",
            date=today(),
        )
    except UnfitError as error:
        in_vain = "; --force has nothing to write" if job.force else ""
        raise RefusedError(f"{taken.source}: {error}{in_vain}") from error


def _write(done: Calibrated, job: MagnetometerCalibrationJob, console: Console) -> None:
    file = done.file
    refused = file.quality.verdict == "refused"
    problem = _draw(done, job.picture, console)
    if refused and not job.force:
        raise RefusedError(f"{done.recording.source}: {'; '.join(file.quality.reasons)}")
    if refused:
        file = file.model_copy(update={"quality": file.quality.model_copy(update={"forced": True})})
    write_atomically(job.output, yaml_text(file))
    console.print(f"calibration in {job.output}", highlight=False, markup=False)
    if problem is not None:
        raise problem


def _draw(done: Calibrated, picture: Path | None, console: Console) -> ConfigError | None:
    """Write the picture, if one is wanted. A picture that cannot be written must not cost the calibration."""
    if picture is None:
        return None
    try:
        write_picture(picture, done)
    except ConfigError as error:
        return error
    console.print(f"picture in {picture}", highlight=False, markup=False)
    return None
