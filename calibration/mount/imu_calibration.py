"""What `calibrate-mount accelerometer` and `gyro` do: static intervals in, the IMU calibration file out."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import typer

from calibration.command_line import RefusedError, listed, today
from calibration.mount import FACES
from calibration.mount.record_motion import SensorOpener, connected_sensors, new_log, read_imu, until_done
from calibration.mount.recording import inertial_of
from calibration.mount.result import judge, provenance, write_file
from calibration.mount.six_faces import (
    AccelerometerFit,
    FaceGuide,
    GyroFit,
    ImuBuffer,
    StaticInterval,
    accelerometer_reasons,
    faces_down,
    find_static_intervals,
    fit_accelerometer,
    fit_gyro,
    fitting_mountings,
    gyro_reasons,
)
from calibration.mount.table import read_table
from companion.base.clock import Clock
from companion.base.geometry import Vector3, vector3
from companion.base.messages import ImuSample
from companion.base.signals import run_until_stopped
from companion.config import (
    AccelerometerCalibration,
    CompanionConfig,
    ConfigError,
    GyroCalibration,
    ImuConfig,
    InertialCalibration,
    VehicleConfig,
    find_file,
    load_config,
    load_model,
)
from companion.flightlog.log_file import find_log
from companion.flightlog.replay.mcap_log import read_mcap
from companion.pad import load_pad
from companion.sense.imu.mounting import mounting_matrix
from companion.sense.imu.mpu9250 import Mpu9250

ACCELEROMETER_OF: Final = "accelerometer of "
LONGEST_FACES_S: Final = 600.0
GYRO_STILL_S: Final = 10.0
LONGEST_STILL_S: Final = 120.0


@dataclass(frozen=True, slots=True)
class ImuJob:
    """What is asked for: a recording or, without one, live samples, which `keep` saves."""

    log: Path | None
    config: Path
    output: Path
    columns: str | None
    rate_hz: float | None
    gyro_unit: str | None
    keep: Path | None
    force: bool


@dataclass(frozen=True, slots=True)
class StaticRecording:
    """Static intervals in sensor axes, their source, and for a live run the faces that were asked for."""

    rests: list[StaticInterval]
    source: str
    imu: ImuConfig
    asked: tuple[str, ...] = ()
    answers: tuple[StaticInterval, ...] = ()


def calibrate_on_faces(job: ImuJob, order: str | None) -> None:
    """Collect static intervals, fit, judge and write; `order` is that of the faces in a recording."""
    rested = _collected(job, faces_from)
    if job.log is not None and order is not None:
        rested = _ordered(rested, order)
    calibrate_accelerometer(rested, job.output, force=job.force)


def calibrate_accelerometer(rested: StaticRecording, output: Path, *, force: bool) -> None:
    """Fit, judge and write."""
    if not rested.rests:
        raise RefusedError(
            f"{rested.source}: it never lay still; expected rests of 2 s and more on six faces"
        )
    fit, gyro = fit_accelerometer(rested.rests), fit_gyro(rested.rests)
    faces = faces_down(rested.rests, mounting_matrix(rested.imu.body_from_sensor_deg))
    against = accelerometer_reasons(fit, rested.rests, faces)
    wrong = mounting_line(rested.asked, rested.answers, rested.imu.body_from_sensor_deg)
    if rested.asked and wrong is not None:
        against = (wrong, *against)
    if rested.asked and not fitting_mountings(rested.asked, rested.answers):
        typer.echo(
            "note: the faces came in another order than asked: the mounting of the chip was not checked"
        )
    for line in (*accelerometer_lines(fit, faces), *gyro_lines(gyro)):
        typer.echo(line)
    judge(against, force=force)
    calibration = InertialCalibration(
        accelerometer=accelerometer_calibration(fit, faces),
        gyro=gyro_calibration(gyro),
        forced=against,
        provenance=provenance(rested.source, today(), sum(rest.samples for rest in rested.rests), 0),
    )
    write_file(output, calibration, "sense: {{imu: {{inertial_calibration: {}}}}}")


def calibrate_gyro_bias(job: ImuJob) -> None:
    """Take the mean at rest, judge and write; an accelerometer part that is there stays."""
    before = load_model(InertialCalibration, job.output) if job.output.exists() else None
    rested = _collected(job, stillness_from)
    if not rested.rests:
        raise RefusedError(f"{rested.source}: it never lay still; expected a rest of 2 s and more")
    fit = fit_gyro(rested.rests)
    against = gyro_reasons(fit, rested.rests)
    for line in gyro_lines(fit):
        typer.echo(line)
    judge(against, force=job.force)
    # what the accelerometer's part was forced through stays said, and where that part is from
    kept = None if before is None or before.accelerometer is None else before
    source = rested.source if kept is None else f"{rested.source}; {_accelerometer_of(kept)}"
    calibration = InertialCalibration(
        accelerometer=None if kept is None else kept.accelerometer,
        gyro=gyro_calibration(fit),
        forced=tuple(dict.fromkeys((*(() if kept is None else kept.forced), *against))),
        provenance=provenance(source, today(), sum(rest.samples for rest in rested.rests), 0),
    )
    write_file(job.output, calibration, "sense: {{imu: {{inertial_calibration: {}}}}}")


def _accelerometer_of(before: InertialCalibration) -> str:
    """The source of a file's accelerometer part, named once however often the bias was renewed."""
    _, mark, origin = before.provenance.source.partition(ACCELEROMETER_OF)
    return ACCELEROMETER_OF + (origin if mark else f"{before.provenance.source}, {before.provenance.date}")


