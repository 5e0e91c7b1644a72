"""`companion`: flies on the vehicle, or against the bundled simulator.

Exit codes: 0 landed within the bounds (on the vehicle: landed and disarmed), 1 the simulator failed,
2 something the user can correct, 3 missed, 4 aborted, 5 timeout, 6 crashed, 130 interrupted before a flight.

Only the options are here. What flies is imported once they are right, since OpenCV, OSQP, MAVSDK and the
rest take seconds to import on a Raspberry Pi (`companion.base.command_line`).
"""

import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.command_line import Command, VersionOption, lazy_app, run_program
from companion.base.errors import ConfigError
from companion.base.files import DEFAULT_SETTINGS, find_file, must_be_readable
from sitl.commands import FirmwareOption, FirmwareParamOption, FirmwarePathOption

PROGRAM: Final = "companion"
FLIGHTLOG, TOOLS = "companion.flightlog.commands", "companion.tools.commands"
COMMANDS: Final = {
    "replay": Command(f"{FLIGHTLOG}:replay_command", "Run the estimators again over a log."),
    "identify": Command(f"{TOOLS}:identify_command", "Identify the vehicle's response from a flight."),
    "check": Command(
        f"{TOOLS}:check_command", "Check everything before a flight; --pad: sensors and axes, by hand."
    ),
    "detect": Command(f"{TOOLS}:detect_command", "Find the pad in your own photos and videos."),
    "fuzzy": Command(f"{TOOLS}:fuzzy_command", "Show the fuzzy speed controller, its rules and table."),
    "pad": Command(f"{TOOLS}:pad_command", "Check and print a pad; show how a camera sees it."),
    "logs": Command(f"{FLIGHTLOG}:logs_command", "List, export, convert, repair flight logs."),
    "settings": Command(
        "companion.tools.settings:settings_command", "Explain settings: unit, default, meaning."
    ),
    "setup": Command(f"{TOOLS}:setup_command", "Switch on what the wiring needs, on a Raspberry Pi."),
    "status": Command("companion.app.service.commands:status_command", "Show what the running service does."),
    "order": Command("companion.app.service.commands:order_command", "Order the service to land, fly, stop."),
    "permit": Command("companion.app.service.latch:permit_command", "Let the next start of the app fly."),
    "report": Command(f"{FLIGHTLOG}:report_command", "Write a flight's report as one page."),
    "flights": Command(
        "companion.sim.flights:flights_command", "Fly many in one process, for a campaign.", hidden=True
    ),
}
SERVE_ADDRESS: Final = "127.0.0.1:8080"
cli = lazy_app(COMMANDS, alone={"--serve": SERVE_ADDRESS})


@cli.callback(invoke_without_command=True)
def companion(
    context: typer.Context,
    *,
    sitl: Annotated[bool, typer.Option("--sitl", help="Fly against the bundled simulator.")] = False,
    flies: Annotated[
        bool, typer.Option("--fly", help="Fly once, now: arm, take off, land. Else stand by for orders.")
    ] = False,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = DEFAULT_SETTINGS,
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
    serve: Annotated[
        str | None,
        typer.Option(
            "--serve",
            help=f"Serve the live page there; alone: {SERVE_ADDRESS}.",
            metavar="[ADDRESS:PORT]",
        ),
    ] = None,
    no_ui: Annotated[bool, typer.Option("--no-ui", help="No live status; one line a notice.")] = False,
    version: VersionOption = False,
) -> None:
    """Land a multirotor by vision, softly, on a pad that moves."""
    if context.invoked_subcommand is not None:
        alone(context)
        return
    theirs = {"--autopilot": autopilot, "--connect": connect, "--connect-world": connect_world}
    if sitl and flies:
        raise ConfigError("--fly: is for the vehicle; expected it without --sitl, which flies at once")
    if fast and serve is not None:
        raise ConfigError("--serve: shows a flight in real time; expected it without --fast")
    if sitl:
        find_file("scenarios", "line" if scenario is None else scenario)
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
    must_be_readable(config)
    from companion.app.command import Output, fly_the_vehicle, stand_by  # noqa: PLC0415 - see above

    output = Output(record, json_file, live=not no_ui, serve=serve)
    if not sitl:
        raise typer.Exit((fly_the_vehicle if flies else stand_by)(config, output))
    from companion.sim.command import fly_in_sitl, load_trial  # noqa: PLC0415 - see above

    flown = (firmware, firmware_path, firmware_param)
    trial = load_trial("line" if scenario is None else scenario, seed or 0, theirs, flown, fast=fast)
    raise typer.Exit(fly_in_sitl(config, trial, output, fast=fast))


def alone(context: typer.Context) -> None:
    """Refuse options of a flight before the name of another command."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            name, other = parameter.opts[0], context.invoked_subcommand
            raise ConfigError(f"{name}: belongs to a flight; expected it without '{other}'")


def refuse(options: Mapping[str, object]) -> None:
    """Refuse options that need the simulator."""
    for name, value in options.items():
        if value is not None:
            raise ConfigError(f"{name}: needs --sitl; the vehicle flies in real time, with no truth to score")


def main() -> None:
    """Entry point: whatever the user got wrong ends in one line on standard error."""
    # before numpy is imported: our matrices are small, and threads that wait for one another only cost
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        run_program(cli, PROGRAM)
    except SystemExit as end:
        if threading.active_count() > 1:
            from companion.base.signals import leave_drivers  # noqa: PLC0415 - see above

            leave_drivers(int(end.code or 0))
        raise


if __name__ == "__main__":
    main()
