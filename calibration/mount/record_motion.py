"""What `calibrate-mount record` does: boards in, a recording out."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from calibration.command_line import RefusedError
from calibration.mount import NAME
from calibration.mount.recording import INERTIAL, MARK, GravityFreePadDetector, RecordingMark
from companion.base.clock import Clock, start_unix_s
from companion.base.formats.mjpeg import MjpegServer, serving
from companion.base.geometry import norm
from companion.base.messages import Frame, FrameReport, ImuSample, PadSighting
from companion.base.signals import run_until_stopped
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    ImuConfig,
    VehicleConfig,
    find_file,
    load_config,
    load_inertial,
    load_model,
)
from companion.flightlog.log_file import LOG_NAMES
from companion.flightlog.record import FlightLog
from companion.pad import load_pad
from companion.sense.camera.source import FrameSource, open_camera
from companion.sense.imu.fifo import SamplesLostError
from companion.sense.imu.i2c import RegisterBus, SensorError, open_bus
from companion.sense.imu.mpu9250 import Mpu9250


def record_motion(config: Path, folder: Path, seconds: float, serve: int | None) -> None:
    """Record from the vehicle's boards until the motion is enough."""
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
    async with sensors_of(config, True) as sensors, serving(serve, typer.echo) as page:
        with new_log(folder, virtual=virtual) as log:
            progress = await MountRecorder(config, sensors, log, typer.echo, page).run(longest_s)
        if log.problem is not None:  # the last of it is written at the end
            log.discard()
            raise ConfigError(f"{folder}: {log.problem}; expected room for the recording")
    return progress


@contextmanager
def new_log(folder: Path | None, *, virtual: bool) -> Iterator[FlightLog]:
    """A log in a folder that has none yet, closed at the end; without a folder it keeps nothing.

    Raises:
        ConfigError: it holds one, or cannot be written.
    """
    if folder is not None and (folder / LOG_NAMES[0]).exists():
        raise ConfigError(f"{folder}: holds a recording already; expected a new or empty folder")
    log = FlightLog(folder, start_unix_s(virtual=virtual))
    try:
        yield log
    except BaseException:  # Ctrl-C as well: half a recording is none
        log.discard()
        raise
    log.close()


# ---------------------------------------------------------------- sensors


@dataclass(frozen=True, slots=True)
class MountSensors:
    """Open sensors; a simulator in the same process has the same interfaces."""

    imu_bus: RegisterBus
    frames: FrameSource | None = None


SensorOpener = Callable[[CompanionConfig, bool], AbstractAsyncContextManager[MountSensors]]


@asynccontextmanager
async def connected_sensors(config: CompanionConfig, camera: bool) -> AsyncIterator[MountSensors]:
    """Open what the settings name, and close it again at the end.

    Raises:
        ConfigError: the settings take the inertial samples from the autopilot; or a bus or the camera is
            missing, taken or misspelt; one line says which.
    """
    if config.sense.source != "boards":
        raise ConfigError(
            f"sense.source: '{config.sense.source}'; live it takes boards, expected those or the log of a "
            "flight over the pad"
        )
    vision = config.sense.vision
    with ExitStack() as opened:
        bus = opened.enter_context(closing(open_bus(config.sense.imu.bus)))
        frames: FrameSource | None = None
        if camera:
            lens = load_model(CameraConfig, find_file("cameras", config.camera))
            frames = opened.enter_context(
                closing(await open_camera(vision.source, lens, vision.unstamped_latency_s))
            )
        yield MountSensors(bus, frames)


# ---------------------------------------------------------------- live
# Every IMU sample and every sighting goes into the log before it is used.

PROGRESS_S: Final = 1.0
SILENCE_S: Final = 5.0

TakeImu = Callable[[ImuSample], None]


async def read_imu(driver: Mpu9250, config: ImuConfig, take: TakeImu, tell: Callable[[str], None]) -> None:
    """Poll the inertial sensor until cancelled; gaps are reported.

    Raises:
        ConfigError: it has not answered for SILENCE_S.
    """
    clock = Clock()
    heard_s = next_s = clock.now_s()
    while True:
        problem = "no sample"
        try:
            samples, _ = await clock.run(driver.poll, clock.now_s, modelled_s=0.0)
            for sample in samples:
                heard_s = clock.now_s()
                take(sample)
        except SamplesLostError as error:
            tell(str(error))
        except SensorError as error:
            problem = str(error)
        if clock.now_s() - heard_s > SILENCE_S:
            raise ConfigError(
                f"sense.imu.bus {config.bus}: {problem}; expected samples within {SILENCE_S:g} s"
            )
        next_s = max(next_s + 1.0 / config.poll_hz, clock.now_s())
        await clock.sleep_until(next_s)


