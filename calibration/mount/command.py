"""`calibrate-mount`: how the camera and the inertial sensor sit, and when frames were exposed.

Thin: options in, files and lines out; what is reckoned is in the modules beside it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import cv2
import numpy as np
import typer
import yaml

from calibration.command_line import RefusedError, run
from calibration.mount.devices import Boards, open_boards
from calibration.mount.inertial_result import (
    accelerometer_calibration,
    accelerometer_lines,
    gyro_calibration,
    gyro_lines,
    mounting_line,
)
from calibration.mount.live import MountRecorder, ShowImage
from calibration.mount.plots import write_mount_plots
from calibration.mount.recording import inertial_of, read_log, read_recording
from calibration.mount.rest import Rest, find_rests
from calibration.mount.rests_live import six_faces_live, still_live
from calibration.mount.result import (
    configured_rotation,
    mount_calibration,
    mount_lines,
    provenance,
    shutter_s,
    trust_in,
)
from calibration.mount.samples import Inertial
from calibration.mount.six_faces import (
    FACES,
    accelerometer_reasons,
    faces_down,
    fit_accelerometer,
    fit_gyro,
    gyro_reasons,
    mounting_matrix,
)
from calibration.mount.solve import NoSolutionError, solve
from calibration.mount.table import read_table
from calibration.mount.verdict import reasons
from companion.clock import start_unix_s
from companion.config import (
    CONFIG_FOLDER,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    ImuConfig,
    InertialCalibration,
    StrictModel,
    VehicleConfig,
    find_file,
    load_config,
    load_model,
)
from companion.files import write_atomically
from companion.messages import ImuSample
from companion.mjpeg import MjpegServer
from companion.pad import load_pad
from companion.record import LOG_NAMES, FlightLog

NAME: Final = "calibrate-mount"
HELP: Final = """How camera and inertial sensor sit on the vehicle, found in the field.

First the inertial sensor (once, on a table), then the camera: record while you move the vehicle over
the pad, and solve. Every step works without a screen; a flight's own log of a hover will do, too.

\b
calibrate-mount accelerometer -o inertial.yaml
calibrate-mount record swayed
calibrate-mount camera swayed -o mount.yaml --plots pictures
calibrate-mount gyro -o inertial.yaml

The settings then say: mount: mount.yaml, and sense.imu.inertial_calibration: inertial.yaml.

Exit codes: 0 calibrated, 1 refused (the line says why), 2 something to mend, 130 interrupted.
"""
RECORD_HELP: Final = """Record inertial samples and the pad's sightings into DIR/flight.mcap.

Hold the vehicle over the pad, camera towards it, and move it as the lines say; it stops by itself.
No autopilot is needed.

\b
calibrate-mount record swayed
calibrate-mount record swayed --config mine.yaml --serve 8080
"""
CAMERA_HELP: Final = """The camera's rotation, place and time offset from a recording.

LOG is the folder or flight.mcap of 'calibrate-mount record', or of a flight that hovered over the pad.

\b
calibrate-mount camera swayed -o mount.yaml
calibrate-mount camera flights/hover -o mount.yaml --plots pictures
calibrate-mount camera swayed -o mount.yaml --camera my_camera.yaml
"""
ACCELEROMETER_HELP: Final = """Accelerometer offset, scale and skew from rests on six faces; gyroscope bias.

Live without LOG: it says which face to lay down, and notices by itself when the vehicle lies still. LOG
may be a flight.mcap, or a table (CSV or .npz) of t, ax, ay, az, gx, gy, gz in the chip's own axes.

\b
calibrate-mount accelerometer -o inertial.yaml
calibrate-mount accelerometer rests.csv -o inertial.yaml --gyro-unit deg/s
"""
GYRO_HELP: Final = """The gyroscope's bias alone, from a rest. The accelerometer's part of the file stays.

