"""The wiring: one task a stage, latest-value slots between them. Nothing here decides how to fly.

    frames ─► vision ─┐
    mpu9250 ──────────┼─► estimator ─► planner ─► controller ─► link ─► autopilot
    neo6m, ultrasonic ┘                                          ▲ telemetry, beacon

The control task is the only one that sends setpoints: when it stops, they stop, and the autopilot's own
failsafe takes the vehicle.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol, TypeVar

from companion.clock import Clock
from companion.config import CameraConfig, CompanionConfig, LinkConfig, VehicleConfig, find_file, load_model
from companion.control.controller import Controller
from companion.estimate.estimator import Estimator
from companion.link.actions import PymavlinkActions, VehicleActions
from companion.link.codec import Severity
from companion.link.mavsdk_link import MavsdkActions
from companion.link.session import Session
from companion.link.transport import Transport, open_transport
from companion.messages import (
    Action,
    ActionResult,
    ControlReport,
    FrameReport,
    ImuSample,
    MagSample,
    Notice,
    PadState,
    Phase,
    PlanStep,
    RangeSample,
    Setpoint,
    VehicleState,
)
from companion.pad import load_pad
from companion.plan.fuzzy_velocity import load_table
from companion.plan.planner import PlanInputs, Planner
from companion.record import FlightLog
from companion.sense.camera import FrameSource, open_camera
from companion.sense.i2c import RegisterBus, SensorError, open_bus
from companion.sense.mpu9250 import Mpu9250
from companion.sense.neo6m import Neo6m
from companion.sense.serial_port import SerialPort
from companion.sense.ultrasonic import Ultrasonic
from companion.sense.vision import Vision
from companion.service import ServiceNotifier

T = TypeVar("T")

LINK_TICK_S: Final = 0.05
STATUS_PERIOD_S: Final = 0.25
# how long the app goes on recording after the flight has ended, so that the log holds the standstill
LINGER_S: Final = 1.0
GPS_CONFIGURATION_PERIOD_S: Final = 0.2
END_PHASES: Final = (Phase.LANDED, Phase.ABORT)


ActionsFactory = Callable[[Session, Callable[[bytes], None], Clock, LinkConfig], VehicleActions]


class BytePort(Protocol):
    """A serial line to a sensor."""

    async def read(self) -> bytes:
        """Wait for at least one byte. OSError when the line is gone."""
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting. OSError when the line is gone."""
        ...

    def close(self) -> None:
        """Give the line back."""
        ...


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the app is plugged into; the simulator gives the same interfaces as the vehicle."""

    transport: Transport
    imu_bus: RegisterBus
    gps_port: BytePort
    range_port: BytePort
    frames: FrameSource

    def close(self) -> None:
        """Give every port back."""
        for part in (self.transport, self.gps_port, self.range_port, self.frames):
            part.close()


async def open_hardware(config: CompanionConfig) -> Hardware:
    """Open what the settings name.

    Raises:
        ConfigError: a port, bus or camera is missing, taken or misspelt; one line says which.
    """
    camera = load_model(CameraConfig, find_file("cameras", config.camera))
    gps, range_ = config.sense.gps, config.sense.range
    async with AsyncExitStack() as opened:
        transport = await open_transport(config.link.connection)
        opened.callback(transport.close)
        imu_bus = open_bus(config.sense.imu.bus)
        gps_port = SerialPort(gps.port, gps.baud)
        opened.callback(gps_port.close)
        range_port = SerialPort(range_.port, range_.baud)
        opened.callback(range_port.close)
        frames = await open_camera(config.sense.vision.source, camera)
        opened.pop_all()
        return Hardware(transport, imu_bus, gps_port, range_port, frames)


def make_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: LinkConfig
) -> VehicleActions:
    """Actions by what `link.actions` names."""
    kind = MavsdkActions if config.actions == "mavsdk" else PymavlinkActions
    return kind(session, send, clock, config)


@dataclass(frozen=True, slots=True)
class Status:
    """What the terminal shows."""

    time_s: float
    phase: Phase
    mode: str
    vehicle: VehicleState | None
    pad: PadState | None
    last_frame: FrameReport | None
    frame_rate_hz: float
    latency_ms: float | None
    notices: tuple[Notice, ...]


class App:
    """One flight, from connecting to disarmed or handed back. Make it inside the running loop."""

    def __init__(
        self,
        config: CompanionConfig,
        hardware: Hardware,
        log: FlightLog,
        make_actions: ActionsFactory,
        on_status: Callable[[Status], None] | None = None,
    ) -> None:
        """Wire the stages.

        Raises:
            ConfigError: a settings file named in the configuration is missing or wrong.
        """
        self._config, self._hardware, self._log = config, hardware, log
        self._on_status = on_status
        self._clock = Clock()
        vehicle = load_model(VehicleConfig, find_file("vehicles", config.vehicle))
        camera = load_model(CameraConfig, find_file("cameras", config.camera))
        self._imu = Mpu9250(hardware.imu_bus, config.sense.imu)
        self._gps = Neo6m(config.sense.gps)
        self._range = Ultrasonic(config.sense.range)
        pad = load_pad(config.pad)
        self._vision = Vision(pad, camera, vehicle, config.sense.vision)
        antenna = config.sense.gps.antenna_position_body_m
        self._estimator = Estimator(config.estimate, vehicle, antenna, 0.5 * min(pad.width_m, pad.length_m))
        self._planner = Planner(
            config.plan,
            vehicle,
            horizon_steps=config.control.horizon_steps,
            step_s=config.control.step_s,
            fuzzy=load_table(config.plan.fuzzy)[0],
        )
        self._controller = Controller(config.control, vehicle)
        self.session = Session(config.link)
        self._actions = make_actions(self.session, self._send, self._clock, config.link)
        self._action_queue: asyncio.Queue[Action] = asyncio.Queue()
        self._action_results: list[ActionResult] = []
        self._service = ServiceNotifier()
        self._last_range: RangeSample | None = None
        self._last_frame: FrameReport | None = None
        self._phase = Phase.CONNECT
        self._new_notices: list[Notice] = []
        self._latency_ms: float | None = None
        self._frame_count = 0
        self._stop_requested = False
        self._acting = False
        self._start_s = self._clock.now_s()

    @property
    def phase(self) -> Phase:
        """Where the mission is."""
        return self._phase

    def request_stop(self) -> None:
        """Hold, hand the vehicle back to the autopilot and end (Ctrl-C, or the service's stop)."""
        self._stop_requested = True

    async def run(self) -> Phase:
        """Fly; returns the phase in which the flight ended (LANDED or ABORT).

        Raises:
            ExceptionGroup: a stage failed in a way it should not; setpoints have stopped by then.
        """
        await self._actions.start()
        try:
            async with asyncio.TaskGroup() as group:
                works = {
                    "mpu9250": self._imu_task,
                    "gps": self._gps_task,
                    "ultrasonic": self._range_task,
                    "camera": self._vision_task,
                    "autopilot link": self._receive_task,
                    "heartbeat": self._link_task,
                    "actions": self._action_task,
                    "status": self._status_task,
                }
                workers = [
                    group.create_task(self._guard(name, work), name=name) for name, work in works.items()
                ]
                phase = await group.create_task(self._control_task(), name="_control_task")
                for worker in workers:
                    worker.cancel()
        finally:
            self._service.stopping()
            await self._actions.close()
        return phase

    async def _guard(self, name: str, work: Callable[[], Awaitable[None]]) -> None:
        """Go on without a device that is gone: the planner knows what a flight without it may still do."""
        try:
            await work()
        except OSError as error:
            self._notice("device_lost", f"{name} lost: {error}", "error")

    def _notice(self, kind: str, text: str, severity: Severity) -> None:
        self._publish(Notice(self._clock.now_s(), kind, text, severity))

    # ------------------------------------------------------------ sense

    async def _imu_task(self) -> None:
        """Poll the MPU9250; the driver sets the chip up anew after a fault, which is told once."""
        period_s = 1.0 / self._config.sense.imu.poll_hz
        next_s, fault = self._clock.now_s(), ""
        while True:
            try:
                samples = await self._blocking(self._imu.poll, self._clock.now_s())
                self._take_inertial(*samples)
                fault = "" if samples[0] else fault
            except SensorError as error:
                if str(error) != fault:
                    fault = str(error)
                    self._notice("sensor", fault, "warning")
            next_s = max(next_s + period_s, self._clock.now_s())
            await self._clock.sleep_until(next_s)

    def _take_inertial(self, imu_samples: list[ImuSample], mag_samples: list[MagSample]) -> None:
        now_s = self._clock.now_s()
        for imu in imu_samples:
            self._estimator.add_imu(imu)
            self._log.write("imu", imu, now_s)
        for mag in mag_samples:
            self._estimator.add_mag(mag)
            self._log.write("mag", mag, now_s)

    async def _gps_task(self) -> None:
        """Configure the receiver, then turn its bytes into fixes."""
        port = self._hardware.gps_port
        async with asyncio.TaskGroup() as group:
            group.create_task(self._gps_configuration_task())
            while True:
                data = await port.read()
                for fix in self._gps.feed(data, self._clock.now_s()):
                    self._estimator.add_gps(fix)
                    self._log.write("gps", fix, self._clock.now_s())

    async def _gps_configuration_task(self) -> None:
        """Send the receiver what it has not acknowledged yet, and all of it again when it has forgotten."""
        while True:
            self._hardware.gps_port.write(self._gps.pending(self._clock.now_s()))
            await asyncio.sleep(GPS_CONFIGURATION_PERIOD_S)

    async def _range_task(self) -> None:
        """Turn the ultrasonic's bytes into distances."""
        while True:
            data = await self._hardware.range_port.read()
            for sample in self._range.feed(data, self._clock.now_s()):
                self._last_range = sample
                self._estimator.add_range(sample)
                self._log.write("range", sample, self._clock.now_s())

    async def _vision_task(self) -> None:
        """Look at the newest frame; what it shows enters the estimators at its exposure time."""
        while True:
            frame = await self._hardware.frames.next()
            self._log.write_frame(frame, self._clock.now_s())
            prior = self._estimator.pad_prior(frame.time_s)
            seen = await self._clock.run(
                self._vision.step, frame, prior, modelled_s=self._config.compute.vision_s
            )
            now_s = self._clock.now_s()
            if seen.sighting is not None:
                self._estimator.add_sighting(seen.sighting)
                self._log.write("sighting", seen.sighting, now_s)
            self._frame_count += 1
            self._last_frame = FrameReport(
                time_s=frame.time_s,
                received_s=frame.received_s,
                done_s=now_s,
                sequence=frame.sequence,
                marker_count=seen.marker_count,
                seen=seen.sighting is not None,
                searched_whole_frame=seen.searched_whole_frame,
            )
            self._log.write("frame_report", self._last_frame, now_s)

    async def _blocking(self, function: Callable[..., T], *arguments: Any) -> T:
        """Run what may wait for a bus; it takes no virtual time."""
        return await self._clock.run(function, *arguments, modelled_s=0.0)

    # ------------------------------------------------------------ plan and control

    async def _control_task(self) -> Phase:
        """Plan, control and send at a fixed rate until the mission has ended."""
        period_s = 1.0 / self._config.plan.rate_hz
        next_s = self._clock.now_s()
        ended_s: float | None = None
        while ended_s is None or self._clock.now_s() < ended_s + LINGER_S or self._acting:
            await self._control_step(self._clock.now_s())
            self._service.alive()
            if ended_s is None and self._phase in END_PHASES:
                ended_s = self._clock.now_s()
            # a cycle that came late is not made up for: the next one works with what is true then
            next_s = max(next_s + period_s, self._clock.now_s())
            await self._clock.sleep_until(next_s)
        return self._phase

    async def _control_step(self, now_s: float) -> None:
        """One cycle: newest estimates to a setpoint."""
        vehicle, pad = self._estimator.vehicle(now_s), self._estimator.pad(now_s)
        plan = self._plan(vehicle, pad, now_s)
        if vehicle is None:
            return
        self._log.write("vehicle", vehicle, now_s)
        if pad is not None:
            self._log.write("pad", pad, now_s)
        if plan.reference is None:
            return
        self.session.align(vehicle.attitude, vehicle.time_s)
        controlled = self._controller.step(plan, vehicle, pad, now_s)
        await self._clock.spend(self._config.compute.control_s)
        if controlled is not None:
            self._send_setpoint(*controlled)

    def _plan(self, vehicle: VehicleState | None, pad: PadState | None, now_s: float) -> PlanStep:
        results, self._action_results = tuple(self._action_results), []
        inputs = PlanInputs(
            vehicle=vehicle,
            pad=pad,
            autopilot=self.session.state,
            beacon=self.session.beacon,
            range=self._last_range,
            results=results,
            stop_requested=self._stop_requested,
        )
        plan = self._planner.step(inputs, now_s)
        self._phase = plan.phase
        self._log.write("plan", plan, now_s)
        for notice in plan.notices:
            self._publish(notice)
        for action in plan.actions:
            self._log.write("action", action, now_s)
            self._action_queue.put_nowait(action)
        return plan

    def _send_setpoint(self, setpoint: Setpoint, report: ControlReport) -> None:
        now_s = self._clock.now_s()
        sent = replace(setpoint, time_s=now_s)
        self._send(self.session.send_setpoint(sent, now_s))
        self._log.write("setpoint", sent, now_s)
        self._log.write("control_report", report, now_s)
        if sent.exposure_time_s is not None:
            self._latency_ms = 1e3 * (now_s - sent.exposure_time_s)

    # ------------------------------------------------------------ link

    async def _receive_task(self) -> None:
        """Take what the autopilot and the ground station say."""
        while True:
            data = await self._hardware.transport.read()
            now_s = self._clock.now_s()
            self._log.write_mavlink(data, now_s, "in")
            self.session.receive(data, now_s)
            self._actions.receive(data)
            self._send(self.session.tick(now_s))

    async def _link_task(self) -> None:
        """Heartbeats, time synchronisation and requests for telemetry."""
        while True:
            self._send(self.session.tick(self._clock.now_s()))
            await asyncio.sleep(LINK_TICK_S)

    async def _action_task(self) -> None:
        """Carry out the mission's requests one after another."""
        while True:
            action = await self._action_queue.get()
            self._acting = True
            result = await self._actions.perform(action)
            self._acting = not self._action_queue.empty()
            self._log.write("action_result", result, self._clock.now_s())
            self._action_results.append(result)

    def _send(self, data: bytes) -> None:
        if data:
            self._hardware.transport.write(data)
            self._log.write_mavlink(data, self._clock.now_s(), "out")

    # ------------------------------------------------------------ telling people

    def _publish(self, notice: Notice) -> None:
        """Tell the log, the terminal and the ground station."""
        self._log.write("notice", notice, notice.time_s)
        self._new_notices.append(notice)
        self._service.status(f"{self._phase}: {notice.text}")
        self._send(self.session.send_notice(notice.text, notice.severity))

    async def _status_task(self) -> None:
        """Hand the newest state to the terminal a few times a second."""
        self._service.ready()
        frames_before = 0
        while True:
            await asyncio.sleep(STATUS_PERIOD_S)
            frames, notices = self._frame_count - frames_before, tuple(self._new_notices)
            frames_before, self._new_notices = self._frame_count, []
            if self._on_status is None:
                continue
            now_s = self._clock.now_s()
            status = Status(
                time_s=now_s - self._start_s,
                phase=self._phase,
                mode=self.session.state.mode,
                vehicle=self._estimator.vehicle(now_s),
                pad=self._estimator.pad(now_s),
                last_frame=self._last_frame,
                frame_rate_hz=frames / STATUS_PERIOD_S,
                latency_ms=self._latency_ms,
                notices=notices,
            )
            self._on_status(status)