async def until_done(done: Callable[[], Awaitable[None]], *works: Awaitable[None]) -> None:
    """Run tasks until `done` returns; the first failure ends all.

    Raises:
        ConfigError: what a task failed with.
        OSError: a device is gone.
    """
    tasks = [asyncio.ensure_future(work) for work in (done(), *works)]
    try:
        finished, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in finished:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class MountRecorder:
    """Records a vehicle that is moved over the pad, until its motion is enough."""

    def __init__(
        self,
        config: CompanionConfig,
        sensors: MountSensors,
        log: FlightLog,
        tell: Callable[[str], None],
        page: MjpegServer,
    ) -> None:
        """Make drivers and eye. The vehicle's file is used as it stands, without an earlier mount file.

        Raises:
            ConfigError: a settings file that the configuration names is missing or wrong.
        """
        self._config, self._sensors, self._log = config, sensors, log
        self._tell, self._page = tell, page
        vehicle = load_model(VehicleConfig, find_file("vehicles", config.vehicle))
        vehicle = vehicle.model_copy(update={"camera_time_offset_s": 0.0})
        camera = load_model(CameraConfig, find_file("cameras", config.camera))
        pad = load_pad(config.pad)
        mark = RecordingMark(gravity_free=True)
        inertial = load_inertial(config.sense)
        applied = {} if inertial is None else {INERTIAL: inertial}
        log.write_settings(config=config, vehicle=vehicle, camera=camera, pad=pad, **{MARK: mark}, **applied)
        self._driver = Mpu9250(sensors.imu_bus, config.sense.imu, inertial=inertial)
        self._detector = GravityFreePadDetector(pad, camera, vehicle, config.sense.vision)
        self._coverage = MotionCoverage()
        self._clock = Clock()

    async def run(self, longest_s: float) -> MotionProgress:
        """Record until there is enough, or for `longest_s`.

        Raises:
            ConfigError: a device does not answer, or its images are not of the calibrated size.
        """
        try:
            await until_done(
                lambda: self._watch(longest_s),
                read_imu(self._driver, self._config.sense.imu, self._take_imu, self._tell),
                self._read_camera(),
            )
        except OSError as error:
            source = self._config.sense.vision.shown_source
            raise ConfigError(f"sense.vision.source {source}: {error}") from error
        if self._log.problem is not None:
            raise ConfigError(self._log.problem)
        return self._coverage.progress()

    async def _watch(self, longest_s: float) -> None:
        """Tell how far it is, and return at the end."""
        start_s = self._clock.now_s()
        while self._clock.now_s() - start_s < longest_s:
            await asyncio.sleep(PROGRESS_S)
            progress = self._coverage.progress()
            self._tell(progress.line())
            if progress.complete:
                return

    def _take_imu(self, sample: ImuSample) -> None:
        self._log.write("imu", sample, self._clock.now_s())
        self._coverage.add_imu(sample)

    async def _read_camera(self) -> None:
        assert self._sensors.frames is not None
        while True:
            frame = await self._sensors.frames.next()
            self._log.write_frame(frame, self._clock.now_s())
            try:
                sighting = await self._clock.run(
                    self._detector.look, frame, modelled_s=self._config.compute.vision_s
                )
            except ValueError as error:
                raise ConfigError(f"{self._config.sense.vision.shown_source}: {error}") from error
            self._take_seen(frame, sighting)

    def _take_seen(self, frame: Frame, sighting: PadSighting | None) -> None:
        now_s = self._clock.now_s()
        if sighting is not None:
            self._log.write("sighting", sighting, now_s)
            self._coverage.add_sighting(sighting)
        report = FrameReport(
            time_s=frame.time_s,
            received_s=frame.received_s,
            done_s=now_s,
            sequence=frame.sequence,
            marker_count={} if sighting is None else sighting.marker_count,
            seen=sighting is not None,
            searched_whole_frame=False,
        )
        self._log.write("frame_report", report, now_s)
        if self._page.viewer_count:
            self._page.show(annotated(frame.image, self._coverage.progress()))


