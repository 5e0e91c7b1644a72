"""The sensors' tasks: from each device through its driver into the estimator and the log.

    mpu9250 (registers) ───────┐
    neo6m, ultrasonic (bytes) ─┼─► estimator
    autopilot's (telemetry) ───┤
    camera (frames) ─► vision ─┘

Each task runs until it is cancelled or its device is gone (OSError). A board that the hardware has not got
has no task: the link hands over the autopilot's samples instead (`take_samples`).
"""

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Final, Protocol

import numpy as np

from companion.app.hardware import Hardware, SerialLine
from companion.app.pacing import VisionPace
from companion.base.clock import Clock
from companion.base.geometry import Vector3, vector3
from companion.base.messages import (
    AutopilotAttitude,
    AutopilotState,
    Frame,
    FrameReport,
    GpsFix,
    ImuSample,
    LandedState,
    MagSample,
    PadBeacon,
    PadObservation,
    PadPrior,
    PadSighting,
    RangeSample,
)
from companion.config import (
    CameraConfig,
    CompanionConfig,
    SenseConfig,
    StrictModel,
    find_file,
    load_inertial,
    load_model,
    load_mount,
)
from companion.config.magnetometer import MagnetometerCalibration, Sensor, load_magnetometer_calibration
from companion.flightlog.record import FlightLog
from companion.link.codec import Severity
from companion.link.telemetry.autopilot_sensors import Sample, TelemetrySensors
from companion.sense.camera.health import FrameJudge
from companion.sense.camera.keeper import KeptCamera
from companion.sense.camera.source import at_exposure
from companion.sense.gps.neo6m import Neo6m
from companion.sense.imu.i2c import SensorError
from companion.sense.imu.mpu9250 import Mpu9250
from companion.sense.range.range_finder import RangeFinder, make_range_finder
from companion.sense.range.spike_filter import SpikeFilter
from companion.sense.vision.pipeline import VisionResult

GPS_CONFIGURATION_PERIOD_S: Final = 0.2
FAULT_PERIOD_S: Final = 2.0
WATCH_PERIOD_S: Final = 1.0
# one frame in so long is searched for the pad: while nothing is flown, or it is neither seen nor expected
GROUND_LOOK_S: Final = 0.2
SEARCH_LOOK_S: Final = 0.06
BEACON_APART_S: Final = 0.9  # a second, less the link's jitter
GONE_S: Final = 2.0  # a port that is gone is tried once a second


def load_used_magnetometer(sense: SenseConfig) -> MagnetometerCalibration | None:
    """The calibration of whichever magnetometer the settings use; None when they name none for it.

    Raises:
        ConfigError: it is missing, or another sensor's.
    """
    sensor: Sensor
    if sense.source == "autopilot":
        path, sensor, key = sense.autopilot.magnetometer_calibration, "autopilot", "sense.autopilot"
    else:
        path, sensor, key = sense.imu.magnetometer_calibration, "mpu9250", "sense.imu"
    if path is None:
        return None
    return load_magnetometer_calibration(path, sensor, f"{key}.magnetometer_calibration")


# publishes a notice: its kind, text and severity
Notify = Callable[[str, str, Severity], None]


class FrameProcessor(Protocol):
    """What processes frames: `companion.sense.vision.pipeline.Vision`, or a wrapper of it."""

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult: ...


class Estimates(Protocol):
    """Where samples go: the estimator, or a tool that takes them as they are."""

    def add_imu(self, sample: ImuSample, received_s: float = ...) -> object: ...
    def add_mag(self, sample: MagSample) -> object: ...
    def add_gps(self, fix: GpsFix) -> object: ...
    def add_range(self, sample: RangeSample) -> object: ...
    def add_sighting(self, sighting: PadSighting) -> object: ...
    def observe(self, observation: PadObservation) -> object: ...
    def add_autopilot_attitude(self, sample: AutopilotAttitude) -> object: ...
    def add_autopilot_velocity(self, time_s: float, velocity_ned_m_s: Vector3) -> object: ...
    def pad_prior(self, time_s: float) -> PadPrior | None: ...


