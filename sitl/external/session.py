"""The simulation around an external vehicle in real time: pad, camera, ultrasonic, beacon.

It receives a vehicle's pose over MAVLink and flies nothing. The app may share the connection: what it sends
to the relay's port is forwarded to the vehicle, and the vehicle's bytes are forwarded there.
"""

import asyncio
import contextlib
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.base.clock import Clock
from companion.base.geometry import Vector3, tilt_from_quat
from companion.base.messages import Frame, Phase, Truth
from companion.base.signals import stopping_on_signals
from companion.config import ConfigError, VehicleConfig, find_file, load_model
from companion.link.codec import Message
from sitl.devices.ports import DevicePort, PtyPort
from sitl.devices.socket_servers import FrameServer
from sitl.devices.ultrasonic import PolledUltrasonicDevice, UltrasonicDevice
from sitl.external.client import VehicleClient
from sitl.external.link import check_connection, open_link, open_relay, pump
from sitl.external.pose import LONGEST_GUESS_S
from sitl.external.world import ExternalWorld
from sitl.faults.lines import FrameLine
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.sensor_telemetry import distance_sensor
from sitl.run.mavlink_line import ByteLink
from sitl.run.process_control import (
    REPORT_NAME,
    SENSOR_BAUD,
    SimulationReport,
    final_phase,
    print_json,
    report_of,
    run_until_finished,
)
from sitl.run.scene_camera import SceneCamera
from sitl.run.simulation import TRUTH_EVERY_TICKS
from sitl.scenario.scenario import PassBounds, Scenario
from sitl.sensors.autopilot_sensors import RANGE_PERIOD_S
from sitl.sensors.inertial import sensor_errors
from sitl.sensors.sensors import OUT_OF_RANGE_M, RangeErrors, RangeSensor
from sitl.world.score import Verdict


class RangefinderMessages:
    """A rangefinder for an external autopilot: DISTANCE_SENSOR of the height over pad and ground.

    PX4 takes it as it is, ArduPilot with RNGFND1_TYPE 10. It is of the same make as the companion computer's
    ultrasonic, with noise of its own.
    """

    def __init__(self, sensor: RangeSensor, bounds: RangeErrors) -> None:
        """Of a sensor with these bounds."""
        self._sensor, self._bounds = sensor, bounds
        self._first_s: float | None = None
        self._due_s = 0.0

    def due(self, now_s: float, height_m: float, tilt_rad: float) -> Message | None:
        """The message that is due: `height_m` over what is below, tilting by `tilt_rad`."""
        if self._first_s is None:
            self._first_s = self._due_s = now_s
        if now_s < self._due_s:
            return None
        self._due_s = max(self._due_s + RANGE_PERIOD_S, now_s)
        distance_m = self._sensor.sample(height_m, tilt_rad)
        return distance_sensor(round(1e3 * (now_s - self._first_s)), distance_m, self._bounds)


TICK_S: Final = 0.005
# a picture waits so long for the message after its last row; then the newest pose is carried on
POSE_WAIT_S: Final = 0.04
CAMERA_BACKLOG_S: Final = 0.2
_MOST_TRUTH: Final = 100_000  # half an hour: more than a flight, and not all of a world left on for days
STREAM: Final = 22  # random draws of this world: (seed, 22); the pad's are the bundled world's own


class Relay(ByteLink, Protocol):
    """The app's connection to the vehicle, if it shares the world's."""

    @property
    def has_peer(self) -> bool: ...


class FrameSink(Protocol):
    """Takes the camera's frames."""

    @property
    def client_count(self) -> int: ...

    def deliver(self, frame: Frame) -> None: ...


@dataclass(slots=True)
class ExternalConnections:
    """The connected parts; the caller closes the ports."""

    link: ByteLink
    relay: Relay
    range_port: DevicePort
    frames: FrameSink