def annotated(image: NDArray[np.uint8], progress: MotionProgress) -> NDArray[np.uint8]:
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    lines = (progress.advice, f"pad seen {progress.sightings} times, {progress.seconds:.0f} s")
    scale = image.shape[1] / 1100.0
    for number, line in enumerate(lines):
        at = (10, math.ceil(36 * scale * (number + 1)))
        for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 1)):
            cv2.putText(canvas, line, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, width, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


# ---------------------------------------------------------------- coverage
# Pure: samples in, hints out. Only motion with the pad in view counts: the total rotation about each body
# axis (extrinsic rotation is observable with rotation about two axes at least), and the time of fast rotation
# (a time offset of one millisecond is a rotation of 0.06° at 60°/s).

IN_VIEW_S: Final = 0.25
SHORTEST_S: Final = 30.0
FEWEST_SIGHTINGS: Final = 300
ENOUGH_TURN_RAD: Final = math.radians(360.0)
QUICK_RAD_S: Final = math.radians(25.0)
ENOUGH_QUICK_S: Final = 8.0
UNSEEN_S: Final = 1.5
AXES: Final = (
    "roll it left and right",
    "dip its nose up and down",
    "turn it left and right about the vertical",
)


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of a recording: shares 0..1 of what is needed, what to do now, and whether it is complete."""

    seconds: float
    sightings: int
    turned: tuple[float, float, float]
    quick: float
    advice: str
    complete: bool

    def line(self) -> str:
        roll, pitch, yaw = (f"{100.0 * share:.0f}%" for share in self.turned)
        return (
            f"{self.seconds:3.0f} s, pad seen {self.sightings} times; roll {roll}, pitch {pitch}, yaw {yaw}, "
            f"quick {100.0 * self.quick:.0f}%: {self.advice}"
        )


class MotionCoverage:
    """Adds up what has been recorded."""

    def __init__(self) -> None:
        self._start_s: float | None = None
        self._now_s = self._seen_s = -math.inf
        self._sightings = 0
        self._turned = [0.0, 0.0, 0.0]
        self._quick_s = 0.0

    def add_imu(self, sample: ImuSample) -> None:
        """Take an inertial sample, in order of time."""
        dt_s = sample.time_s - self._now_s
        self._now_s = sample.time_s
        if self._start_s is None:
            self._start_s = sample.time_s
        if not 0.0 < dt_s < IN_VIEW_S or sample.time_s - self._seen_s > IN_VIEW_S:
            return
        for axis, rate in enumerate(sample.rate_body_rad_s):
            self._turned[axis] += abs(rate) * dt_s
        if norm(sample.rate_body_rad_s) > QUICK_RAD_S:
            self._quick_s += dt_s

    def add_sighting(self, sighting: PadSighting) -> None:
        self._sightings += 1
        self._seen_s = max(self._seen_s, sighting.time_s)

    def progress(self) -> MotionProgress:
        seconds = 0.0 if self._start_s is None else self._now_s - self._start_s
        roll, pitch, yaw = (min(1.0, turned / ENOUGH_TURN_RAD) for turned in self._turned)
        quick = min(1.0, self._quick_s / ENOUGH_QUICK_S)
        moved = min(roll, pitch, yaw, quick) >= 1.0
        complete = moved and seconds >= SHORTEST_S and self._sightings >= FEWEST_SIGHTINGS
        advice = self._advice((roll, pitch, yaw), quick, complete=complete)
        return MotionProgress(seconds, self._sightings, (roll, pitch, yaw), quick, advice, complete)

    def _advice(self, turned: tuple[float, float, float], quick: float, *, complete: bool) -> str:
        if complete:
            return "enough"
        if self._start_s is None:
            return "waiting for the inertial sensor"
        if self._now_s - self._seen_s > UNSEEN_S:
            return "the pad is not seen: hold the camera over it"
        least = min(turned)
        if least < 1.0:
            return AXES[turned.index(least)]
        if quick < 1.0:
            return "the same again, more quickly"
        return "go on moving a little: roll, dip, turn, and sideways"
