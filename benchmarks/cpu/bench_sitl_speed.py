"""How fast one simulated vehicle runs in virtual time on one core, without and with its camera.

    python -m benchmarks sitl-speed --autopilot px4 --seed 0

The vehicle is served alone and flown by MAVLink bytes over a moving pad, in wind (`speed_flight`). Figures
are simulated seconds in one of this process's CPU seconds, the best of a few flights, because what else the
machine does slows a CPU second too. The table of parts comes from flights of its own, since watching costs:
its parts are scaled to what the flight costs unwatched. Prints the bars and ends in one line that says
whether they hold; the exit status matches.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import cv2
from pymavlink.dialects.v20 import common as mavlink
from rich.table import Table

from benchmarks.cpu.cpu_watch import SITL_METHODS, CpuWatch, Methods
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import Clock, run_in_virtual_time
from companion.base.geometry import Vector3
from companion.base.messages import Frame
from sitl.campaign.tables import Bar
from sitl.devices.ports import MemoryPort
from sitl.pad.paths import CircleMotion, Meeting
from sitl.run.simulation import PHYSICS_STEP_S, Simulation
from sitl.scenario.scenario import USUAL_HOMES, PadSettings, Scenario
from sitl.world.wind import WindSettings

SMOKE: Final = ("--runs", "1")
BARE_FACTOR: Final = 40.0
CAMERA_FACTOR: Final = 8.0
LEAST_PHYSICS_HZ: Final = 400.0
FLOWN_M: Final = 2.0
RUNS: Final = 3
CLIENT: Final = "client"
REST: Final = "event loop, ticks, log"


def at_least(name: str, value: float, least: float) -> Bar:
    """A bar on a figure, which may be no less."""
    return Bar(name, f"{value:.1f} (>= {least:g})", value >= least)


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Measure, show and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--autopilot", choices=("px4", "ardupilot"), default="px4")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=RUNS, help="the best of so many flights counts")
    chosen = parser.parse_args(arguments)
    report = BenchReport()
    cv2.setNumThreads(1)
    flights: dict[bool, SpeedFlight] = {}
    parts: dict[bool, dict[str, float]] = {}
    for camera in (False, True):
        flown = [fly(chosen.autopilot, chosen.seed, camera=camera) for _ in range(chosen.runs)]
        flights[camera] = max(flown, key=lambda flight: flight.whole.real_time_factor)
        watch = CpuWatch(PARTS)
        with watch.watching():
            fly(chosen.autopilot, chosen.seed, camera=camera)
        parts[camera] = _scaled(watch.spent_s, 1e3 / flights[camera].whole.real_time_factor)
    report.show(_parts_table(parts))
    return report.judge(_bars(flights))


def _scaled(spent_s: dict[str, float], total_ms: float) -> dict[str, float]:
    """ms of a simulated second by part, the client's left out."""
    own = {part: spent_s.get(part, 0.0) for part in PARTS if part != CLIENT}
    whole_s = sum(own.values())
    return {part: total_ms * value / whole_s for part, value in own.items()}


def _parts_table(parts: dict[bool, dict[str, float]]) -> Table:
    table = Table(title="ms of CPU a simulated second")
    table.add_column("part")
    for name in ("without camera", "with camera"):
        table.add_column(name, justify="right")
    for part in parts[False]:
        table.add_row(part, *(f"{parts[camera][part]:.2f}" for camera in (False, True)))
    table.add_section()
    table.add_row("all", *(f"{sum(parts[camera].values()):.2f}" for camera in (False, True)))
    return table


def _bars(flights: dict[bool, SpeedFlight]) -> list[Bar]:
    bare, rendered = flights[False], flights[True]
    return [
        at_least("without camera, x real time", bare.whole.real_time_factor, BARE_FACTOR),
        *(
            at_least(f"640x480 at 30 fps from {name}, x real time", stage.real_time_factor, CAMERA_FACTOR)
            for name, stage in rendered.stages.items()
        ),
        at_least("physics, Hz", 1.0 / PHYSICS_STEP_S, LEAST_PHYSICS_HZ),
        # that it was flown at all, and to the places where it is measured
        at_least("highest, m", bare.highest_m, HIGH_M - 1.0),
        at_least("over the pad, m to spare", FLOWN_M - max(bare.away_m.values()), 0.0),
        at_least("frames a second", rendered.frames / rendered.seconds, 29.0),
    ]


