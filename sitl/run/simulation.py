"""One simulated vehicle put together: world, autopilot, sensors, camera and the ground station.

`Simulation.run` drives them on the running loop. In virtual time the loop jumps from tick to tick; in
real time a tick that comes a little late is made up for. One that comes very late is not: the world has
stood still meanwhile, which a flight survives, where a burst of motion would overflow the vehicle's
buffers. What the app may have leaves as registers, serial bytes, frames and MAVLink; the truth leaves in
`report`, for scoring alone.

The world counts from 0 at the loop's time `start_s`; stamps that leave it (frames, truth) are loop time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Protocol

import numpy as np

from companion.base.clock import Clock
from companion.base.geometry import Vector3
from companion.base.messages import Frame, Phase, Truth
from companion.base.slots import Slot
from companion.config import GpsConfig, VehicleConfig, find_file, load_model
from sitl.autopilot import ESTIMATORS, MANNERS, Autopilot
from sitl.camera.frame_line import FrameLine
from sitl.devices.neo6m import UNIX_AT_START_S
from sitl.devices.ports import DevicePort
from sitl.devices.rack import SensorRack, Wiring
from sitl.faults.faulty_link import LinkWay
from sitl.faults.injection import Breakable, FaultSchedule
from sitl.firmware.process import FirmwareError
from sitl.firmware.spec import FirmwareSpec
from sitl.firmware.vehicle import IMU_FILTER, FirmwareVehicle
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.network import Network, Write
from sitl.mavlink.signing import Signing
from sitl.mavlink.truth_telemetry import TruthMessages
from sitl.run.orders import interrupted_at_once
from sitl.run.report import SimulationReport
from sitl.run.scene_camera import CameraTruth, SceneCamera
from sitl.run.sensor_quality import sensor_errors
from sitl.scenario.scenario import Scenario, SensorSettings
from sitl.sensors.autopilot_sensors import OnboardSensors
from sitl.sensors.flaws import BoardTruth
from sitl.sensors.sensors import RangeErrors
from sitl.vehicle.hand_paths import HandMotion
from sitl.world.hand_held import HandHeldWorld
from sitl.world.score import judge
from sitl.world.world import World

PHYSICS_STEP_S: Final = 1.0 / 400.0
STEPS_PER_TICK: Final = 2
TICK_S: Final = PHYSICS_STEP_S * STEPS_PER_TICK
# well within what the MPU9250's FIFO holds (0.18 s)
LONGEST_CATCH_UP_S: Final = 0.03
TRUTH_EVERY_TICKS: Final = 4
RANGE_EVERY_TICKS: Final = 2
# the world and the sensors draw from (seed, 0..14)
SIMULATION_STREAM: Final = 20
FAULT_STREAM: Final = 21
# latitude (deg), longitude (deg), altitude (m) of the world's origin, and the field there (WMM 2025, rounded)
HOME: Final[Vector3] = (47.0, 8.0, 400.0)
MAGNETIC_FIELD_NED_UT: Final[Vector3] = (20.9, 0.6, 42.9)
OUT_OF_RANGE_M: Final = 99.0
HALF_BEAM_RAD: Final = RangeErrors().half_beam_rad


class ByteLink(Protocol):
    """The vehicle's end of the MAVLink line."""

    async def read(self) -> bytes:
        """Wait for at least one byte."""
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        ...


class Lines(Protocol):
    """The vehicle's MAVLink lines: each client has a port, which is the network's own business."""

    def connect(self, write: Write, *, datagrams: bool) -> Any:
        """Open a port."""
        ...

    def disconnect(self, port: Any) -> None:
        """Close it."""
        ...

    def receive(self, port: Any, data: bytes, now_s: float) -> None:
        """Take what a client sent."""
        ...

    def transmit(self, now_s: float, pad_position_ned_m: Vector3, pad_velocity_ned_m_s: Vector3) -> None:
        """Send all that is due."""
        ...


@dataclass(frozen=True, slots=True)
class SensorTruth:
    """Of the companion's boards, the autopilot's own sensors and the camera."""

    boards: BoardTruth
    autopilot: BoardTruth
    camera: CameraTruth


