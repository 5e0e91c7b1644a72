"""Flights on the desk: the app against the bundled simulator, in virtual or in real time.

Virtual (`--fast`): app and simulator share one process and one virtual-time loop, MAVLink goes through an
in-process pipe. Real: the simulator is a process of its own; MAVLink goes over UDP, the serial sensors
over ptys, registers and frames over local sockets. Either way the app cannot tell, and the truth comes out
at the end, for the score.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from companion.app import App, Hardware, Status, make_actions, open_hardware
from companion.clock import Clock, run_in_virtual_time, wall_clock_s
from companion.config import CompanionConfig, ConfigError, merge, validate
from companion.link.actions import PymavlinkActions
from companion.link.transport import memory_pair
from companion.messages import Phase
from companion.record import FlightLog
from sitl.devices.ports import MemoryPort
from sitl.scenario import Scenario
from sitl.simulation import MemoryFrames, Simulation, SimulationReport, read_report

START_TIMEOUT_S: Final = 20.0
END_TIMEOUT_S: Final = 10.0

StatusCallback = Callable[[Status], None]


@dataclass(frozen=True, slots=True)
class DeskFlight:
    """A flight that has ended: what the simulator reports, and how fast it ran."""

    report: SimulationReport
    real_time_factor: float


# ---------------------------------------------------------------- virtual time


def fly_in_virtual_time(
    config: CompanionConfig, scenario: Scenario, seed: int, log: FlightLog, on_status: StatusCallback
) -> DeskFlight:
    """Fly a scenario as fast as the machine can; the same seed gives the same flight.

    Raises:
        ConfigError: the settings do not go together.
    """
    return run_in_virtual_time(_virtual_flight(config, scenario, seed, log, on_status))


async def _virtual_flight(
    config: CompanionConfig, scenario: Scenario, seed: int, log: FlightLog, on_status: StatusCallback
) -> DeskFlight:
    app_end, vehicle_end = memory_pair()
    gps_line, range_line = MemoryPort(config.sense.gps.baud), MemoryPort(config.sense.range.baud)
    frames = MemoryFrames()
    simulation = Simulation(
        scenario,
        seed,
        link=vehicle_end,
        gps_port=gps_line,
        range_port=range_line,
        deliver_frame=frames.deliver,
    )
    hardware = Hardware(app_end, simulation.imu_bus, gps_line.app, range_line.app, frames)
    app = App(config, hardware, log, PymavlinkActions, on_status)
    started_s = wall_clock_s()
    world = asyncio.create_task(simulation.run())
    phase = await _fly(app, scenario.time_limit_s)
    world.cancel()
    with suppress(asyncio.CancelledError):
        await world
    elapsed_s = wall_clock_s() - started_s
    return DeskFlight(simulation.report(phase), Clock().now_s() / elapsed_s)


async def _fly(app: App, time_limit_s: float) -> Phase:
    """Run the app to its end or to the time limit; Ctrl-C and SIGTERM hold, hand back and end."""
    flight = asyncio.create_task(app.run())
    with stopping_on_signals(app.request_stop):
        await asyncio.wait([flight], timeout=time_limit_s)
    if flight.done():
        return flight.result()
    flight.cancel()
    await asyncio.wait([flight])
    return app.phase


@contextmanager
def stopping_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """While inside, SIGINT and SIGTERM call `stop` on the running loop."""
    loop = asyncio.get_running_loop()
    wanted = (signal.SIGINT, signal.SIGTERM)
    for number in wanted:
        loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        for number in wanted:
            loop.remove_signal_handler(number)


# ---------------------------------------------------------------- real time


def fly_in_real_time(
    config: CompanionConfig,
    scenario_path: Path,
    scenario: Scenario,
    seed: int,
    log: FlightLog,
    on_status: StatusCallback,
) -> DeskFlight:
    """Start the simulator as a process and fly against it; no process is left behind.

    Raises:
        ConfigError: the settings do not go together, or the simulator does not start.
    """
    return asyncio.run(_real_flight(config, scenario_path, scenario, seed, log, on_status))


async def _real_flight(
    config: CompanionConfig,
    scenario_path: Path,
    scenario: Scenario,
    seed: int,
    log: FlightLog,
    on_status: StatusCallback,
) -> DeskFlight:
    with tempfile.TemporaryDirectory(prefix="companion-") as folder:
        simulator = await SimulatorProcess.start(scenario_path, seed, Path(folder))
        try:
            wired = with_overrides(config, simulator.endpoints)
            hardware = await open_hardware(wired)
            app = App(wired, hardware, log, make_actions, on_status)
            clock = Clock()
            started_s = clock.now_s()
            try:
                phase = await _fly(app, scenario.time_limit_s)
            finally:
                hardware.close()
            report = await simulator.finish(phase)
            return DeskFlight(report, (report.duration_s) / (clock.now_s() - started_s))
        finally:
            await simulator.kill()


def with_overrides(config: CompanionConfig, overrides: dict[str, Any]) -> CompanionConfig:
    """The same settings with some laid over them."""
    return validate(CompanionConfig, merge(config.model_dump(), overrides), "the simulator's endpoints")


class SimulatorProcess:
    """The simulator running as a child; it dies with its standard input, so it cannot outlive us."""

    def __init__(self, process: asyncio.subprocess.Process, endpoints: dict[str, Any]) -> None:
        self.endpoints = endpoints
        self._process = process

    @classmethod
    async def start(cls, scenario_path: Path, seed: int, folder: Path) -> SimulatorProcess:
        """Start it and wait until it says where it listens.

        Raises:
            ConfigError: it ended or said nothing in time; the line is its own.
        """
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "sitl.server", "--scenario", str(scenario_path)),
            *("--seed", str(seed), "--folder", str(folder)),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            # Ctrl-C is ours to handle: the vehicle is to be flown to a hold before its world ends
            start_new_session=True,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            line = await asyncio.wait_for(process.stdout.readline(), START_TIMEOUT_S)
        except TimeoutError as error:
            process.kill()
            raise ConfigError(f"the simulator said nothing for {START_TIMEOUT_S:g} s") from error
        if not line:
            words = (await process.stderr.read()).decode().strip().splitlines()
            raise ConfigError(f"the simulator did not start: {words[-1] if words else 'no reason given'}")
        return cls(process, json.loads(line))

    async def finish(self, phase: Phase) -> SimulationReport:
        """Have the flight judged and take the report.

        Raises:
            ConfigError: it has crashed or does not answer.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"finish {phase.value}\n".encode())
        line = await asyncio.wait_for(self._process.stdout.readline(), END_TIMEOUT_S)
        if not line:
            raise ConfigError("the simulator ended without a report")
        return read_report(Path(json.loads(line)["report"]))

    async def kill(self) -> None:
        """End it, whatever state it is in."""
        if self._process.returncode is None:
            self._process.kill()
        await self._process.wait()
