"""Reads the sensors live: a thin shell of tasks around the drivers.

Every IMU sample and every sighting goes into the log before it is used.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.mount.record.coverage import MotionCoverage, MotionProgress
from calibration.mount.record.devices import MountSensors
from calibration.mount.record.pad_detector import GravityFreePadDetector
from calibration.mount.record.recording import INERTIAL, MARK, RecordingMark
from companion.base.clock import Clock
from companion.base.messages import Frame, FrameReport, ImuSample, PadSighting
from companion.config import (
    CameraConfig,
    CompanionConfig,
    ConfigError,
    ImuConfig,
    VehicleConfig,
    find_file,
    load_inertial,
    load_model,
)
from companion.flightlog.record import FlightLog
from companion.pad import load_pad
from companion.sense.imu.fifo import SamplesLostError
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250

PROGRESS_S: Final = 1.0
SILENCE_S: Final = 5.0

TakeImu = Callable[[ImuSample], None]
ShowImage = Callable[[NDArray[np.uint8]], None]


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
        show: ShowImage | None = None,
    ) -> None:
        """Make drivers and eye. The vehicle's file is used as it stands, without an earlier mount file.

        Raises:
            ConfigError: a settings file that the configuration names is missing or wrong.
        """
        self._config, self._sensors, self._log = config, sensors, log
        self._tell, self._show = tell, show
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
            raise ConfigError(f"sense.vision.source {self._config.sense.vision.source}: {error}") from error
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
                raise ConfigError(f"{self._config.sense.vision.source}: {error}") from error
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
        if self._show is not None:
            self._show(annotated(frame.image, self._coverage.progress()))


def annotated(image: NDArray[np.uint8], progress: MotionProgress) -> NDArray[np.uint8]:
    """The picture with what is missing written into it."""
    canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    lines = (progress.advice, f"pad seen {progress.sightings} times, {progress.seconds:.0f} s")
    scale = image.shape[1] / 1100.0
    for number, line in enumerate(lines):
        at = (10, math.ceil(36 * scale * (number + 1)))
        for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 1)):
            cv2.putText(canvas, line, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, width, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)
