"""What `calibrate-magnetometer` does: read or collect samples, calibrate, judge and write."""

import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from calibration.command_line import RefusedError
from calibration.magnetometer.calibrate import (
    Calibrated,
    TrueField,
    UnfitError,
    calibrate,
    field_at,
    field_by,
    year_of,
)
from calibration.magnetometer.collect import CollectionLimits, collect
from calibration.magnetometer.ellipsoid import Objective
from calibration.magnetometer.live import open_autopilot, open_chip
from calibration.magnetometer.recording import MagnetometerRecording
from calibration.magnetometer.report import lines, result_table, write_picture, yaml_text
from calibration.magnetometer.sources import read_recording
from companion import __version__
from companion.base.clock import start_unix_s
from companion.base.files import must_be_writable, write_atomically
from companion.base.signals import run_until_stopped
from companion.config import CompanionConfig, ConfigError, load_config
from companion.config.calibration import Sensor

PROGRAM: Final = "calibrate-magnetometer"
PICTURE_KINDS: Final = (".png", ".pdf", ".svg")
_PLAIN_WIDTH: Final = 140
_SEED: Final = 0  # of the robust start's random subsets: the same samples give the same file


@dataclass(frozen=True, slots=True)
class SampleSource:
    """Where samples come from: a recording with what its table holds, or a live sensor."""

    recording: Path | None
    columns: str | None
    unit: str | None
    sensor: str
    bus: str | None
    connect: str | None
    time_limit_s: float
    serve_port: int | None


@dataclass(frozen=True, slots=True)
class MagnetometerCalibrationJob:
    """One run: samples, the reference field, how to fit, and where the results go."""

    source: SampleSource
    config: Path | None
    position: str | None
    date: str | None
    align: bool
    objective: str
    output: Path
    picture: Path | None
    force: bool


def calibrate_magnetometer(job: MagnetometerCalibrationJob) -> None:
    """Read or collect, calibrate, judge and write.

    Raises:
        ConfigError: the user can correct it.
        RefusedError: the calibration is not good enough.
    """
    # a file or a pipe has no width: no figure is broken across lines there
    console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else _PLAIN_WIDTH)
    settings = CompanionConfig() if job.config is None else load_config(job.config)
    sensor: Sensor = _choice("--sensor", job.source.sensor, ("mpu9250", "autopilot", "other"))  # type: ignore[assignment]
    objective = _choice("--fit", job.objective, ("auto", "likelihood", "residual"))
    year = year_of(job.date)
    field = field_by(job.position, year, settings, job.config)
    _check_outputs(job)
    taken = _samples(job, sensor, field, settings, console)
    if field is None and taken.place is not None:
        field = field_at(taken.place, year, f"{taken.source}'s own position")
    kind: Objective | None = None if objective == "auto" else objective  # type: ignore[assignment]
    done = _calibrated(taken, field, kind, job)
    console.print(result_table(done, field))
    refused = done.file.quality.verdict == "refused" and not job.force
    for line in lines(done, refused=refused):
        console.print(line, highlight=False, markup=False)
    _write(done, job, console)


def _check_outputs(job: MagnetometerCalibrationJob) -> None:
    """Check before anybody turns a vehicle for minutes."""
    must_be_writable("--output", job.output)
    if job.picture is not None:
        must_be_writable("--plot", job.picture)
        if job.picture.suffix.lower() not in PICTURE_KINDS:
            kinds = ", ".join(PICTURE_KINDS)
            raise ConfigError(f"--plot {job.picture}: expected a name that ends in {kinds}")


def _samples(
    job: MagnetometerCalibrationJob,
    sensor: Sensor,
    field: TrueField | None,
    settings: CompanionConfig,
    console: Console,
) -> MagnetometerRecording:
    source = job.source
    if source.recording is None:
        limits = CollectionLimits(
            source.time_limit_s, job.output.with_suffix(".coverage.png"), source.serve_port
        )
        return run_until_stopped(_live(source, job.config is not None, settings, limits, console))
    if source.bus is not None or source.connect is not None or source.serve_port is not None:
        raise ConfigError("RECORDING: expected it without --bus, --connect and --serve, which are live")
    strength = None if field is None else field.strength_ut
    return read_recording(
        source.recording,
        columns=source.columns,
        unit=source.unit,
        sensor=sensor,
        field_ut=strength,
        rng=_rng(),
    )


async def _live(
    source: SampleSource,
    configured: bool,
    settings: CompanionConfig,
    limits: CollectionLimits,
    console: Console,
) -> MagnetometerRecording:
    """Collect from the sensor that an option names, else from the one that the settings use."""
    bus, connect = source.bus, source.connect
    if bus is not None and connect is not None:
        raise ConfigError("--bus and --connect: expected one of them")
    if connect is None and bus is None and configured and settings.sense.source == "autopilot":
        connect = settings.link.connection
    if connect is not None:
        async with open_autopilot(connect) as autopilot:
            return await collect(autopilot, limits, console)
    if bus is None and not configured:
        raise ConfigError("nothing to calibrate: expected RECORDING, --bus, --connect or --config")
    imu = settings.sense.imu if bus is None else settings.sense.imu.model_copy(update={"bus": bus})
    async with open_chip(imu) as chip:
        return await collect(chip, limits, console)


def _calibrated(
    taken: MagnetometerRecording,
    field: TrueField | None,
    objective: Objective | None,
    job: MagnetometerCalibrationJob,
) -> Calibrated:
    now = datetime.fromtimestamp(start_unix_s(virtual=True), UTC)
    try:
        return calibrate(
            taken,
            _rng(),
            field=field,
            aligned=job.align,
            objective=objective,
            tool=f"{PROGRAM} {__version__}",
            date=now.strftime("%Y-%m-%dT%H:%M:%SZ"),
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


def _rng() -> np.random.Generator:
    return np.random.default_rng(_SEED)


def _choice(option: str, word: str, known: tuple[str, ...]) -> str:
    if word not in known:
        raise ConfigError(f"{option} {word}: expected {', '.join(known[:-1])} or {known[-1]}")
    return word
