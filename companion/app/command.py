"""`companion` on the vehicle: standing by for orders, or one flight, from the settings to the exit code."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from companion.app.app import App, supervised
from companion.app.hardware import Hardware, make_actions, open_hardware
from companion.app.page.live_page import LivePage
from companion.app.service.latch import FlightLatch, state_folder, unattended
from companion.app.service.local_socket import served, socket_path
from companion.app.service.state_report import (
    ComputerWatch,
    StateReport,
    ground_report,
    state_report,
    throttled,
)
from companion.app.terminal import StatusView
from companion.base.clock import Clock, start_unix_s, unix_time_s
from companion.base.errors import ConfigError
from companion.base.messages import Outcome, Phase
from companion.base.signals import run_until_stopped, signals_held_back, stopping_on_signals
from companion.config import CompanionConfig, ServeConfig, load_config, merge, validate
from companion.flightlog.flights import make_room, next_flight_folder
from companion.flightlog.flights_recorder import FlightsRecorder
from companion.flightlog.record import FlightLog
from companion.sense.vision.opencv import prepare_opencv

GROUND_REPORT_S: Final = 1.0
EXIT_CODES: Final = {
    Outcome.LANDED: 0,
    Outcome.MISSED: 3,
    Outcome.ABORTED: 4,
    Outcome.TIMEOUT: 5,
    Outcome.CRASHED: 6,
}


@dataclass(frozen=True, slots=True)
class Output:
    """Where a flight shows itself and leaves its files."""

    record: Path | None
    json_file: Path | None
    live: bool
    serve: str | None = None  # the live page's address, over that of the settings
    console: Console = field(default_factory=Console)

    def shown(self, config: CompanionConfig) -> CompanionConfig:
        """The settings with the live page where the options want it."""
        if self.serve is None:
            return config
        page = merge(config.serve.model_dump(), {"address": self.serve})
        return config.model_copy(update={"serve": validate(ServeConfig, page, "--serve")})


def fly_the_vehicle(config_path: Path, output: Output) -> int:
    """Fly the real vehicle once, at once, and return the exit code."""
    prepare_opencv()
    config = output.shown(load_config(config_path))
    must_fly(config, f"--fly: {config_path}")
    if not config.plan.mission.may_arm:
        raise ConfigError(
            f"--fly: {config_path}: plan.mission.may_arm is false; "
            "expected true, which allows the app to arm and take off"
        )
    latch = FlightLatch(output.record or state_folder())
    folder = None if output.record is None else next_flight_folder(output.record)
    _make_room(output.record, config)
    with signals_held_back():
        log = new_log(folder, virtual=False, keeps=False)  # nothing on board scores the flight
        try:
            standby = latch.refusal(unattended=unattended())
            with StatusView(output.console, config.vehicle, live=output.live) as view:
                phase, idle = run_until_stopped(_vehicle_flight(config, log, view, latch, standby))
        except KeyboardInterrupt:  # before there was an app to hand anything back
            log.discard()
            raise
        except ConfigError:
            log.discard()
            latch.end("by an error in the settings")
            raise
        finally:
            log.close()
    latch.end(phase.value)
    return 0 if phase is Phase.LANDED or idle else EXIT_CODES[Outcome.ABORTED]


def must_fly(config: CompanionConfig, where: str) -> None:
    if config.control.output == "landing_target":
        raise ConfigError(f"{where}: control.output landing_target flies nothing; expected setpoints")


async def _vehicle_flight(
    config: CompanionConfig, log: FlightLog, view: StatusView, latch: FlightLatch, standby: str | None
) -> tuple[Phase, bool]:
    page = LivePage(config, log)
    async with open_hardware(config, waits=True, state=latch.folder) as hardware:
        app = App(config, hardware, log, make_actions, view, standby=standby)
        with stopping_on_signals(app.request_stop):
            if standby is None:
                latch.begin()
            async with page.served(app):
                return await app.run(), standby is not None and app.missions.stopped_idle


def stand_by(config_path: Path, output: Output) -> int:
    """Stand by on the real vehicle until stopped, following orders; returns the exit code."""
    prepare_opencv()
    config = output.shown(load_config(config_path))
    clear = partial(_make_room, output.record, config)
    clear()
    with signals_held_back(), StatusView(output.console, config.vehicle, live=output.live) as view:
        log = FlightsRecorder(output.record, partial(start_unix_s, virtual=False), clear)
        try:
            return run_until_stopped(_service(config, log, view, output.record))
        finally:
            log.close()


async def _service(
    config: CompanionConfig, log: FlightsRecorder, view: StatusView, record: Path | None
) -> int:
    clock = Clock()
    start_s = clock.now_s()
    machine, page = ComputerWatch(start_s), LivePage(config, log)
    async with open_hardware(config, waits=True, state=record or state_folder()) as hardware:
        app = App(config, hardware, log, make_actions, view, stays=True)

        async def report() -> StateReport:
            held_back = await asyncio.to_thread(throttled)
            now_s = clock.now_s()
            state = machine.state(now_s, record, held_back)
            return state_report(app, log.meter, state, log, now_s, start_s)

        async def report_json() -> str:
            return (await report()).model_dump_json()

        tell = partial(_tell_ground, app, hardware, log, record, start_s, report)
        telling = asyncio.create_task(
            supervised("ground report", tell, app.announcer.notify, lambda: False), name="ground report"
        )
        try:
            with stopping_on_signals(app.request_stop):
                async with served(socket_path(), report_json, app.missions.give, clock), page.served(app):
                    phase = await app.run()
        finally:
            telling.cancel()
    done = phase is Phase.LANDED or app.missions.stopped_idle
    return 0 if done else EXIT_CODES[Outcome.ABORTED]


async def _tell_ground(
    app: App,
    hardware: Hardware,
    log: FlightsRecorder,
    record: Path | None,
    start_s: float,
    report: Callable[[], Awaitable[StateReport]],
) -> None:
    """The computer's state, for the log and (ONBOARD_COMPUTER_STATUS) ground stations; ours when asked."""
    clock = Clock()
    watch = ComputerWatch(clock.now_s())
    while True:
        await asyncio.sleep(GROUND_REPORT_S)
        now_s = clock.now_s()
        state = watch.state(now_s, record)
        log.write("computer", state, now_s)
        message = ground_report(state, record, unix_time_s(), now_s - start_s)
        if app.session.state.connected and not app.loop_monitor.silent:
            data = app.session.encode(message)
            hardware.transport.write(data)
            log.write_mavlink(data, now_s, "out")
        if app.session.orders.take_question():
            said = await report()
            app.announcer.notify("status", said.words, "warning" if said.problems else "info")


def _make_room(record: Path | None, config: CompanionConfig) -> None:
    """Remove the oldest flights. Tidying decides no start: a card damaged or too small gets a line."""
    try:
        if record is not None and record.is_dir():
            make_room(record, 1e6 * config.record.total_mb, 1e6 * config.record.free_mb)
    except (OSError, ConfigError) as error:
        print(f"companion: {record}: not enough room was made: {error}", file=sys.stderr)


def new_log(folder: Path | None, *, virtual: bool, keeps: bool = True) -> FlightLog:
    """A log in a folder that has none yet; `keeps`: for a score, what that reads stays in memory."""
    if folder is not None and (folder / "flight.mcap").exists():
        raise ConfigError(f"--record {folder}: holds a flight already; expected a new or empty folder")
    return FlightLog(folder, start_unix_s=start_unix_s(virtual=virtual), virtual=virtual, keeps=keeps)