class Sensing:
    """All sensors of one vehicle."""

    def __init__(
        self,
        config: CompanionConfig,
        hardware: Hardware,
        vision: FrameProcessor,
        estimator: Estimates,
        onboard: TelemetrySensors | None = None,
        *,
        clock: Clock,
        log: FlightLog,
        notify: Notify,
        frame_time_offset_s: float = 0.0,
    ) -> None:
        """Make the drivers; nothing is read yet.

        `onboard` are the autopilot's sensors, if they are used; `frame_time_offset_s` is added to the frames'
        stamps.
        """
        self._config, self._hardware = config, hardware
        self._onboard = onboard
        self._magnetometer = load_used_magnetometer(config.sense)
        self._inertial = load_inertial(config.sense)
        self._gps = Neo6m(config.sense.gps)
        self._range: RangeFinder | None = None
        if hardware.range_port is not None:
            self._range = make_range_finder(config.sense.range, hardware.range_port, clock)
        self._vision = vision
        self._estimator = estimator
        self._clock, self._log, self._notify = clock, log, notify
        self._frame_time_offset_s = frame_time_offset_s
        self.pace = VisionPace(notify)
        self._spikes = SpikeFilter(config.sense.range)
        self.last_range: RangeSample | None = None
        self.last_frame: FrameReport | None = None
        self.last_sighting: PadSighting | None = None
        self._beacon: PadBeacon | None = None
        self.frame_count = 0
        self.frame_fused: Callable[[], None] = lambda: None  # called after each that was looked at
        self.on_ground: Callable[[], bool] = lambda: False  # whether the vehicle stands, and nothing is flown
        self._gone_s: dict[str, float] = {}  # ports, and when
        self._fault_reported_s = self._attitude_s = self._velocity_s = float("-inf")
        # a camera that is kept judges its frames itself
        kept = isinstance(hardware.frames, KeptCamera)
        self._frame_judge = None if kept else FrameJudge(oldest_s=math.inf)

    @property
    def calibrations(self) -> dict[str, StrictModel]:
        """What samples are put right by before anybody sees them, by name: for the log."""
        named = {"inertial": self._inertial, "magnetometer": self._magnetometer}
        return {name: model for name, model in named.items() if model is not None}

    def tasks(self) -> dict[str, Callable[[], Awaitable[None]]]:
        """What is to run, by the device's name."""
        hardware, tasks = self._hardware, dict[str, Callable[[], Awaitable[None]]]()
        if hardware.imu_bus is not None:
            driver = Mpu9250(hardware.imu_bus, self._config.sense.imu, self._magnetometer, self._inertial)
            tasks["mpu9250"] = partial(self._imu_task, driver)
        if hardware.gps_port is not None:
            tasks["gps"] = partial(self._gps_task, hardware.gps_port)
            tasks["gps configuration"] = partial(self._gps_configuration_task, hardware.gps_port)
        if self._range is not None:
            tasks["ultrasonic"] = partial(self._range_task, self._range)
        if isinstance(hardware.frames, KeptCamera):
            tasks["camera's reports"] = partial(self._camera_reports_task, hardware.frames)
        return {**tasks, "sensors' watch": self._watch_task, "camera": self._vision_task}

    # ------------------------------------------------------------ telemetry

    def take_samples(self, samples: Iterable[Sample]) -> None:
        """What the autopilot's own sensors have measured, as the link brings it."""
        for sample in samples:
            match sample:
                case ImuSample():
                    self._take_inertial([sample], [])
                case MagSample():
                    self._take_inertial([], [self._calibrated(sample)])
                case GpsFix():
                    self._take_fix(sample)
                case RangeSample():
                    self._take_range(sample)

    def take_beacon(self, beacon: PadBeacon | None) -> None:
        """The newest word of the pad's beacon, once a second: a receiver's errors last longer than that.

        A fix that is sent again says nothing new.
        """
        before = self._beacon
        if beacon is None or beacon == before or self._config.estimate.pad.beacon != "track":
            return
        if before is not None:
            again = beacon.fix_time_s != 0.0 and beacon.fix_time_s == before.fix_time_s
            if again or beacon.time_s - before.time_s < BEACON_APART_S:
                return
        self._beacon = beacon
        self._estimator.observe(beacon)
        self._log.write("beacon", beacon, self._clock.now_s())

    def _calibrated(self, sample: MagSample) -> MagSample:
        """The autopilot's field in its body axes, by the calibration that is on top of its own."""
        if self._magnetometer is None:
            return sample
        field = self._magnetometer.apply(np.array([sample.field_body_ut]))[0]
        return replace(sample, field_body_ut=vector3(field.tolist()))

    # ------------------------------------------------------------ inertial

    async def _imu_task(self, driver: Mpu9250) -> None:
        """Poll the MPU9250; the driver sets the chip up anew after a fault, which is reported once."""
        period_s = 1.0 / self._config.sense.imu.poll_hz
        next_s, fault = self._clock.now_s(), driver.problem
        while True:
            try:
                # a bus transaction blocks; it takes no virtual time
                samples = await self._clock.run(driver.poll, self._clock.now_s, modelled_s=0.0)
                self._take_inertial(*samples)
                if samples[0]:
                    fault = self._notify_change(driver.problem, fault)
            except SensorError as error:
                fault = self._notify_change(str(error), fault)
            next_s = max(next_s + period_s, self._clock.now_s())
            await self._clock.sleep_until(next_s)

    def _notify_change(self, problem: str | None, reported: str | None) -> str | None:
        """Notify a problem that is not the one reported last; returns what counts as reported."""
        if problem is not None and problem != reported:
            self._notify("sensor", problem, "warning")
        return problem

    def _take_inertial(self, imu_samples: list[ImuSample], mag_samples: list[MagSample]) -> None:
        now_s = self._clock.now_s()
        for imu in imu_samples:
            self._estimator.add_imu(imu, now_s)
            self._log.write("imu", imu, now_s)
        for mag in mag_samples:
            self._estimator.add_mag(mag)
            self._log.write("mag", mag, now_s)

    def take_motion(self, autopilot: AutopilotState) -> None:
        """The newest attitude and velocity that the autopilot has reported, each once."""
        velocity = autopilot.velocity_ned_m_s
        if velocity is not None and autopilot.velocity_time_s > self._velocity_s:
            self._velocity_s = autopilot.velocity_time_s
            self._estimator.add_autopilot_velocity(self._velocity_s, velocity)
        if autopilot.attitude is None or autopilot.attitude_time_s <= self._attitude_s:
            return
        self._attitude_s = autopilot.attitude_time_s
        same_imu = self._config.sense.source == "autopilot"
        sample = AutopilotAttitude(
            autopilot.attitude_time_s,
            autopilot.attitude,
            same_imu,
            autopilot.round_trip_s or 0.0,
            autopilot.landed is LandedState.IN_AIR,
        )
        self._estimator.add_autopilot_attitude(sample)
        self._log.write("autopilot_attitude", sample, self._clock.now_s())

    # ------------------------------------------------------------ serial lines

    async def _gps_task(self, port: SerialLine) -> None:
        while True:
            with self._gone_if_it_fails("gps"):
                data = await port.read()
            for fix in self._gps.feed(data, self._clock.now_s()):
                self._take_fix(fix)

    def _take_fix(self, fix: GpsFix) -> None:
        self._estimator.add_gps(fix)
        self._log.write("gps", fix, self._clock.now_s())

    async def _gps_configuration_task(self, port: SerialLine) -> None:
        """Find the receiver's rate; send what it has not acknowledged yet, and all again when it forgets."""
        # a port that is gone is reported by the task that reads it
        with contextlib.suppress(OSError):
            while True:
                question = self._gps.pending(self._clock.now_s())
                port.set_baud(self._gps.baud)
                port.write(question)
                await asyncio.sleep(GPS_CONFIGURATION_PERIOD_S)

    async def _range_task(self, finder: RangeFinder) -> None:
        while True:
            with self._gone_if_it_fails("ultrasonic"):
                samples = await finder.read()
            for sample in samples:
                self._take_range(sample)

    @contextlib.contextmanager
    def _gone_if_it_fails(self, name: str) -> Iterator[None]:
        """Note when a port was last found to be gone: that is told, and silence then says no more."""
        try:
            yield
        except OSError:
            self._gone_s[name] = self._clock.now_s()
            raise

    def _take_range(self, sample: RangeSample) -> None:
        """Take an echo, whichever way it came, unless it is a spike."""
        if self._spikes.step(sample) is None:
            return
        self.last_range = sample
        self._estimator.add_range(sample)
        self._log.write("range", sample, self._clock.now_s())

    # ------------------------------------------------------------ watch

    async def _watch_task(self) -> None:
        """Notify what is wrong with the sensors, each problem once while it lasts."""
        reported: list[str | None] = []
        while True:
            await asyncio.sleep(WATCH_PERIOD_S)
            problems = self._problems(self._clock.now_s())
            reported = reported or [None] * len(problems)
            reported = [self._notify_change(*pair) for pair in zip(problems, reported, strict=True)]

    def _problems(self, now_s: float) -> list[str | None]:
        """What is wrong with each of the sensors that are used and do not speak for themselves."""
        problems: list[str | None] = []
        gone = {name for name, time_s in self._gone_s.items() if now_s - time_s < GONE_S}
        if self._hardware.gps_port is not None:
            problems.append(None if "gps" in gone else self._gps.problem)
        if self._range is not None:
            self._range.watch(now_s)
            problems.append(None if "ultrasonic" in gone else self._range.problem)
        if self._onboard is not None:
            problems.append(self._onboard.watch(now_s))
        return problems

    # ------------------------------------------------------------ camera

    @property
    def camera_problem(self) -> str | None:
        """What is wrong with the camera just now, None when nothing is."""
        frames = self._hardware.frames
        return frames.problem if isinstance(frames, KeptCamera) else None

    async def _camera_reports_task(self, camera: KeptCamera) -> None:
        """Notify what becomes of the camera; the flight goes on without sightings meanwhile."""
        while True:
            report = await camera.report()
            kind = "device_lost" if report.severity == "error" else "sensor"
            self._notify(kind, report.text, report.severity)

    async def _vision_task(self) -> None:
        """Look at the newest frame; what it shows enters the estimator at its exposure time."""
        looked_s = float("-inf")
        while True:
            frame = at_exposure(await self._hardware.frames.next(), self._frame_time_offset_s)
            self._log.write_frame(frame, self._clock.now_s())
            fault = None if self._frame_judge is None else self._frame_judge.fault(frame)
            # a frame that comes late is of use: its sighting is fused at its own time
            if fault is not None and fault.kind == "content" and not fault.usable:
                self._notify_fault(f"frame {frame.sequence} not used: {fault.text}")
                continue
            self.frame_count += 1
            prior = self._estimator.pad_prior(frame.time_s)
            expected = prior is not None and prior.pad_position_body_m is not None
            known = expected or (self.last_frame is not None and self.last_frame.seen)
            rest_s = GROUND_LOOK_S if self.on_ground() else 0.0 if known else SEARCH_LOOK_S
            if 0.0 <= frame.time_s - looked_s < rest_s:
                continue
            looked_s = frame.time_s
            try:
                seen = await self._clock.run(
                    self._vision.step, frame, prior, modelled_s=self._config.compute.vision_s
                )
            except Exception as error:
                # one frame that cannot be understood must not blind the rest of the flight
                self._notify_fault(f"frame {frame.sequence} skipped: {type(error).__name__}: {error}")
                continue
            self._take_seen(frame, seen)
            await self.pace.rest(self._clock.now_s() - frame.received_s)

    def _take_seen(self, frame: Frame, seen: VisionResult) -> None:
        now_s = self._clock.now_s()
        if seen.sighting is not None:
            self._estimator.add_sighting(seen.sighting)
            self._log.write("sighting", seen.sighting, now_s)
            self.last_sighting = seen.sighting
        times_s, found = (frame.time_s, frame.received_s, now_s), seen.sighting is not None
        self.last_frame = FrameReport(
            *times_s, frame.sequence, seen.marker_count, found, seen.searched_whole_frame
        )
        self._log.write("frame_report", self.last_frame, now_s)
        self.frame_fused()

    def _notify_fault(self, text: str) -> None:
        """Notify a fault that may come with every frame, but not more often than is of use."""
        now_s = self._clock.now_s()
        if now_s - self._fault_reported_s >= FAULT_PERIOD_S:
            self._fault_reported_s = now_s
            self._notify("sensor", text, "warning")


# ---------------------------------------------------------------- calibrations that were written by force


def forced_calibrations(config: CompanionConfig) -> Iterator[str]:
    """A line for each calibration that was written by force, with the reasons."""
    camera = load_model(CameraConfig, find_file("cameras", config.camera)).calibration
    if camera is not None and camera.verdict:
        yield _line(config.camera, camera.verdict)
    mount = load_mount(config.mount, config.camera)
    if mount is not None and mount.forced:
        yield _line(str(config.mount), mount.forced)
    magnetometer = load_used_magnetometer(config.sense)
    if magnetometer is not None and magnetometer.quality.verdict == "refused":
        yield _line("the magnetometer", magnetometer.quality.reasons)
    inertial = load_inertial(config.sense)
    if inertial is not None and inertial.forced:
        yield _line(str(config.sense.imu.inertial_calibration), inertial.forced)


def _line(name: str, reasons: tuple[str, ...]) -> str:
    return f"calibration of {name} was written by force: {'; '.join(reasons)}"