\b
calibrate-mount gyro -o inertial.yaml
calibrate-mount gyro still.csv -o inertial.yaml
"""
LONGEST_FACES_S: Final = 600.0
GYRO_STILL_S: Final = 10.0
LONGEST_STILL_S: Final = 120.0

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, help=HELP)

ConfigOption = Annotated[Path, typer.Option("--config", help="The app's settings.", metavar="FILE")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", help="The file to write.", metavar="FILE")]
ForceOption = Annotated[bool, typer.Option("--force", help="Write it even when refused; the file says so.")]
KeepOption = Annotated[
    Path | None, typer.Option("--keep", help="Live: leave the samples here too.", metavar="DIR")
]
GyroUnitOption = Annotated[
    str | None,
    typer.Option("--gyro-unit", help="Of a table: rad/s or deg/s; else as its header says, or rad/s."),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option("--columns", help="Of a table, in order: t,ax,ay,az,gx,gy,gz; - passes over one."),
]
RateOption = Annotated[
    float | None, typer.Option("--rate", min=1.0, help="Samples a second of a table without a time.")
]
LogArgument = Annotated[
    Path | None, typer.Argument(metavar="[LOG]", help="A recording; live without it.", show_default=False)
]
SETTINGS: Final = CONFIG_FOLDER / "companion.yaml"
OpenBoards = Callable[[CompanionConfig, bool], AbstractAsyncContextManager[Boards]]


def plugged(config: CompanionConfig, camera: bool) -> AbstractAsyncContextManager[Boards]:
    """The vehicle's own boards."""
    return open_boards(config, camera=camera)


# ---------------------------------------------------------------- record


@cli.command("record", help=RECORD_HELP, short_help="Record motion over the pad.")
def record_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new or empty folder.", show_default=False)],
    *,
    config: ConfigOption = SETTINGS,
    seconds: Annotated[
        float, typer.Option("--seconds", min=5.0, max=1800.0, help="Stop after this time at the latest.")
    ] = 180.0,
    serve: Annotated[
        int | None, typer.Option("--serve", min=0, max=65535, help="Show the picture at this local port.")
    ] = None,
) -> None:
    """Record until the motion is enough."""
    settings = load_config(config)
    cv2.setNumThreads(1)
    asyncio.run(record(settings, folder, seconds, serve, plugged, virtual=False))
    typer.echo(f"recorded in {folder}; next: {NAME} camera {folder} -o mount.yaml")


async def record(
    config: CompanionConfig,
    folder: Path,
    longest_s: float,
    serve: int | None,
    boards_of: OpenBoards,
    *,
    virtual: bool,
) -> None:
    """Record from boards into a folder.

    Raises:
        ConfigError: the folder holds a recording, or a device does not answer.
    """
    async with boards_of(config, True) as boards, _served(serve) as show:
        log = _new_log(folder, virtual=virtual)
        try:
            progress = await MountRecorder(config, boards, log, typer.echo, show).run(longest_s)
        except BaseException:  # Ctrl-C as well: half a recording is none
            log.discard()
            raise
        log.close()
    if not progress.complete:
        typer.echo(f"time is up, and it lacks: {progress.advice}")


def _new_log(folder: Path, *, virtual: bool) -> FlightLog:
    if (folder / LOG_NAMES[0]).exists():
        raise ConfigError(f"{folder}: holds a recording already; expected a new or empty folder")
    return FlightLog(folder, start_unix_s(virtual=virtual))


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