def _collected(job: ImuJob, live: Callable[..., Coroutine[Any, Any, StaticRecording]]) -> StaticRecording:
    """The static intervals of the job's file, or live."""
    settings = load_config(job.config)
    if job.log is None:
        return run_until_stopped(live(settings, job.keep, connected_sensors, virtual=False))
    imu, log = settings.sense.imu, job.log
    if not log.is_dir() and log.suffix != ".mcap":
        samples = read_table(log, job.columns, job.rate_hz, job.gyro_unit)
        return StaticRecording(find_static_intervals(samples), str(log), imu)
    file = find_log(log)
    record = read_mcap(file)
    if record.rig is not None and record.rig.config.sense.source != "boards":
        raise ConfigError(
            f"{file}: its inertial samples are the autopilot's; expected a recording of the board's "
            "(sense.source: boards)"
        )
    imu = imu if record.rig is None else record.rig.config.sense.imu
    if imu.inertial_calibration is not None:
        raise ConfigError(
            f"{file}: its samples were calibrated by {imu.inertial_calibration}; expected a recording "
            "without sense.imu.inertial_calibration"
        )
    samples = inertial_of(record, file).turned(mounting_matrix(imu.body_from_sensor_deg))
    return StaticRecording(find_static_intervals(samples), str(log), imu)


def _ordered(rested: StaticRecording, order: str) -> StaticRecording:
    """With the faces in the order that the user gives."""
    names = tuple(name.strip() for name in order.split(","))
    if unknown := [name for name in names if name not in FACES]:
        raise ConfigError(f"--order: no face '{unknown[0]}'; expected some of {', '.join(FACES)}")
    if len(names) != len(rested.rests):
        raise ConfigError(
            f"--order: {len(names)} faces, but it lay still {len(rested.rests)} times; expected one for each"
        )
    return StaticRecording(rested.rests, rested.source, rested.imu, names, tuple(rested.rests))


# ---------------------------------------------------------------- live
# Static intervals taken live while a person turns the IMU. A thin shell around `FaceGuide`.

LOOK_S: Final = 0.5
REMIND_S: Final = 10.0


async def faces_from(
    config: CompanionConfig, keep: Path | None, sensors_of: SensorOpener, *, virtual: bool
) -> StaticRecording:
    """Static intervals on six faces, live: ask for the faces in turn.

    Raises:
        ConfigError: the sensor does not answer, or not all faces came in time.
    """
    imu = config.sense.imu
    turn = mounting_matrix(imu.body_from_sensor_deg)
    samples, guide, clock = ImuBuffer(turn), FaceGuide(turn), Clock()

    async def watch() -> None:
        start_s = clock.now_s()
        advised_s, advised = -REMIND_S, ""
        while not guide.done:
            if clock.now_s() - start_s > LONGEST_FACES_S:
                raise ConfigError(f"no end after {LONGEST_FACES_S:g} s; expected: {guide.advice}")
            if guide.advice != advised or clock.now_s() - advised_s >= REMIND_S:
                advised_s, advised = clock.now_s(), guide.advice
                typer.echo(advised)
            await asyncio.sleep(LOOK_S)
            if (line := guide.take(samples.since(guide.after_s))) is not None:
                typer.echo(line)

    await _collect(config, keep, sensors_of, samples, watch, virtual=virtual)
    return StaticRecording(
        find_static_intervals(samples.since(-math.inf)), imu.bus, imu, tuple(guide.asked), tuple(guide.rests)
    )


