"""One simulated vehicle: world, autopilot, sensors, camera and the ground station, stepped together.

`Simulation.run` steps them on the running loop (`sitl.run.tick_timer`). The app receives registers, serial
bytes, frames and MAVLink; `report` has the truth, for scoring alone.

Simulation time starts at 0; stamps that leave it (frames, truth) are loop time.
"""

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from companion.base.clock import Clock
from companion.base.geometry import ZERO3, Vector3
from companion.base.messages import Frame, Phase, Truth
from companion.config import ConfigError, GpsConfig, VehicleConfig, find_file, load_model
from sitl.autopilot.control.estimator import ESTIMATORS
from sitl.autopilot.flight.autopilot import PROFILES, SimulatedAutopilot
from sitl.devices.mpu9250 import Mpu9250Device
from sitl.devices.neo6m import UNIX_AT_START_S
from sitl.devices.ports import DevicePort
from sitl.devices.rack import SensorRack
from sitl.faults.faults import Fault
from sitl.faults.lines import FrameLine
from sitl.faults.schedule import FaultSchedule, Moments, Schedule, StatusTextMonitor
from sitl.faults.targets import ComputerFaults, FaultTargets
from sitl.firmware import FirmwareError
from sitl.firmware.spec import FirmwareSpec
from sitl.firmware.vehicle import IMU_FILTER, FirmwareNetwork, FirmwareVehicle
from sitl.mavlink.framing import Signing
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.network import Network
from sitl.mavlink.sensor_telemetry import TruthMessages
from sitl.run.mavlink_line import ByteLink, MavlinkLine
from sitl.run.process_control import SimulationReport, interrupted_at_once, report_of
from sitl.run.scene_camera import CameraTruth, SceneCamera
from sitl.run.tick_timer import TickTimer
from sitl.scenario.scenario import Scenario, magnetic_field_ned_ut
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.sensors.inertial import sensor_errors
from sitl.sensors.sensors import OUT_OF_RANGE_M, BoardTruth, RangeErrors
from sitl.vehicle import HandMotion
from sitl.world.hand_held import HandHeldWorld
from sitl.world.score import judge
from sitl.world.world import FirmGroundWorld, World

PHYSICS_STEP_S: Final = 1.0 / 400.0
STEPS_PER_TICK: Final = 2
TICK_S: Final = PHYSICS_STEP_S * STEPS_PER_TICK
TRUTH_EVERY_TICKS: Final = 4
RANGE_EVERY_TICKS: Final = 2
# random draws of the simulation and of its faults; world and sensors draw from (seed, 0..14)
SIMULATION_STREAM: Final = 20
FAULT_STREAM: Final = 21
HALF_BEAM_RAD: Final = RangeErrors().half_beam_rad


@dataclass(frozen=True, slots=True)
class SensorTruth:
    """The true errors of the companion's sensors, of the autopilot's own sensors and of the camera."""

    boards: BoardTruth
    autopilot: BoardTruth
    camera: CameraTruth