# ---------------------------------------------------------------- speed flight
# One vehicle served alone in virtual time, and a client that flies it over its pad by MAVLink bytes.
#
# The pad drives round home in a moderate turbulent wind. The client arms, takes off and streams velocities
# that keep it over the pad, first at 8 m, then at 2 m; where the pad goes it knows from the scenario. What
# the client costs is taken off: the vehicle is measured. Times are of this process's CPU, all threads, so
# that a busy machine counts little.

READY_S: Final = 6.5
TALK_S: Final = 0.05
HIGH_M: Final = 8.0
LOW_M: Final = 2.0
# when what is flown, from the start: there is time to get there before each stage is measured
LOW_FROM_S: Final = 30.0
END_S: Final = 50.0
STAGES: Final = {"8 m": (18.0, 30.0), "2 m": (38.0, 50.0)}
PAD_SPEED_M_S: Final = 1.0
PAD_RADIUS_M: Final = 4.0
FOLLOW_PER_S: Final = 0.6
TOP_SPEED_M_S: Final = 2.0
_OFFBOARD: Final = (6.0, 0.0)
_GUIDED: Final = (4.0, 0.0)
_VELOCITY: Final = 0b10111_000_111


class FlightStage(NamedTuple):
    """A stretch of the flight: how long it was in the world, and what the vehicle cost in it."""

    simulated_s: float
    cpu_s: float

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds in one of the CPU's."""
        return self.simulated_s / self.cpu_s


@dataclass(frozen=True)
class SpeedFlight:
    """What was measured."""

    whole: FlightStage
    stages: dict[str, FlightStage]
    seconds: float
    frames: int
    highest_m: float
    away_m: dict[str, float]


def scenario(autopilot_kind: AutopilotKind) -> Scenario:
    """A pad on a circle round home, 5 m/s of wind and moderate turbulence."""
    meet = Meeting(point_ned_m=(PAD_RADIUS_M, 0.0), time_s=0.0, spread_m=0.0)
    motion = CircleMotion(
        kind="circle",
        speed_m_s=PAD_SPEED_M_S,
        radius_m=PAD_RADIUS_M,
        direction="clockwise",
        phase_deg=0.0,
        meet=meet,
    )
    return Scenario(
        name="speed",
        description="a pad round home, in wind",
        autopilot=autopilot_kind,
        start_heading_deg=0.0,
        pad=PadSettings(surface_height_m=0.3, motion=motion),
        wind=WindSettings(mean_m_s=5.0, from_deg=60.0, turbulence="moderate"),
    )


class SpeedClient:
    """Both ends of the line: the vehicle's, and a ground station that flies it. Counts its own costs."""

    def __init__(self, autopilot_kind: AutopilotKind) -> None:
        self.spent_s = 0.0
        self.position: Vector3 | None = None
        self._autopilot_kind = autopilot_kind
        self._mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._parser = mavlink.MAVLink(None)
        self._to_vehicle: deque[bytes] = deque()
        self._arrived = asyncio.Event()

    # ------------------------------------------------------------ the vehicle's end

    async def read(self) -> bytes:
        """Bytes for the vehicle."""
        while not self._to_vehicle:
            self._arrived.clear()
            await self._arrived.wait()
        return self._to_vehicle.popleft()

    def write(self, data: bytes) -> None:
        """Bytes from the vehicle."""
        started_s = time.process_time()
        for message in self._parser.parse_buffer(data) or []:
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                self.position = (message.x, message.y, message.z)
        self.spent_s += time.process_time() - started_s

    # ------------------------------------------------------------ the client's end

    def begin(self) -> None:
        """Arm, and take off to 8 m."""
        if self._autopilot_kind == "ardupilot":
            self._command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, *_GUIDED)
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        over_sea_m = 0.0 if self._autopilot_kind == "ardupilot" else USUAL_HOMES["px4"][2]
        self._command(
            mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, over_sea_m + HIGH_M
        )

    def follow(self) -> None:
        """From now on the streamed velocities count."""
        if self._autopilot_kind == "px4":
            self._command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, *_OFFBOARD)

    def stream(self, now_s: float) -> None:
        """A velocity towards the place over the pad, and with it."""
        if self.position is None:
            return
        place, carried = pad_at(now_s)
        down = -(HIGH_M if now_s < LOW_FROM_S else LOW_M)
        wanted = (place[0], place[1], down)
        # what it has to keep up with, and a bounded approach on top
        velocity = [
            v + min(max(FOLLOW_PER_S * (w - p), -TOP_SPEED_M_S), TOP_SPEED_M_S)
            for v, w, p in zip(carried, wanted, self.position, strict=True)
        ]
        self._send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY, 0, 0, 0, *velocity, 0, 0, 0, 0, 0
            )
        )

    def away_m(self, now_s: float) -> float:
        """How far from the place over the pad the vehicle says it is, level."""
        if self.position is None:
            return math.inf
        place, _ = pad_at(now_s)
        return math.dist(place[:2], self.position[:2])

    def _command(self, number: int, *parameters: float) -> None:
        filled = (*parameters, *(0.0,) * (7 - len(parameters)))
        self._send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))

    def _send(self, message: Any) -> None:
        self._to_vehicle.append(bytes(message.pack(self._mav)))
        self._arrived.set()


