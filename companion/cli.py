"""`companion`: flies on the vehicle, or on the desk against the bundled simulator.

Exit codes: 0 landed within the bounds (on the vehicle: landed and disarmed), 1 the simulator failed,
2 something the user can mend, 3 missed, 4 aborted, 5 timeout, 6 crashed.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import cv2
import typer
from rich.console import Console
from typer.exceptions import TyperException

from companion.app.app import App
from companion.app.hardware import make_actions, open_hardware
from companion.app.terminal import StatusView
from companion.base.clock import start_unix_s
from companion.base.files import write_atomically
from companion.base.messages import Outcome, Phase
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, load_config
from companion.flightlog.record import FlightLog
from companion.flightlog.replay.command import HELP as REPLAY_HELP
from companion.flightlog.replay.command import replay_command
from companion.flightlog.report import result_table, write_plots
from companion.flightlog.result import Result, from_start
from companion.sim.external import External
from companion.sim.flights import HELP as FLIGHTS_HELP
from companion.sim.flights import reason, score, serve_flights
from companion.sim.runner import (
    DeskFlight,
    SimulatorError,
    Trial,
    calibrations_left_out,
    desk_settings,
    fly,
    stopping_on_signals,
)
from companion.tools.check.command import HELP as CHECK_HELP
from companion.tools.check.command import check_command
from companion.tools.fuzzy.command import HELP as FUZZY_HELP
from companion.tools.fuzzy.command import fuzzy_command
from companion.tools.identify import HELP as IDENTIFY_HELP
from companion.tools.identify import identify_command
from companion.tools.pads.command import HELP as PAD_HELP
from companion.tools.pads.command import pad_command
from sitl.firmware.options import FirmwareOption, FirmwareParamOption, FirmwarePathOption
from sitl.firmware.spec import FirmwareSpec

USER_ERROR: Final = 2
SIMULATOR_FAILED: Final = 1
EXIT_CODES: Final = {
    Outcome.LANDED: 0,
    Outcome.MISSED: 3,
    Outcome.ABORTED: 4,
    Outcome.TIMEOUT: 5,
    Outcome.CRASHED: 6,
}
# a simulator in real time that falls behind by this much hands out frames and samples too late to fly by
LATE_S: Final = 0.1
# and an app whose cycles come late more often than this has no time for its samples either
LATE_SHARE: Final = 0.01

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
cli.command("replay", help=REPLAY_HELP, short_help="Run the estimators again over a log.")(replay_command)
cli.command("identify", help=IDENTIFY_HELP, short_help="How the vehicle answers, from a flight.")(
    identify_command
)
cli.command("check", help=CHECK_HELP, short_help="Check before a first flight, held by hand.")(check_command)
cli.command("fuzzy", help=FUZZY_HELP, short_help="Show the fuzzy pilot, its rules and its table.")(
    fuzzy_command
)
cli.command("pad", help=PAD_HELP, short_help="Check and print a pad; how a camera sees it.")(pad_command)


@cli.callback(invoke_without_command=True)
def companion(
    context: typer.Context,
    *,
    sitl: Annotated[bool, typer.Option("--sitl", help="Fly against the bundled simulator.")] = False,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = CONFIG_FOLDER / "companion.yaml",
    scenario: Annotated[
        str | None,
        typer.Option("--scenario", help="With --sitl: a name in configs/scenarios, or a file; else 'line'."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="With --sitl: repeats a flight; else 0.")
    ] = None,
    fast: Annotated[
        bool, typer.Option("--fast", help="With --sitl: in virtual time, as fast as the machine can.")
    ] = False,
    autopilot: Annotated[
        str | None,
        typer.Option("--autopilot", help="With --sitl: 'external' flies your own ArduPilot or PX4 SITL."),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            help="Where that is: udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT.",
            metavar="CONNECTION",
        ),
    ] = None,
    connect_world: Annotated[
        str | None,
        typer.Option(
            "--connect-world",
            help="Another connection to it for the simulated world; else the two share one.",
            metavar="CONNECTION",
        ),
    ] = None,
    firmware: FirmwareOption = None,
    firmware_path: FirmwarePathOption = None,
    firmware_param: FirmwareParamOption = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="With --sitl: write the result here.", metavar="FILE")
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", help="Leave logs (and plots) in this folder.", metavar="DIR")
    ] = None,
    no_ui: Annotated[bool, typer.Option("--no-ui", help="No live status; one line a notice.")] = False,
) -> None:
    """Land a multirotor softly on a pad that moves, by eye."""
    prepare_opencv()
    if context.invoked_subcommand is not None:
        alone(context)
        return
    output = Output(Console(), record, json_file, live=not no_ui)
    try:
        theirs = {"--autopilot": autopilot, "--connect": connect, "--connect-world": connect_world}
        if sitl:
            flown = FirmwareSpec.of(firmware, firmware_path, firmware_param or ())
            trial = Trial.load(scenario or "line", seed or 0, External.of(theirs, fast=fast), flown)
            code = fly_on_the_desk(config, trial, output, fast=fast)
        else:
            ours = {
                "--scenario": scenario,
                "--seed": seed,
                "--fast": fast or None,
                "--firmware": firmware,
                "--firmware-path": firmware_path,
                "--firmware-param": firmware_param,
                "--json": json_file,
            }
            refuse({**ours, **theirs})
            code = fly_the_vehicle(config, output)
    except ConfigError as error:
        code = fail(str(error), USER_ERROR)
    except SimulatorError as error:
        code = fail(str(error), SIMULATOR_FAILED)
    raise typer.Exit(code)


@cli.command("flights", help=FLIGHTS_HELP, hidden=True)
def flights() -> None:
    """Fly many in one process, for a campaign."""
    serve_flights()


def prepare_opencv() -> None:
    """One thread, so that detection does not take the cores from the control loop, and repeats exactly."""
    cv2.setNumThreads(1)
    # what OpenCV has to say about a camera that is not there, we say ourselves
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


@dataclass(frozen=True, slots=True)
class Output:
    """Where a flight shows itself and leaves its files."""

    console: Console
    record: Path | None
    json_file: Path | None
    live: bool


def fail(text: str, code: int) -> int:
    """Say in one line on standard error what went wrong; returns the exit code."""
    print(f"companion: {text}", file=sys.stderr)
    return code


def alone(context: typer.Context) -> None:
    """Refuse options of a flight before the name of another command.

    Raises:
        ConfigError: there is one.
    """
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            name, other = parameter.opts[0], context.invoked_subcommand
            raise ConfigError(f"{name}: belongs to a flight; expected it without '{other}'")


def refuse(options: Mapping[str, object]) -> None:
    """Refuse options that need the simulator.

    Raises:
        ConfigError: one of them was given.
    """
    for name, value in options.items():
        if value is not None:
            raise ConfigError(f"{name}: needs --sitl; the vehicle flies in real time, with no truth to score")


# ---------------------------------------------------------------- on the desk


def fly_on_the_desk(config_path: Path, trial: Trial, output: Output, *, fast: bool) -> int:
    """Fly a scenario, show and write its result, and return the exit code.

    Raises:
        ConfigError: something the user can mend.
        SimulatorError: the simulator's process failed.
    """
    settings = desk_settings(config_path, trial, fast=fast)
    if left_out := calibrations_left_out(config_path, settings):
        output.console.print(f"left out, for the simulated vehicle is another: {', '.join(left_out)}")
    writable(output.json_file)
    log = new_log(output.record, virtual=fast)
    title = f"{trial.scenario.name}, seed {trial.seed}"
    try:
        with StatusView(output.console, title, live=output.live) as view:
            flight = fly(settings, trial, log, view, fast=fast)
        for record in flight.report.truth:
            log.write("truth", record, record.time_s)
    except ConfigError:
        log.discard()
        raise
    finally:
        log.close()
    result = score(trial, flight, log)
    publish(trial, result, flight, output)
    if output.record is not None:
        kept, truth = from_start(log.kept, flight.report.truth)
        write_plots(output.record, kept, truth, trial.scenario.obstacles)
        output.console.print(f"logs and plots in {output.record}", highlight=False, soft_wrap=True)
    return EXIT_CODES[result.outcome]


def publish(trial: Trial, result: Result, flight: DeskFlight, output: Output) -> None:
    """Write the result, print the table, and say in one line what was wrong if something was."""
    text = result.model_dump_json(indent=2) + "\n"
    if output.json_file is not None:
        write_atomically(output.json_file, text)
    if output.record is not None:
        write_atomically(output.record / "result.json", text)
    output.console.print(result_table(result, trial.scenario.pass_bounds.model_dump()))
    nearest_m = flight.report.nearest_obstacle_m
    if nearest_m is not None:
        output.console.print(f"nearest to an obstacle: {nearest_m:.2f} m from the rotors' tips")
    late_s = flight.report.latest_tick_s
    if late_s > LATE_S:
        print(
            f"companion: the simulator ran up to {late_s:.1f} s late: too busy a machine for real time",
            file=sys.stderr,
        )
    elif flight.late_share > LATE_SHARE:
        print(
            f"companion: {100.0 * flight.late_share:.0f} % of the control cycles came late: "
            "too busy a machine for real time",
            file=sys.stderr,
        )
    if result.outcome is not Outcome.LANDED:
        fail(f"{result.outcome}: {reason(result, flight)}", EXIT_CODES[result.outcome])


# ---------------------------------------------------------------- on the vehicle


def fly_the_vehicle(config_path: Path, output: Output) -> int:
    """Fly the real vehicle and return the exit code.

    Raises:
        ConfigError: something the user can mend.
    """
    config = load_config(config_path)
    folder = None if output.record is None else next_flight_folder(output.record)
    log = new_log(folder, virtual=False)
    try:
        with StatusView(output.console, config.vehicle, live=output.live) as view:
            phase = asyncio.run(_vehicle_flight(config, log, view))
    except ConfigError:
        log.discard()
        raise
    finally:
        log.close()
    return 0 if phase is Phase.LANDED else EXIT_CODES[Outcome.ABORTED]


async def _vehicle_flight(config: CompanionConfig, log: FlightLog, view: StatusView) -> Phase:
    async with open_hardware(config) as hardware:
        app = App(config, hardware, log, make_actions, view)
        with stopping_on_signals(app.request_stop):
            return await app.run()


def next_flight_folder(folder: Path) -> Path:
    """A new folder for this flight: numbered, since a Raspberry Pi may not know the date."""
    names = [path.name.removeprefix("flight-") for path in folder.glob("flight-*")]
    return folder / f"flight-{max((int(n) for n in names if n.isdecimal()), default=0) + 1:04d}"


# ---------------------------------------------------------------- files


def new_log(folder: Path | None, *, virtual: bool) -> FlightLog:
    """A log in a folder that has none yet.

    Raises:
        ConfigError: the folder holds a flight already, or cannot be written.
    """
    if folder is not None and (folder / "flight.mcap").exists():
        raise ConfigError(f"--record {folder}: holds a flight already; expected a new or empty folder")
    return FlightLog(folder, start_unix_s=start_unix_s(virtual=virtual))


def writable(path: Path | None) -> None:
    """Make sure before the flight that its result can be written after it.

    Raises:
        ConfigError: it cannot.
    """
    if path is None:
        return
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ConfigError(f"--json {path}: cannot be written; expected a file in an existing folder")


def main() -> None:
    """Entry point: whatever the user got wrong ends in one line on standard error."""
    try:
        code = cli(standalone_mode=False)
    except TyperException as error:
        code = fail(f"{error.format_message().rstrip('.')}; see companion --help", USER_ERROR)
    except ConfigError as error:
        code = fail(str(error), USER_ERROR)
    except typer.Abort:
        code = fail("aborted: interrupted outside a flight", EXIT_CODES[Outcome.ABORTED])
    sys.exit(code)


if __name__ == "__main__":
    main()