class Simulation:
    """A scenario with a seed. Make it inside the running loop; simulation time starts with `run`.

    `world` is the truth now, `home` latitude (deg), longitude (deg), altitude (m AMSL) where the vehicle
    starts: for tests and benches.
    """

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
        computer: ComputerFaults | None = None,
    ) -> None:
        """Build the world and connect the devices. No frame is rendered while `camera_wanted` is false.

        `link` is the MAVLink line of an app in this process; other clients connect to `line`.
        `unix_at_start_s` is UTC (s since 1970) at simulation time 0. `serve_truth` lets clients request the
        truth, over ground as other simulators have it (`firm_ground`); `keep_truth` stores it for `report`.
        With a `motion` the vehicle is carried by hand and cannot fly; `hands_wait`: until `begin_motion`.
        A `firmware` that flies it has booted on return.
        `computer`: where faults of the companion computer are noted, for a harness that applies them.

        Raises:
            ConfigError: a settings file that the scenario names is missing or wrong.
        """
        self._scenario, self._timer, self._link = scenario, TickTimer(TICK_S), link
        self._camera_wanted, self._deliver_frame = camera_wanted, deliver_frame
        self._keep_truth, self._truth = keep_truth, list[Truth]()
        self.world = world = _world(scenario, seed, motion, hands_wait, firm_ground=serve_truth)
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", scenario.airframe))
        self._range_finder = world.ranging(self._vehicle.range_position_body_m, HALF_BEAM_RAD)
        streams = np.random.default_rng((seed, SIMULATION_STREAM)).spawn(6)
        autopilot_rng, beacon_rng, noise_rng, latency_rng, sensors_rng, lens_rng = streams
        built, fault_rng = world.built, np.random.default_rng((seed, FAULT_STREAM))
        self.home = home = built.home(scenario.place)
        imu_filter = PROFILES[scenario.autopilot].imu_filter if firmware is None else IMU_FILTER
        self._rack, sensors = self._sensors(seed, sensors_rng, gps_port, range_port, imu_filter)
        self._autopilot_sensors = sensors
        rngs = (noise_rng, latency_rng, lens_rng)
        self._camera = SceneCamera(scenario, self._vehicle, world, *rngs, built=built, begin=Clock().begin)
        self.line = line = MavlinkLine(built.links(scenario.link), fault_rng, self._timer)
        self._frame_line = FrameLine(fault_rng, scenario.camera.lost_share, scenario.camera.lost_burst_frames)
        signing = Signing(scenario.autopilot, signing_key)
        self._station = station = GroundStation(scenario.beacon, beacon_rng, home, signing)
        self._flight_controller = self._autopilot(firmware, station, autopilot_rng)
        line.network = self._network(station, signing, unix_at_start_s, serve_truth=serve_truth)
        self.status_text_monitor = StatusTextMonitor()
        line.listeners.append(self.status_text_monitor.hear)
        self.on_step: Callable[[], None] | None = None  # after each step of the physics: for benches
        self._fault_targets = self._targets(sensors, computer)
        self.faults: Schedule = self.fault_schedule(scenario.faults)

    @property
    def imu_bus(self) -> Mpu9250Device:
        return self._rack.imu

    @property
    def autopilot(self) -> SimulatedAutopilot:
        """The bundled autopilot: for tests and benches."""
        assert isinstance(self._flight_controller, SimulatedAutopilot)
        return self._flight_controller

    def close(self) -> None:
        if isinstance(self._flight_controller, FirmwareVehicle):
            self._flight_controller.close()

    @property
    def sensor_truth(self) -> SensorTruth:
        """The true errors of the sensors: for tests and benches."""
        return SensorTruth(self._rack.truth, self._autopilot_sensors.truth, self._camera.truth)

    @property
    def receiver_wander_ned_m(self) -> Vector3:
        """How far the GPS receiver is off by its slow wander: for benches."""
        return self._rack.position.wander_ned_m

    def fault_schedule(self, faults: Sequence[Fault]) -> FaultSchedule:
        """A schedule of faults of this vehicle; it acts once it is stepped, as `faults` is.

        Raises:
            ConfigError: a fault has nothing here that it could act on.
        """
        world = self.world
        return FaultSchedule(
            faults, self._fault_targets, Moments(self.status_text_monitor, lambda: world.feet_over_pad_m)
        )

    def begin_motion(self) -> None:
        if isinstance(self.world, HandHeldWorld):
            self.world.begin()

    async def run(self) -> None:
        """Go on until cancelled.

        Raises:
            FirmwareError: the firmware that flies has ended or does not answer.
        """
        # building the world takes a while, which is not to be made up for
        self._timer.restart()
        try:
            async with asyncio.TaskGroup() as group:
                if self._link is not None:
                    group.create_task(self.line.serve(self._link))
                await self._timer.run(self._tick)
        except ExceptionGroup as group_of_errors:
            of_firmware, _ = group_of_errors.split(FirmwareError)
            raise (group_of_errors if of_firmware is None else of_firmware.exceptions[0]) from None

    def report(self, final_phase: Phase) -> SimulationReport:
        world = self.world
        verdict = judge(
            world.watch,
            self._scenario.pass_bounds,
            at_rest_on_pad=world.at_rest_on_pad,
            disarmed=not self._flight_controller.armed,
            final_phase=final_phase,
        )
        report = report_of(
            verdict,
            world.watch,
            world.pad_state,
            duration_s=world.time_s,
            latest_tick_s=self._timer.latest_s,
            truth=self._truth,
        )
        return replace(
            report,
            touchdown_pad_m=None if world.watch.touchdown is None else world.watch.touchdown.offset_pad_m,
            as_built=None if self._scenario.as_built is None else world.built.told(),
            contacts=tuple(replace(c, time_s=self._timer.start_s + c.time_s) for c in verdict.contacts),
        )

    # ------------------------------------------------------------ building it

    def _sensors(
        self,
        seed: int,
        rng: np.random.Generator,
        gps_port: DevicePort,
        range_port: DevicePort,
        imu_filter: int,
    ) -> tuple[SensorRack, SimulatedAutopilotSensors]:
        """The app's sensors and the autopilot's own; `imu_filter` is the low-pass of the latter's IMU."""
        home, settings, built = self.home, self._scenario.sensors, self.world.built
        field_ned_ut = magnetic_field_ned_ut(home)
        errors = sensor_errors(settings, built.vibration)
        rack = SensorRack(
            seed,
            PHYSICS_STEP_S,
            home=home,
            field_ned_ut=field_ned_ut,
            gps_port=gps_port,
            range_port=range_port,
            gps_config=GpsConfig(latency_s=settings.gps_delay_s),
            errors=errors,
            imu_position_body_m=built.imu_offset_body_m,
            wiring=settings,
        )
        own = SimulatedAutopilotSensors(
            rng,
            PHYSICS_STEP_S,
            home=home,
            field_ned_ut=field_ned_ut,
            imu_filter=imu_filter,
            imu_position_body_m=built.autopilot_imu_offset_body_m,
            gps_latency_s=settings.gps_delay_s,
            errors=errors,
        )
        return rack, own

    def _autopilot(
        self, firmware: FirmwareSpec | None, station: GroundStation, rng: np.random.Generator
    ) -> SimulatedAutopilot | FirmwareVehicle:
        scenario, airframe, built = self._scenario, self.world.believed_airframe, self.world.built
        if firmware is None:
            estimator, kind = ESTIMATORS[scenario.estimator], scenario.autopilot
            body = built.told_body(airframe.body)
            # what is tuned on the vehicle turns it as it was meant to
            rates = airframe.rates or PROFILES[kind].attitude_gains.shares.rates(airframe.body)
            autopilot = SimulatedAutopilot(kind, body, rng, self.home, estimator, rates)
            if built.yaw_reset_deg:
                autopilot.estimate.reset_yaw_at(built.yaw_reset_s, math.radians(built.yaw_reset_deg))
            for name, value in scenario.autopilot_parameters.items():
                if not autopilot.parameters.set(name, value):
                    raise ConfigError(f"autopilot_parameters: {name}: {value:g}; expected {kind} to take it")
            return autopilot
        with interrupted_at_once():
            return FirmwareVehicle(
                firmware,
                self.world,
                self._autopilot_sensors,
                station,
                rng,
                home=self.home,
                gps_delay_s=scenario.sensors.gps_delay_s,
                step_s=PHYSICS_STEP_S,
            )

    def _network(
        self, station: GroundStation, signing: Signing, unix_at_start_s: float, *, serve_truth: bool
    ) -> Network | FirmwareNetwork:
        autopilot, sensors = self._flight_controller, self._autopilot_sensors
        if isinstance(autopilot, FirmwareVehicle):
            return autopilot.network
        truth = TruthMessages(autopilot, self.world, self.home) if serve_truth else None
        return Network(autopilot, sensors, station, signing, unix_at_start_s, truth)

    def _targets(self, sensors: SimulatedAutopilotSensors, computer: ComputerFaults | None) -> FaultTargets:
        world, line, network = self.world, self.line, self.line.network
        autopilot = self._flight_controller
        return FaultTargets(
            self._rack,
            sensors,
            self._frame_line,
            world.motors,
            line.to_app,
            line.to_vehicle,
            self._camera.model,
            world.pad_motion,
            self._station,
            autopilot if isinstance(autopilot, SimulatedAutopilot) else None,
            network.restart if isinstance(network, Network) else lambda: None,
            computer,
        )

    # ------------------------------------------------------------ one tick

    def _tick(self) -> None:
        for _ in range(STEPS_PER_TICK):
            self._step_physics()
        now_s = self.world.time_s
        self._expose(now_s)
        pad = self.world.pad_state
        self.line.network.transmit(now_s, pad.position_ned_m, pad.velocity_ned_m_s)
        if self._timer.count % TRUTH_EVERY_TICKS == 0:
            self.world.attitude_setpoint = self._flight_controller.attitude_setpoint
            if self._keep_truth:
                self._truth.append(replace(self.world.truth(), time_s=self._timer.start_s + now_s))

    def _step_physics(self) -> None:
        world = self.world
        motors = self._autopilot_sensors.motors = self._flight_controller.step(
            world.state, PHYSICS_STEP_S, world.time_s
        )
        world.step(motors, PHYSICS_STEP_S)
        state, throttle = world.state, sum(motors) / len(motors)
        if self._timer.count % RANGE_EVERY_TICKS == 0:
            self._range_finder = world.ranging(self._vehicle.range_position_body_m, HALF_BEAM_RAD)
        self.faults.step(world.time_s)
        if world.built.deck_field_ned_ut != ZERO3:
            field_ned_ut = world.deck_field_ned_ut()
            self._rack.deck_field_ned_ut = self._autopilot_sensors.deck_field_ned_ut = field_ned_ut
        self._autopilot_sensors.step(world.time_s, state, throttle, self._range_height_m)
        self._rack.step(world.time_s, state, throttle, self._range_height_m)
        if self.on_step is not None:
            self.on_step()

    def _range_height_m(self) -> float:
        """The ultrasonic's distance to the first echo."""
        distance_m = self._range_finder()
        return OUT_OF_RANGE_M if distance_m is None else distance_m

    def _expose(self, now_s: float) -> None:
        """Have the exposed frame drawn; it arrives after the scenario's latency, subject to faults."""
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
        if self._frame_line.garbled_share > 0.0:
            self._camera.finish()
        frame = replace(
            frame, time_s=self._timer.start_s + frame.time_s, image=self._frame_line.carried(frame.image)
        )

        def deliver() -> None:
            self._camera.finish()
            self._deliver_frame(replace(frame, received_s=self._timer.now_s))

        asyncio.get_running_loop().call_at(self._timer.start_s + max(delivery_s, now_s), deliver)


def _world(
    scenario: Scenario, seed: int, motion: HandMotion | None, hands_wait: bool, *, firm_ground: bool
) -> World:
    if motion is None:
        return FirmGroundWorld(scenario, seed) if firm_ground else World(scenario, seed)
    return HandHeldWorld(scenario, seed, motion, waits=hands_wait)