PARTS: Final[Methods] = {
    **SITL_METHODS,
    CLIENT: ((SpeedClient, ("write", "stream")),),
    REST: ((Simulation, ("_tick",)),),
}


def pad_at(now_s: float) -> tuple[Vector3, Vector3]:
    """The pad's place and velocity NED, from the scenario."""
    w, r = PAD_SPEED_M_S / PAD_RADIUS_M, PAD_RADIUS_M
    c, s = math.cos(w * now_s), math.sin(w * now_s)
    return (r * c, r * s, 0.0), (-r * w * s, r * w * c, 0.0)


def fly(autopilot_kind: AutopilotKind, seed: int, *, camera: bool) -> SpeedFlight:
    """Serve a vehicle, with or without its camera, and fly it to the end."""
    return run_in_virtual_time(_fly(autopilot_kind, seed, camera=camera))


async def _fly(autopilot_kind: AutopilotKind, seed: int, *, camera: bool) -> SpeedFlight:
    client, clock, frames = SpeedClient(autopilot_kind), Clock(), 0

    def deliver(_frame: Frame) -> None:
        nonlocal frames
        frames += 1

    simulation = Simulation(
        scenario(autopilot_kind),
        seed,
        link=client,
        gps_port=MemoryPort(9600),
        range_port=MemoryPort(9600),
        deliver_frame=deliver,
        camera_wanted=lambda: camera,
    )
    world = asyncio.create_task(simulation.run())
    await clock.sleep_until(READY_S)
    begun_s = _vehicle_s(client)
    client.begin()
    costs: dict[float, float] = {}
    away: dict[str, float] = {}
    highest_m, following = 0.0, False
    while (now_s := clock.now_s()) < END_S:
        started_s = time.process_time()
        for name, (start_s, end_s) in STAGES.items():
            if start_s <= now_s < end_s:
                away[name] = max(away.get(name, 0.0), client.away_m(now_s))
        costs[now_s] = _vehicle_s(client)
        height_m = 0.0 if client.position is None else -client.position[2]
        highest_m = max(highest_m, height_m)
        if not following and height_m > HIGH_M - 0.5:
            following = True
            client.follow()
        # PX4 wants to see a stream before it changes the mode, ArduPilot gives up its take-off for one
        if following or autopilot_kind == "px4":
            client.stream(now_s)
        client.spent_s += time.process_time() - started_s
        await clock.sleep_until(now_s + TALK_S)
    ended_s = _vehicle_s(client)
    world.cancel()
    with suppress(asyncio.CancelledError):
        await world
    stages = {name: _stage(costs, *times) for name, times in STAGES.items()}
    whole = FlightStage(clock.now_s() - READY_S, ended_s - begun_s)
    return SpeedFlight(whole, stages, END_S, frames, highest_m, away)


def _vehicle_s(client: SpeedClient) -> float:
    return time.process_time() - client.spent_s


def _stage(costs: dict[float, float], start_s: float, end_s: float) -> FlightStage:
    inside = [(now_s, cost_s) for now_s, cost_s in costs.items() if start_s <= now_s <= end_s]
    (first_s, first), (last_s, last) = inside[0], inside[-1]
    return FlightStage(last_s - first_s, last - first)