@cli.command("camera", help=CAMERA_HELP, short_help="Camera's rotation, place and time offset.")
def camera_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The recording.", show_default=False)],
    *,
    output: OutputOption = Path("mount.yaml"),
    camera: Annotated[
        str | None, typer.Option("--camera", help="Another calibration than the recording's.", metavar="FILE")
    ] = None,
    plots: Annotated[Path | None, typer.Option("--plots", help="Leave pictures here.", metavar="DIR")] = None,
    position_std: Annotated[
        float, typer.Option("--position-std", min=0.001, max=1.0, help="How well its place is measured, m.")
    ] = 0.02,
    max_rotation_deg: Annotated[
        float,
        typer.Option("--max-rotation-deg", min=0.1, max=180.0, help="From the settings', or it is refused."),
    ] = 10.0,
    force: ForceOption = False,
) -> None:
    """Solve, show, judge and write.

    Raises:
        ConfigError: the recording is none, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    lens = None if camera is None else load_model(CameraConfig, find_file("cameras", camera))
    recording = read_recording(log, lens)
    inertial_file = recording.config.sense.imu.inertial_calibration
    known = _inertial_file(Path(inertial_file)) if inertial_file is not None else None
    place = np.array(recording.vehicle.camera_position_body_m)
    trust = trust_in(recording, known, position_std)
    try:
        found = solve(recording.inertial, recording.sightings, place, shutter_s(recording), trust)
    except NoSolutionError as error:
        raise RefusedError(f"{log}: {error}") from error
    configured = configured_rotation(recording)
    against = reasons(found, configured, place, max_rotation_deg)
    calibration = mount_calibration(found, recording, against, _now())
    for line in mount_lines(calibration, found, recording):
        typer.echo(line)
    if plots is not None:
        pictures = write_mount_plots(plots, found, recording.inertial, configured)
        typer.echo(f"pictures      {', '.join(str(path) for path in pictures)}")
    _judge(against, force=force)
    _write(output, calibration, "mount: {}")


# ---------------------------------------------------------------- inertial


@dataclass(frozen=True, slots=True)
class Rested:
    """Rests in sensor axes, where from, and for a live run what was asked for."""

    rests: list[Rest]
    source: str
    imu: ImuConfig
    asked: tuple[str, ...] = ()
    answers: tuple[Rest, ...] = ()

    def unasked(self) -> Rested:
        """The same, whatever was asked for: the mounting is not judged."""
        return replace(self, asked=(), answers=())


@cli.command("accelerometer", help=ACCELEROMETER_HELP, short_help="Accelerometer on six faces, gyro bias.")
def accelerometer_command(
    log: LogArgument = None,
    *,
    output: OutputOption = Path("inertial.yaml"),
    config: ConfigOption = SETTINGS,
    order: Annotated[
        str | None, typer.Option("--order", help=f"Of LOG's rests, to check the mounting: {','.join(FACES)}.")
    ] = None,
    columns: ColumnsOption = None,
    rate: RateOption = None,
    gyro_unit: GyroUnitOption = None,
    keep: KeepOption = None,
    force: ForceOption = False,
) -> None:
    """Collect rests, fit, judge and write.

    Raises:
        ConfigError: no samples, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    settings = load_config(config)
    if log is None:
        rested = asyncio.run(faces_from(settings, keep, plugged, virtual=False))
    else:
        rested = _rested(log, settings.sense.imu, columns, rate, gyro_unit)
        if order is not None:
            rested = _ordered(rested, order)
    calibrate_accelerometer(rested, output, force=force)


def calibrate_accelerometer(rested: Rested, output: Path, *, force: bool) -> None:
    """Fit, judge and write.

    Raises:
        ConfigError: the file cannot be written.
        RefusedError: it is not good enough.
    """
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
    for line in (*accelerometer_lines(fit, faces), *gyro_lines(gyro)):
        typer.echo(line)
    _judge(against, force=force)
    calibration = InertialCalibration(
        accelerometer=accelerometer_calibration(fit, faces),
        gyro=gyro_calibration(gyro),
        forced=against,
        provenance=provenance(rested.source, _now(), sum(rest.samples for rest in rested.rests), 0),
    )
    _write(output, calibration, "sense: {{imu: {{inertial_calibration: {}}}}}")


@cli.command("gyro", help=GYRO_HELP, short_help="Gyroscope's bias alone.")
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
    settings = load_config(config)
    before = _inertial_file(output) if output.exists() else None
    if log is None:
        rested = asyncio.run(stillness_from(settings, keep, plugged, virtual=False))
    else:
        rested = _rested(log, settings.sense.imu, columns, rate, gyro_unit)
    if not rested.rests:
        raise RefusedError(f"{rested.source}: it never lay still; expected a rest of 2 s and more")
    fit = fit_gyro(rested.rests)
    against = gyro_reasons(fit, rested.rests)
    for line in gyro_lines(fit):
        typer.echo(line)
    _judge(against, force=force)
    calibration = InertialCalibration(
        accelerometer=None if before is None else before.accelerometer,
        gyro=gyro_calibration(fit),
        forced=against,
        provenance=provenance(rested.source, _now(), sum(rest.samples for rest in rested.rests), 0),
    )
    _write(output, calibration, "sense: {{imu: {{inertial_calibration: {}}}}}")


async def faces_from(
    config: CompanionConfig, keep: Path | None, boards_of: OpenBoards, *, virtual: bool
) -> Rested:
    """Rests on six faces, live."""
    imu = config.sense.imu
    async with boards_of(config, False) as boards:
        with _Kept(config, keep, virtual=virtual) as kept:
            samples, guide = await six_faces_live(imu, boards, typer.echo, LONGEST_FACES_S, kept.take)
    return Rested(find_rests(samples), imu.bus, imu, tuple(guide.asked), tuple(guide.rests))


