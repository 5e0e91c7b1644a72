"""`companion`: flies on the vehicle, or on the desk against the bundled simulator.

Exit codes: 0 landed within the bounds (on the vehicle: landed and disarmed), 2 something the user can mend,
3 missed, 4 aborted, 5 timeout, 6 crashed.
"""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Annotated, Any, Final

import cv2
import typer
from rich.console import Console

from companion.app import App, make_actions, open_hardware
from companion.clock import start_unix_s
from companion.config import CONFIG_FOLDER, CompanionConfig, ConfigError, find_file, load_config
from companion.desk import DeskFlight, fly_in_real_time, fly_in_virtual_time, stopping_on_signals
from companion.messages import Phase
from companion.record import FlightLog
from companion.report import result_table, write_plots
from companion.result import Result, build_result
from companion.terminal import StatusView
from sitl.scenario import Scenario, load_scenario

USER_ERROR: Final = 2
EXIT_CODES: Final = {"landed": 0, "missed": 3, "aborted": 4, "timeout": 5, "crashed": 6}

cli = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@cli.command()
def companion(
    *,
    sitl: Annotated[bool, typer.Option("--sitl", help="Fly against the bundled simulator.")] = False,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = CONFIG_FOLDER / "companion.yaml",
    scenario: Annotated[
        str, typer.Option("--scenario", help="With --sitl: a name in configs/scenarios, or a file.")
    ] = "line",
    seed: Annotated[int, typer.Option("--seed", min=0, help="With --sitl: repeats a flight.")] = 0,
    fast: Annotated[
        bool, typer.Option("--fast", help="With --sitl: in virtual time, as fast as the machine can.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="With --sitl: write the result here.", metavar="FILE")
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", help="Leave logs (and plots) in this folder.", metavar="DIR")
    ] = None,
    no_ui: Annotated[bool, typer.Option("--no-ui", help="No live status; one line a notice.")] = False,
) -> None:
    """Land a multirotor softly on a pad that moves, by eye."""
    # one thread for OpenCV: detection must not take the cores from the control loop, and repeats exactly
    cv2.setNumThreads(1)
    console = Console(stderr=False)
    try:
        if sitl:
            code = fly_on_the_desk(
                console, config, scenario, seed, fast=fast, json_file=json_file, record=record, no_ui=no_ui
            )
        else:
            only_on_the_desk(fast=fast, json_file=json_file)
            code = fly_the_vehicle(console, config, record, no_ui=no_ui)
    except ConfigError as error:
        print(f"companion: {error}", file=sys.stderr)
        raise typer.Exit(USER_ERROR) from None
    raise typer.Exit(code)


def only_on_the_desk(*, fast: bool, json_file: Path | None) -> None:
    """Refuse options that need the simulator.

    Raises:
        ConfigError: one of them was given without --sitl.
    """
    for name, given in (("--fast", fast), ("--json", json_file is not None)):
        if given:
            raise ConfigError(
                f"{name}: needs --sitl; the vehicle flies in real time and has no truth to score"
            )


# ---------------------------------------------------------------- on the desk


def fly_on_the_desk(
    console: Console,
    config_path: Path,
    scenario_name: str,
    seed: int,
    *,
    fast: bool,
    json_file: Path | None,
    record: Path | None,
    no_ui: bool,
) -> int:
    """Fly a scenario, show and write its result, and return the exit code.

    Raises:
        ConfigError: something the user can mend.
    """
    scenario_path = find_file("scenarios", scenario_name)
    scenario = load_scenario(scenario_path)
    settings = desk_settings(config_path, scenario, fast=fast)
    writable(json_file)
    log = new_log(record, virtual=fast)
    try:
        with StatusView(console, f"{scenario.name}, seed {seed}", live=not no_ui) as view:
            if fast:
                flight = fly_in_virtual_time(settings, scenario, seed, log, view)
            else:
                flight = fly_in_real_time(settings, scenario_path, scenario, seed, log, view)
        for truth in flight.report.truth:
            log.write("truth", truth, truth.time_s)
    finally:
        log.close()
    result = score(scenario, seed, flight, log)
    publish(console, scenario, result, flight, log, json_file, record)
    return EXIT_CODES[result.outcome]


def desk_settings(config_path: Path, scenario: Scenario, *, fast: bool) -> CompanionConfig:
    """The app's settings for a scenario: the file, and what the scenario's operator knows over it.

    Raises:
        ConfigError: the file or the scenario's overrides are wrong.
    """
    overrides: dict[str, Any] = dict(scenario.companion)
    if fast:
        # MAVSDK has threads and a clock of its own; the same actions by our own messages in virtual time
        overrides["link"] = {**overrides.get("link", {}), "actions": "pymavlink"}
    return load_config(config_path, overrides)


def score(scenario: Scenario, seed: int, flight: DeskFlight, log: FlightLog) -> Result:
    """The result contract of a flight."""
    report = flight.report
    return build_result(
        scenario=scenario.name,
        seed=seed,
        outcome=report.outcome,
        touchdown=report.touchdown,
        pad_speed_m_s=report.pad_speed_m_s,
        kept=log.kept,
        truth=report.truth,
        real_time_factor=flight.real_time_factor,
    )


def publish(
    console: Console,
    scenario: Scenario,
    result: Result,
    flight: DeskFlight,
    log: FlightLog,
    json_file: Path | None,
    record: Path | None,
) -> None:
    """Write the files, print the table, and say in one line what was wrong if something was."""
    text = result.model_dump_json(indent=2) + "\n"
    if json_file is not None:
        write_atomically(json_file, text)
    if record is not None:
        write_atomically(record / "result.json", text)
        write_plots(record, log.kept, flight.report.truth)
    console.print(result_table(result, scenario.pass_bounds.model_dump()))
    if record is not None:
        console.print(f"logs and plots in {record}", highlight=False)
    if result.outcome != "landed":
        print(f"companion: {result.outcome}: {'; '.join(flight.report.failures)}", file=sys.stderr)


# ---------------------------------------------------------------- on the vehicle


def fly_the_vehicle(console: Console, config_path: Path, record: Path | None, *, no_ui: bool) -> int:
    """Fly the real vehicle and return the exit code.

    Raises:
        ConfigError: something the user can mend.
    """
    config = load_config(config_path)
    log = new_log(None if record is None else next_flight_folder(record), virtual=False)
    try:
        with StatusView(console, config.vehicle, live=not no_ui) as view:
            phase = asyncio.run(_vehicle_flight(config, log, view))
    finally:
        log.close()
    return 0 if phase is Phase.LANDED else EXIT_CODES["aborted"]


async def _vehicle_flight(config: CompanionConfig, log: FlightLog, view: StatusView) -> Phase:
    hardware = await open_hardware(config)
    try:
        app = App(config, hardware, log, make_actions, view)
        with stopping_on_signals(app.request_stop):
            return await app.run()
    finally:
        hardware.close()


def next_flight_folder(folder: Path) -> Path:
    """A new folder for this flight: numbered, since a Raspberry Pi may not know the date."""
    numbers = [int(path.name.removeprefix("flight-")) for path in folder.glob("flight-[0-9]*")]
    return folder / f"flight-{max(numbers, default=0) + 1:04d}"


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


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that nobody ever sees half of it."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def main() -> None:
    """Entry point."""
    cli()


if __name__ == "__main__":
    main()