async def stillness_from(
    config: CompanionConfig, keep: Path | None, sensors_of: SensorOpener, *, virtual: bool
) -> StaticRecording:
    """One static interval of GYRO_STILL_S, live.

    Raises:
        ConfigError: the sensor does not answer, or is not left alone.
    """
    imu = config.sense.imu
    samples, clock = ImuBuffer(mounting_matrix(imu.body_from_sensor_deg)), Clock()

    async def watch() -> None:
        start_s = clock.now_s()
        typer.echo(f"leave it alone for {GYRO_STILL_S:g} s")
        while not any(
            rest.to_s - rest.from_s >= GYRO_STILL_S for rest in find_static_intervals(samples.since(start_s))
        ):
            if clock.now_s() - start_s > LONGEST_STILL_S:
                raise ConfigError(
                    f"not still for {GYRO_STILL_S:g} s within {LONGEST_STILL_S:g} s; expected it left alone"
                )
            await asyncio.sleep(LOOK_S)

    await _collect(config, keep, sensors_of, samples, watch, virtual=virtual)
    return StaticRecording(find_static_intervals(samples.since(-math.inf)), imu.bus, imu)


async def _collect(
    config: CompanionConfig,
    keep: Path | None,
    sensors_of: SensorOpener,
    samples: ImuBuffer,
    watch: Callable[[], Awaitable[None]],
    *,
    virtual: bool,
) -> None:
    """Run `watch` to its end while samples come; they are logged in the folder `keep`, if one was given."""
    clock = Clock()
    async with sensors_of(config, False) as sensors:
        with new_log(keep, virtual=virtual) as log:
            imu = config.sense.imu.model_copy(update={"inertial_calibration": None})
            sense = config.sense.model_copy(update={"imu": imu})
            log.write_settings(
                config=config.model_copy(update={"sense": sense}),
                vehicle=load_model(VehicleConfig, find_file("vehicles", config.vehicle)),
                pad=load_pad(config.pad),
            )

            def take(sample: ImuSample) -> None:
                log.write("imu", sample, clock.now_s())
                samples.add(sample)

            # uncalibrated: an earlier calibration must not enter this one
            driver = Mpu9250(sensors.imu_bus, config.sense.imu)
            await until_done(watch, read_imu(driver, config.sense.imu, take, typer.echo))


# ---------------------------------------------------------------- result


def accelerometer_calibration(fit: AccelerometerFit, faces: Sequence[str]) -> AccelerometerCalibration:
    rows = np.round(fit.matrix, 6)
    return AccelerometerCalibration(
        offset_m_s2=vector3(np.round(fit.offset, 5)),
        matrix=(vector3(rows[0]), vector3(rows[1]), vector3(rows[2])),
        residual_m_s2=round(float(np.sqrt(np.mean(fit.residuals**2))), 5),
        faces=len(faces),
    )


def gyro_calibration(fit: GyroFit) -> GyroCalibration:
    """The file's gyroscope part; if the temperature is unknown, room temperature."""
    return GyroCalibration(
        bias_rad_s=vector3(np.round(fit.bias, 7)),
        std_rad_s=round(fit.std, 7),
        temperature_c=round(fit.temperature_c, 1) if math.isfinite(fit.temperature_c) else 20.0,
    )


def accelerometer_lines(fit: AccelerometerFit, faces: Sequence[str]) -> list[str]:
    before, after = (float(np.sqrt(np.mean(m**2))) for m in (fit.raw_residuals, fit.residuals))
    skew = np.abs(fit.matrix - np.diag(np.diag(fit.matrix))).max()
    return [
        f"rests         {len(fit.residuals)}, faces down: {', '.join(faces)}",
        f"offset        {listed(fit.offset, '+.3f')} m/s² "
        f"(standard deviations {listed(fit.offset_std, '.3f')})",
        f"scale         {listed(np.diag(fit.matrix), '.4f')} (standard deviations "
        f"{listed(fit.scale_std, '.4f')}), skew up to {skew:.4f}",
        f"|a| - g       {before:.3f} m/s² rms as measured, {after:.4f} calibrated",
    ]


def gyro_lines(fit: GyroFit) -> list[str]:
    bias, std = np.degrees(fit.bias), math.degrees(fit.std)
    warmth = f" at {fit.temperature_c:.0f} °C" if math.isfinite(fit.temperature_c) else ""
    return [
        f"gyroscope     {listed(bias, '+.3f')} deg/s at rest{warmth}, changing by {std:.3f} between rests"
    ]


def mounting_line(
    asked: Sequence[str], rests: Sequence[StaticInterval], configured_deg: Vector3
) -> str | None:
    """What is wrong with `body_from_sensor_deg`, by the faces asked for and measured; None: nothing found.

    If no mounting fits, the faces came in another order than asked; that says nothing about the mounting.
    """
    fitting = fitting_mountings(asked, rests)
    now = mounting_matrix(configured_deg)
    if any(np.abs(mounting_matrix(m) - now).max() < 0.5 for m in fitting):
        return None
    is_said = f"sense.imu.body_from_sensor_deg is [{listed(configured_deg, 'g', ', ')}]"
    if len(fitting) == 1:
        return f"{is_said}; what was asked and felt fits [{listed(fitting[0], 'g', ', ')}]"
    if fitting:
        return f"{is_said}, which does not fit what was asked and felt"
    return None