class ExternalSimulation:
    """A scenario's pad, camera and ultrasonic around the vehicle of a MAVLink client."""

    def __init__(
        self, scenario: Scenario, seed: int, connections: ExternalConnections, tell: Callable[[str], None]
    ) -> None:
        """Build it inside the running loop.

        Raises:
            ConfigError: a file that the scenario names is missing or wrong, or its pad leaves the ground.
        """
        if scenario.as_built is not None:
            raise ConfigError(
                f"scenario '{scenario.name}': as_built: expected none, since an external vehicle is as it is"
            )
        self._clock = Clock()
        self._connections = connections
        self._tell = tell
        self._bounds = scenario.pass_bounds
        self.client = VehicleClient(tell)
        self.world = ExternalWorld(scenario, seed)
        self.ready = asyncio.Event()
        self._vehicle = load_model(VehicleConfig, find_file("vehicles", scenario.airframe))
        *rngs, rangefinder_rng = np.random.default_rng((seed, STREAM)).spawn(7)
        streams = iter(rngs)
        errors = sensor_errors(scenario.sensors)
        self._half_beam_rad = errors.range.half_beam_rad
        self._rangefinder = RangefinderMessages(RangeSensor(errors.range, rangefinder_rng), errors.range)
        echo = RangeSensor(errors.range, next(streams))
        polled = scenario.sensors.ultrasonic == "polled"
        self._ultrasonic = PolledUltrasonicDevice(echo) if polled else UltrasonicDevice(echo)
        cameras = (next(streams), next(streams), next(streams))
        self._camera = SceneCamera(scenario, self._vehicle, self.world, *cameras, self._clock.now_s())
        self._station_rng, self._beacon = next(streams), scenario.beacon
        self._station: GroundStation | None = None
        self._origin_source: str | None = None
        self._frame_line = FrameLine(
            next(streams), scenario.camera.lost_share, scenario.camera.lost_burst_frames
        )
        self._truth: deque[Truth] = deque(maxlen=_MOST_TRUTH)
        self._ticks = 0
        self._first_s: float | None = None
        self._latest_tick_s = 0.0
        self._reported_touchdown_s: float | None = None

    async def run(self) -> None:
        connections = self._connections
        async with asyncio.TaskGroup() as group:
            group.create_task(
                pump(connections.link, self._receive_vehicle, connections.relay.write, tell=self._tell)
            )
            group.create_task(
                pump(connections.relay, connections.link.write, self._receive_app, tell=self._tell)
            )
            group.create_task(self._render_frames())
            due_s = self._clock.now_s()
            while True:
                now_s = self._clock.now_s()
                self._latest_tick_s = max(self._latest_tick_s, now_s - due_s)
                self._tick(now_s)
                due_s = max(due_s + TICK_S, now_s)
                await self._clock.sleep_until(due_s)

    def report(self, final_phase: Phase) -> SimulationReport:
        now_s = self._clock.now_s()
        return report_of(
            self.world.judge(final_phase),
            self.world.watch,
            self.world.pad_at(now_s),
            duration_s=0.0 if self._first_s is None else now_s - self._first_s,
            latest_tick_s=self._latest_tick_s,
            truth=self._truth,
        )

    # ------------------------------------------------------------ the link

    def _receive_vehicle(self, data: bytes) -> None:
        now_s = self._clock.now_s()
        self.client.receive(data, now_s)
        if not self._connections.relay.has_peer:
            self._receive_ground(data, now_s)
        for sample in self.client.take_samples():
            # the truth and the estimates lie metres apart, above all in height: each has its own ground
            if self._origin_source != self.client.source and not self._set_origin(sample.place):
                continue
            self.world.see(sample, armed=self.client.armed)
            self.client.flown = self.world.flown
        if self.world.track.newest is not None and self._first_s is None:
            self._first_s = now_s
            self._camera.skip_to(now_s)
            self.ready.set()

    def _receive_app(self, data: bytes) -> None:
        self._receive_ground(data, self._clock.now_s())

    def _receive_ground(self, data: bytes, now_s: float) -> None:
        if self._station is not None:
            self._station.receive(data, now_s)

    def _set_origin(self, place: Vector3) -> bool:
        """Choose the origin: where it stands, or its home when it flies already."""
        if self.client.beats == 0:
            return False
        ground = place
        if self.client.armed:
            if self.client.home is None:
                return False  # requested; the ground is unknown until it arrives
            ground = self.client.home
            self._tell("WARNING: the vehicle is armed already; the ground is taken to be at its home")
        self.world.begin(ground)
        self._origin_source = self.client.source
        self._station = GroundStation(self._beacon, self._station_rng, ground)
        self._tell(
            f"vehicle {self.client.system_id} found by {self.client.source}; ground at latitude "
            f"{ground[0]:.7f}, longitude {ground[1]:.7f}, altitude {ground[2]:.2f} m"
        )
        return True

    # ------------------------------------------------------------ one tick

    def _tick(self, now_s: float) -> None:
        self._connections.link.write(self.client.transmit(now_s))
        if self._first_s is None:
            return
        self._transmit(now_s)
        self._ping(now_s)
        self._ticks += 1
        if self._ticks % TRUTH_EVERY_TICKS == 0:
            self._truth.append(self.world.truth_at(now_s))
            self._report_landing()

    def _transmit(self, now_s: float) -> None:
        """The ground station's heartbeat, and the pad's own GPS on request."""
        assert self._station is not None
        pad = self.world.pad_at(now_s)
        data = self._station.transmit(now_s, pad.position_ned_m, pad.velocity_ned_m_s)
        self._connections.link.write(data)
        self._connections.relay.write(data)

    def _ping(self, now_s: float) -> None:
        port, pose = self._connections.range_port, self.world.track.newest
        assert pose is not None
        distance = self.world.range_m(self._vehicle.range_position_body_m, self._half_beam_rad)
        height_m, tilt_rad = OUT_OF_RANGE_M if distance is None else distance, tilt_from_quat(pose.attitude)
        self._ultrasonic.receive(port.receive())
        port.send(self._ultrasonic.step(now_s, height_m, tilt_rad))
        range_message = self._rangefinder.due(now_s, height_m, tilt_rad)
        if range_message is not None:
            data = self.client.encode(range_message)
            self._connections.link.write(data)
            self._connections.relay.write(data)

    def _report_landing(self) -> None:
        """A table of each landing, for people, when the vehicle has disarmed after it."""
        touchdown = self.world.watch.touchdown
        if touchdown is None or self.world.armed or touchdown.time_s == self._reported_touchdown_s:
            return
        self._reported_touchdown_s = touchdown.time_s
        print_verdict(self.world.judge(Phase.LANDED), self._bounds)

    # ------------------------------------------------------------ the camera

    async def _render_frames(self) -> None:
        """Render each frame once the pose after its last row has come; a thread, since it takes a while."""
        await self.ready.wait()
        while True:
            await self._clock.sleep_until(self._camera.exposed_s)
            await self._pose_after(self._camera.exposed_s)
            now_s = self._clock.now_s()
            watched = self._connections.frames.client_count > 0
            self._camera.skip_to(now_s - CAMERA_BACKLOG_S if watched else now_s)
            taken = await self._clock.run(self._camera.step, now_s, modelled_s=0.0)
            if taken is not None:
                self._deliver_later(*taken)

    async def _pose_after(self, time_s: float) -> None:
        """Wait for a pose of that time; later, an earlier one will do; later still, frames are dropped."""
        while True:
            newest = self.world.track.newest
            assert newest is not None
            late_s = self._clock.now_s() - time_s
            can_be_guessed = late_s > POSE_WAIT_S and newest.time_s > time_s - LONGEST_GUESS_S
            if newest.time_s >= time_s or can_be_guessed:
                return
            if late_s > CAMERA_BACKLOG_S:
                self._camera.skip_to(self._clock.now_s())
                time_s = self._camera.exposed_s
            await asyncio.sleep(TICK_S)

    def _deliver_later(self, frame: Frame, due_s: float) -> None:
        if self._frame_line.delay_s(frame.sequence) is None:
            return  # lost on the way

        def deliver() -> None:
            self._connections.frames.deliver(replace(frame, received_s=self._clock.now_s()))

        asyncio.get_running_loop().call_at(due_s, deliver)


