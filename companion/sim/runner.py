"""SITL flights: the app against the bundled simulator, in virtual or in real time.

Virtual (`--fast`): app and simulator share one process and one virtual-time loop, MAVLink goes through an
in-process pipe. Real: the simulator is a process of its own; MAVLink goes over UDP, the serial sensors
over ptys, registers and frames over local sockets. Either way the app cannot tell, and the truth comes out
at the end, for the score.

With an external autopilot (an ArduPilot or PX4 SITL of the user's) that process is the world alone: pad,
camera and ultrasonic about the user's vehicle, whose own sensors the app takes by telemetry.
"""

import asyncio
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.app.app import App, Status
from companion.app.hardware import Hardware, make_actions, make_own_actions, open_hardware
from companion.app.page.live_page import LivePage
from companion.base.clock import Clock, run_in_virtual_time, unix_time_s, wall_clock_s
from companion.base.messages import Phase
from companion.base.signals import run_until_stopped, stopping_on_signals
from companion.config import CompanionConfig, merge, validate
from companion.flightlog.record import FlightLog
from companion.link.signing import signing_of
from companion.link.transport import Transport, memory_pair
from companion.sim.process import SimulatorError, SimulatorProcess
from companion.sim.trial import Trial
from sitl.firmware import FirmwareError
from sitl.run.in_process import InProcess
from sitl.run.process_control import SimulationReport

StatusCallback = Callable[[Status], None]


@dataclass(frozen=True, slots=True)
class SitlFlight:
    """A flight that has ended: what the simulator reports, how fast it ran, how often the app was late."""

    report: SimulationReport
    real_time_factor: float
    late_share: float


def fly(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback, *, fast: bool
) -> SitlFlight:
    """Fly a trial; fast, the same seed gives the same flight. No process is left behind.

    Raises:
        ConfigError: the settings do not go together, or the simulator does not start.
        SimulatorError: the simulator's process, or the firmware that it flies, ended in flight.
    """
    if fast:
        try:
            return run_in_virtual_time(_virtual_flight(config, trial, log, on_status))
        except FirmwareError as error:
            raise SimulatorError(str(error)) from error
    return run_until_stopped(_real_flight(config, trial, log, on_status))


async def _fly(app: App, time_limit_s: float, world: asyncio.Task[None]) -> Phase:
    """Run the app to its end or to the time limit; Ctrl-C and SIGTERM hold, hand back and end.

    `world` goes on for ever; when it fails, so does the flight.
    """
    flight = asyncio.create_task(app.run())
    try:
        with stopping_on_signals(app.request_stop):
            await asyncio.wait([flight, world], timeout=time_limit_s, return_when=asyncio.FIRST_COMPLETED)
        if world.done():
            world.result()
        return flight.result() if flight.done() else app.phase
    finally:
        await _cancel(flight)


async def _cancel(task: asyncio.Task[Any]) -> None:
    """End a task and wait for it; a failure of its own is dropped, since another one is being reported."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


# ---------------------------------------------------------------- virtual time


async def _virtual_flight(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback
) -> SitlFlight:
    app_end, vehicle_end = memory_pair()
    vehicle = InProcess(
        trial.scenario, trial.seed, link=vehicle_end, gps_baud=config.sense.gps.baud, firmware=trial.firmware
    )
    with closing(vehicle.simulation):
        app = App(config, hardware_of(vehicle, app_end, config), log, make_own_actions, on_status)
        started_s = wall_clock_s()
        world = asyncio.create_task(vehicle.simulation.run())
        try:
            phase = await _fly(app, trial.scenario.time_limit_s, world)
        finally:
            await _cancel(world)
        factor = Clock().now_s() / (wall_clock_s() - started_s)
        return SitlFlight(vehicle.simulation.report(phase), factor, app.loop_monitor.late_share)


def hardware_of(vehicle: InProcess, app_end: Transport, config: CompanionConfig) -> Hardware:
    """What the app is plugged into when the vehicle is in this process."""
    boards = config.sense.source == "boards"
    return Hardware(
        app_end,
        vehicle.frames,
        imu_bus=vehicle.imu_bus if boards else None,
        gps_port=vehicle.gps_port if boards else None,
        range_port=None if config.sense.range_by_telemetry else vehicle.range_port,
        signing=signing_of(config.link, unix_time_s()),
    )


# ---------------------------------------------------------------- real time


async def _real_flight(
    config: CompanionConfig, trial: Trial, log: FlightLog, on_status: StatusCallback
) -> SitlFlight:
    with tempfile.TemporaryDirectory(prefix="companion-") as folder:
        simulator = await SimulatorProcess.start(trial, Path(folder))
        try:
            wired = validate(
                CompanionConfig, merge(config.model_dump(), simulator.endpoints), "the simulator's endpoints"
            )
            page = LivePage(wired, log)
            world = asyncio.create_task(simulator.watch())
            try:
                async with open_hardware(wired) as hardware:
                    app = App(wired, hardware, log, make_actions, on_status)
                    async with page.served(app):
                        phase = await _fly(app, trial.time_limit_s, world)
            finally:
                await _cancel(world)
            report = await simulator.finish(phase)
        finally:
            await simulator.kill()
    # both processes count by the same clock of the kernel's
    elapsed_s = Clock().now_s() - report.truth[0].time_s
    return SitlFlight(report, report.duration_s / elapsed_s, app.loop_monitor.late_share)