class MemoryFrames:
    """The camera of an app in the same process: the newest frame wins."""

    def __init__(self) -> None:
        self._slot: Slot[Frame] = Slot()

    def deliver(self, frame: Frame) -> None:
        """A frame has come over."""
        self._slot.put(frame)

    async def next(self) -> Frame:
        """Wait for a frame newer than the last."""
        return await self._slot.next()

    def close(self) -> None:
        """Nothing to give back."""


class Simulation:
    """A scenario under one seed. Make it inside the running loop; its world begins when `run` does."""

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        *,
        gps_port: DevicePort,
        range_port: DevicePort,
        deliver_frame: Callable[[Frame], None],
        link: ByteLink | None = None,
        camera_wanted: Callable[[], bool] = lambda: True,
        unix_at_start_s: float = UNIX_AT_START_S,
        signing_key: bytes | None = None,
        serve_truth: bool = False,
        keep_truth: bool = True,
        motion: HandMotion | None = None,
        hands_wait: bool = False,
        firmware: FirmwareSpec | None = None,
    ) -> None:
        """Build the world and plug the devices in. Nothing is rendered while the camera is not wanted.

        `link` is the MAVLink line of an app in this process, others come by `connect`. `unix_at_start_s` is
        UTC (s since 1970) when the world begins; `serve_truth` lets clients ask for the truth; `keep_truth`
        keeps all of it for `report`, which a vehicle that is served for days has no memory for. With a
        `motion` it is carried by hand and cannot fly; `hands_wait`: until `begin_motion`. A `firmware` flies
        it instead of the bundled autopilot: it is started here and has booted on return; `close` ends it.

        Raises:
            ConfigError: a settings file that the scenario names is missing or wrong.
        """
        self._scenario = scenario
        self._clock = Clock()
        self._start_s = self._clock.now_s()
        self._link = link
        self._camera_wanted = camera_wanted
        streams = iter(np.random.default_rng((seed, SIMULATION_STREAM)).spawn(6))
        self._world = (
            World(scenario, seed)
            if motion is None
            else HandHeldWorld(scenario, seed, motion, waits=hands_wait)
        )
        autopilot_rng = next(streams)
        signing = Signing(scenario.autopilot, signing_key)
        ground_station = GroundStation.of(scenario.beacon, next(streams), HOME, signing)
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", scenario.airframe))
        self._rack = _rack(scenario.sensors, seed, gps_port, range_port)
        self.imu_bus = self._rack.imu
        self._ranging = self._world.ranging(self._vehicle.range_position_body_m, HALF_BEAM_RAD)
        fault_rng = np.random.default_rng((seed, FAULT_STREAM))
        app_rng, vehicle_rng = fault_rng.spawn(2)
        camera = scenario.camera
        self._frame_line = FrameLine(fault_rng, camera.lost_share, camera.lost_burst_frames)
        self._to_app, self._to_vehicle = LinkWay(scenario.link, app_rng), LinkWay(scenario.link, vehicle_rng)
        camera_streams = (next(streams), next(streams))
        imu_filter = MANNERS[scenario.autopilot].imu_filter if firmware is None else IMU_FILTER
        self._onboard = _onboard(scenario.sensors, next(streams), imu_filter)
        self._camera = SceneCamera(scenario, self._vehicle, self._world, *camera_streams, next(streams))
        breakable = Breakable(
            self._rack, self._onboard, self._frame_line, self._world.motors, self._to_app, self._to_vehicle
        )
        self._faults = FaultSchedule(scenario.faults, breakable)
        self.network: Lines
        self._flies: Autopilot | FirmwareVehicle
        if firmware is None:
            self._flies = autopilot = Autopilot(
                scenario.autopilot,
                self._world.airframe.body,
                autopilot_rng,
                HOME,
                ESTIMATORS[scenario.estimator],
                self._world.airframe.rates,
            )
            truth = TruthMessages(autopilot, self._world, HOME) if serve_truth else None
            self.network = Network(autopilot, self._onboard, ground_station, signing, unix_at_start_s, truth)
        else:
            with interrupted_at_once():
                self._flies = flies = FirmwareVehicle(
                    firmware,
                    self._world,
                    self._onboard,
                    ground_station,
                    autopilot_rng,
                    home=HOME,
                    gps_delay_s=scenario.sensors.gps_delay_s,
                    step_s=PHYSICS_STEP_S,
                )
            self.network = flies.network
        self._deliver_frame = deliver_frame
        self._keep_truth = keep_truth
        self._truth: list[Truth] = []
        self._ticks = 0
        self._latest_tick_s = 0.0

    @property
    def autopilot(self) -> Autopilot:
        """The bundled one, where it flies: for tests and benches."""
        assert isinstance(self._flies, Autopilot)
        return self._flies

    def close(self) -> None:
        """End the firmware, where one flies."""
        if isinstance(self._flies, FirmwareVehicle):
            self._flies.close()

    @property
    def sensor_truth(self) -> SensorTruth:
        """How the sensors truly are: for tests and benches."""
        return SensorTruth(self._rack.truth, self._onboard.truth, self._camera.truth)

    @property
    def world(self) -> World:
        """The truth now: for tests and benches."""
        return self._world

    def begin_motion(self) -> None:
        """Have hands that wait begin, if it is carried by hand."""
        if isinstance(self._world, HandHeldWorld):
            self._world.begin()

    async def run(self) -> None:
        """Go on until cancelled.

        Raises:
            FirmwareError: the firmware that flies has ended or does not answer.
        """
        # making the world takes a while, which is not to be made up for
        self._start_s = self._clock.now_s()
        try:
            async with asyncio.TaskGroup() as group:
                if self._link is not None:
                    group.create_task(self._serve(self._link))
                await self._beat()
        except ExceptionGroup as group_of_errors:
            of_firmware, _ = group_of_errors.split(FirmwareError)
            raise (group_of_errors if of_firmware is None else of_firmware.exceptions[0]) from None

    async def _beat(self) -> None:
        """Tick for ever, by the loop's timers: a task that sleeps in between costs three times as much."""
        loop = asyncio.get_running_loop()
        failed: asyncio.Future[None] = loop.create_future()

        def tick(due_s: float) -> None:
            if failed.done():
                return
            try:
                self._keep_pace(loop.time() - due_s)
                self._tick()
            except Exception as error:  # of whatever kind, it ends `run`
                failed.set_exception(error)
                return
            self._ticks += 1
            loop.call_at(self._due_s(), tick, self._due_s())

        loop.call_at(self._due_s(), tick, self._due_s())
        await failed

    def _due_s(self) -> float:
        """When the next tick is: half a tick early, so that the world is never further from the clock than
        that. An age of samples that is off by milliseconds is an attitude that does not fit the frames."""
        return self._start_s + (self._ticks + 0.5) * TICK_S

    def connect(self, write: Write, *, datagrams: bool) -> Any:
        """Another MAVLink client, at the far end of the scenario's line.

        `write` takes whole frames and must not wait.
        """

        def send(frames: Sequence[bytes]) -> None:
            self._carry(self._to_app, lambda: write(frames))

        return self.network.connect(send, datagrams=datagrams)

    def disconnect(self, port: Any) -> None:
        """A client has gone."""
        self.network.disconnect(port)

    def hear(self, port: Any, data: bytes) -> None:
        """Bytes from a client have just come."""

        def receive() -> None:
            # the clock's time and not the last tick's: TIMESYNC is answered by it
            self.network.receive(port, data, max(0.0, self._clock.now_s() - self._start_s))

        self._carry(self._to_vehicle, receive)

    def _keep_pace(self, late_s: float) -> None:
        """Let the world's time slip by what is too late to make up for."""
        self._latest_tick_s = max(self._latest_tick_s, late_s)
        if late_s > LONGEST_CATCH_UP_S:
            self._start_s += late_s

    def report(self, final_phase: Phase) -> SimulationReport:
        """Judge the flight as it stands; `final_phase` is the app's last."""
        world = self._world
        verdict = judge(
            world.touchdown,
            self._scenario.pass_bounds,
            crashed=world.crashed,
            at_rest_on_pad=world.at_rest_on_pad,
            disarmed=not self._flies.armed,
            final_phase=final_phase,
            nearest_obstacle_m=world.nearest_obstacle_m,
        )
        pad_speed = (
            float(np.linalg.norm(world.pad_state.velocity_ned_m_s))
            if world.touchdown is None
            else world.touchdown.pad_speed_m_s
        )
        return SimulationReport(
            outcome=verdict.outcome,
            failures=verdict.failures,
            touchdown=None if verdict.touchdown is None else asdict(verdict.touchdown),
            pad_speed_m_s=pad_speed,
            duration_s=world.time_s,
            latest_tick_s=self._latest_tick_s,
            truth=tuple(self._truth),
            nearest_obstacle_m=world.nearest_obstacle_m,
            touchdown_pad_m=None if world.touchdown is None else world.touchdown.offset_pad_m,
        )

    # ------------------------------------------------------------ one tick

    def _tick(self) -> None:
        for _ in range(STEPS_PER_TICK):
            self._step_physics()
        now_s = self._world.time_s
        self._expose(now_s)
        self._talk(now_s)
        if self._ticks % TRUTH_EVERY_TICKS == 0:
            self._world.attitude_setpoint = self._flies.attitude_setpoint
            if self._keep_truth:
                self._truth.append(replace(self._world.truth(), time_s=self._start_s + now_s))

    def _step_physics(self) -> None:
        world = self._world
        motors = self._onboard.motors = self._flies.step(world.motion(), PHYSICS_STEP_S, world.time_s)
        world.step(motors, PHYSICS_STEP_S)
        state, throttle = world.state, 0.25 * sum(motors)
        if self._ticks % RANGE_EVERY_TICKS == 0:
            self._ranging = world.ranging(self._vehicle.range_position_body_m, HALF_BEAM_RAD)
        self._faults.step(world.time_s)
        self._onboard.step(world.time_s, state, throttle, self._range_height_m)
        self._rack.step(world.time_s, state, throttle, self._range_height_m)

    def _range_height_m(self) -> float:
        """The ultrasonic's height over what answers it."""
        distance_m = self._ranging()
        return OUT_OF_RANGE_M if distance_m is None else distance_m

    def _expose(self, now_s: float) -> None:
        """Render what has been exposed; it arrives after the scenario's latency, unless a fault has it."""
        if not self._camera_wanted():
            self._camera.skip_to(now_s)
        taken = self._camera.step(now_s)
        if taken is None:
            return
        frame, delivery_s = taken
        held_up_s = self._frame_line.delay_s(frame.sequence)
        if held_up_s is None:
            return
        delivery_s += held_up_s
        frame = replace(
            frame, time_s=self._start_s + frame.time_s, image=self._frame_line.carried(frame.image)
        )

        def deliver() -> None:
            self._deliver_frame(replace(frame, received_s=self._clock.now_s()))

        asyncio.get_running_loop().call_at(self._start_s + max(delivery_s, now_s), deliver)

    def _talk(self, now_s: float) -> None:
        pad = self._world.pad_state
        self.network.transmit(now_s, pad.position_ned_m, pad.velocity_ned_m_s)

    async def _serve(self, link: ByteLink) -> None:
        def write(frames: Sequence[bytes]) -> None:
            link.write(b"".join(frames))

        port = self.connect(write, datagrams=False)
        while True:
            self.hear(port, await link.read())

    def _carry(self, way: LinkWay, deliver: Callable[[], None]) -> None:
        """Hand a datagram over when the line has it through, if it does."""
        now_s = self._clock.now_s()
        arrival_s = way.arrival_s(now_s)
        if arrival_s is None:
            return
        if arrival_s <= now_s:
            deliver()
        else:
            asyncio.get_running_loop().call_at(arrival_s, deliver)


# ---------------------------------------------------------------- parts


def _rack(settings: SensorSettings, seed: int, gps_port: DevicePort, range_port: DevicePort) -> SensorRack:
    """The boards that the app reads."""
    return SensorRack(
        seed,
        PHYSICS_STEP_S,
        home=HOME,
        field_ned_ut=MAGNETIC_FIELD_NED_UT,
        gps_port=gps_port,
        range_port=range_port,
        gps_config=GpsConfig(latency_s=settings.gps_delay_s),
        errors=sensor_errors(settings),
        wiring=Wiring(settings.imu_interface, settings.gps_wake_baud, settings.ultrasonic),
    )


def _onboard(settings: SensorSettings, rng: np.random.Generator, imu_filter: int) -> OnboardSensors:
    """The autopilot's own sensors."""
    errors = sensor_errors(settings)
    return OnboardSensors(
        rng,
        PHYSICS_STEP_S,
        home=HOME,
        field_ned_ut=MAGNETIC_FIELD_NED_UT,
        imu_filter=imu_filter,
        gps_latency_s=settings.gps_delay_s,
        imu_errors=errors.imu,
        mag_errors=errors.magnetometer,
        gps_errors=errors.gps,
        range_errors=errors.range,
    )
