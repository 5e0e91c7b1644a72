"""The app against an autopilot that is not the bundled one, in virtual time: our own simulator plays it.

Three parties, as with a real ArduPilot or PX4 SITL: a vehicle whose ground stops it dead and knows no pad,
the external world that watches its true pose, and the app, which takes the vehicle's sensors by telemetry.
They share one loop; pipes within the process take the place of sockets.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Final

from companion.app.app import App
from companion.app.hardware import Hardware, make_own_actions
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import run_in_virtual_time
from companion.config import CONFIG_FOLDER
from companion.flightlog.record import FlightLog
from companion.flightlog.result import Result
from companion.link.transport import MemoryTransport, memory_pair
from companion.sim.runner import SitlFlight
from companion.sim.scoring import score
from companion.sim.settings import sitl_settings
from companion.sim.trial import External, Trial
from sitl.devices.ports import MemoryPort
from sitl.external.session import ExternalConnections, ExternalSimulation
from sitl.run.in_process import RANGE_BAUD, MemoryFrames
from sitl.run.simulation import Simulation
from sitl.scenario.scenario import Scenario, load_scenario
from tests.beside import beside

SPEC: Final = "udp:127.0.0.1:1"  # nobody connects: the pipes are there already
_FOUND_TIMEOUT_S: Final = 20.0


@dataclass
class ExternalFlight:
    """A flight that has ended: its result, and what the app told."""

    result: Result
    told: list[str]

    def __str__(self) -> str:
        return "\n".join([str(self.result.outcome), str(self.result.touchdown), *self.told])


class _Relay(MemoryTransport):
    has_peer = False  # the app has a connection of its own


class _Frames(MemoryFrames):
    client_count = 1


def vehicles_world(kind: AutopilotKind) -> Scenario:
    """Where the vehicle flies: flat ground, its own simulator's pad being far away and flush with it."""
    static = load_scenario("static")
    motion = static.pad.motion.model_copy(
        update={"meet": static.pad.motion.meet.model_copy(update={"point_ned_m": (-100.0, 0.0)})}
    )
    pad = static.pad.model_copy(update={"surface_height_m": 0.0, "motion": motion})
    return static.model_copy(update={"autopilot": kind, "pad": pad, "wind": static.wind})


def fly_external(scenario: str, seed: int, kind: AutopilotKind) -> ExternalFlight:
    """Fly a scenario's pad around a vehicle of that make."""
    return run_in_virtual_time(_fly(scenario, seed, kind))


async def _fly(name: str, seed: int, kind: AutopilotKind) -> ExternalFlight:
    trial = Trial.load(name, seed, external=External(SPEC, SPEC))
    settings = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    log = FlightLog(None, start_unix_s=0.0)
    async with _world(trial, kind) as (world, app_end, frames, range_port):
        hardware = Hardware(app_end, frames, imu_bus=None, gps_port=None, range_port=range_port.app)
        app = App(settings, hardware, log, make_own_actions, lambda _status: None)
        async with beside(app.run()) as (flight,):
            await asyncio.wait([flight], timeout=trial.time_limit_s)
            phase = flight.result() if flight.done() else app.phase
        report = world.report(phase)
    result = score(trial, SitlFlight(report, 1.0, app.loop_monitor.late_share), log)
    return ExternalFlight(result, [f"{event.time_s:.1f} {event.text}" for event in result.events])


@asynccontextmanager
async def _world(
    trial: Trial, kind: AutopilotKind
) -> AsyncIterator[tuple[ExternalSimulation, MemoryTransport, _Frames, MemoryPort]]:
    """The vehicle with the world around it, once that has found it; the app's ends of both."""
    app_end, vehicle_end = memory_pair()
    world_end, truth_end = memory_pair()
    _, relay = _Relay(0.002), _Relay(0.002)
    range_port, frames = MemoryPort(RANGE_BAUD), _Frames()
    vehicle = Simulation(
        vehicles_world(kind), trial.seed, link=vehicle_end, gps_port=MemoryPort(9600),
        range_port=MemoryPort(RANGE_BAUD), deliver_frame=lambda _frame: None, camera_wanted=lambda: False,
        serve_truth=True,
    )  # fmt: skip
    connections = ExternalConnections(world_end, relay, range_port, frames)
    world = ExternalSimulation(trial.scenario, trial.seed, connections, lambda _text: None)
    async with beside(vehicle.run(), vehicle.line.serve(truth_end), world.run()):
        await asyncio.wait_for(world.ready.wait(), _FOUND_TIMEOUT_S)
        yield world, app_end, frames, range_port