def print_verdict(verdict: Verdict, bounds: PassBounds) -> None:
    """The touchdown against the pass bounds, as a table on standard error."""
    table = Table(title=f"{verdict.outcome}" + "".join(f"; {failure}" for failure in verdict.failures))
    for heading in ("touchdown", "measured", "passes"):
        table.add_column(heading)
    if verdict.touchdown is not None:
        limits = bounds.model_dump()
        for name, value in verdict.touchdown.items():
            table.add_row(name, f"{value:.3f}", f"<= {limits[name]:g}" if name in limits else "")
    Console(stderr=True).print(table)


# ---------------------------------------------------------------- server
# The world around an external vehicle as a process: `companion-sitl --external`.
#
# It flies nothing: it watches the vehicle of an ArduPilot or PX4 SITL over MAVLink and puts a pad, a camera
# and an ultrasonic about it, in real time. It says by one line of JSON on standard output where these are
# once the vehicle is found (the keys are the app's settings), and on standard error what it waits for. Ctrl-C
# ends it and has the last landing judged. As the app's child it judges when standard input says `finish
# PHASE`, and ends with standard input, as the bundled simulator does.
#
# The app may share the connection: `link.connection` of that line is a UDP port behind which the vehicle is.


async def serve_external(
    scenario: Scenario, seed: int, folder: Path, connection: str, *, child: bool = False
) -> None:
    """Run the world until standard input or a signal ends it; see the module's docstring."""
    check_connection(connection, "--external")
    async with contextlib.AsyncExitStack() as stack:
        link = await open_link(connection, tell)
        stack.callback(link.close)
        relay, relay_port = await open_relay()
        stack.callback(relay.close)
        range_port = PtyPort(SENSOR_BAUD)
        stack.callback(range_port.close)
        frames = FrameServer(folder / "camera")
        await frames.start()
        stack.push_async_callback(frames.close)
        simulation = ExternalSimulation(
            scenario, seed, ExternalConnections(link, relay, range_port, frames), tell
        )
        stopped = asyncio.Event()
        if not child:
            stack.enter_context(stopping_on_signals(stopped.set))
        ending = final_phase() if child else _landed_once(stopped)
        _tell_pad(scenario)
        tell(f"waiting for a vehicle on {connection}")
        endpoints = _endpoints(relay_port, range_port.path, frames.address)
        telling = asyncio.create_task(_tell_once_found(simulation, endpoints))
        stack.callback(telling.cancel)
        await run_until_finished(simulation, folder / REPORT_NAME, ending)


def _endpoints(relay_port: int, range_path: str, frames: str) -> dict[str, Any]:
    """The app's settings that lead here."""
    return {
        "link": {"connection": f"udp:127.0.0.1:{relay_port}"},
        "sense": {
            "source": "autopilot",
            "autopilot": {"range_source": "boards"},
            "range": {"port": range_path},
            "vision": {"source": frames},
        },
    }


async def _tell_once_found(simulation: ExternalSimulation, endpoints: dict[str, Any]) -> None:
    await simulation.ready.wait()
    print_json(endpoints)


async def _landed_once(stopped: asyncio.Event) -> Phase:
    """The final phase is unknown: the truth alone decides."""
    await stopped.wait()
    return Phase.LANDED


def _tell_pad(scenario: Scenario) -> None:
    height_m = scenario.pad.surface_height_m
    if height_m > 0.0:
        tell(
            f"scenario '{scenario.name}': pad.surface_height_m {height_m:g} is taken as 0: the ground of an "
            "external simulator is flat, so the pad lies flush with it"
        )


def tell(text: str) -> None:
    """One line for people, on standard error."""
    print(f"companion-sitl: {text}", file=sys.stderr, flush=True)