async def stillness_from(
    config: CompanionConfig, keep: Path | None, boards_of: OpenBoards, *, virtual: bool
) -> Rested:
    """One rest, live."""
    imu = config.sense.imu
    async with boards_of(config, False) as boards:
        with _Kept(config, keep, virtual=virtual) as kept:
            samples = await still_live(imu, boards, typer.echo, GYRO_STILL_S, LONGEST_STILL_S, kept.take)
    return Rested(find_rests(samples), imu.bus, imu)


class _Kept:
    """A log of a live run's samples, in a folder if one was given."""

    def __init__(self, config: CompanionConfig, folder: Path | None, *, virtual: bool) -> None:
        self._log = None if folder is None else _new_log(folder, virtual=virtual)
        if self._log is not None:
            imu = config.sense.imu.model_copy(update={"inertial_calibration": None})
            sense = config.sense.model_copy(update={"imu": imu})
            self._log.write_settings(
                config=config.model_copy(update={"sense": sense}),
                vehicle=load_model(VehicleConfig, find_file("vehicles", config.vehicle)),
                pad=load_pad(config.pad),
            )

    def __enter__(self) -> _Kept:
        return self

    def __exit__(self, *_: object) -> None:
        if self._log is not None:
            self._log.close()

    def take(self, sample: ImuSample, now_s: float) -> None:
        """Log one."""
        if self._log is not None:
            self._log.write("imu", sample, now_s)


def _rested(
    log: Path, imu: ImuConfig, columns: str | None, rate_hz: float | None, gyro_unit: str | None
) -> Rested:
    """The rests of a file."""
    if gyro_unit not in {None, "rad/s", "deg/s"}:
        raise ConfigError(f"--gyro-unit {gyro_unit}: expected rad/s or deg/s")
    if not log.is_dir() and log.suffix != ".mcap":
        samples = read_table(log, columns, rate_hz, gyro_unit)
        return Rested(find_rests(samples), str(log), imu)
    file = log / LOG_NAMES[0] if log.is_dir() else log
    record = read_log(file)
    imu = imu if record.rig is None else record.rig.config.sense.imu
    if imu.inertial_calibration is not None:
        raise ConfigError(
            f"{file}: its samples were calibrated by {imu.inertial_calibration}; expected a recording "
            "without sense.imu.inertial_calibration"
        )
    body = inertial_of(record, file)
    turn = mounting_matrix(imu.body_from_sensor_deg)
    samples = Inertial(body.time_s, body.rate @ turn, body.force @ turn, body.temperature_c)
    return Rested(find_rests(samples), str(log), imu)


def _ordered(rested: Rested, order: str) -> Rested:
    """With what was asked, as the user says it was.

    Raises:
        ConfigError: a name is no face's, or there are not as many rests.
    """
    names = tuple(name.strip() for name in order.split(","))
    if unknown := [name for name in names if name not in FACES]:
        raise ConfigError(f"--order: no face '{unknown[0]}'; expected some of {', '.join(FACES)}")
    if len(names) != len(rested.rests):
        raise ConfigError(
            f"--order: {len(names)} faces, but it lay still {len(rested.rests)} times; expected one for each"
        )
    return Rested(rested.rests, rested.source, rested.imu, names, tuple(rested.rests))


# ---------------------------------------------------------------- what all have in common


def _inertial_file(path: Path) -> InertialCalibration:
    return load_model(InertialCalibration, path)


def _judge(against: tuple[str, ...], *, force: bool) -> None:
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


def _write(path: Path, calibration: StrictModel, setting: str) -> None:
    text = yaml.safe_dump(calibration.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=110)
    write_atomically(
        path, f"# Written by {NAME}; the app reads it by the setting {setting.format(path)}\n{text}"
    )
    typer.echo(f"written       {path}")


def _now() -> str:
    """Today, UTC."""
    return datetime.fromtimestamp(start_unix_s(virtual=True), UTC).isoformat(timespec="seconds")


def main() -> None:
    """Entry point."""
    run(cli, NAME)


if __name__ == "__main__":
    main()
