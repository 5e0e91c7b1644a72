"""`companion logs`, `report` and `replay`: their options and their help.

What does the work, and takes long to import, is imported once the files are seen to be there.
"""
# ruff: noqa: PLC0415 - see above

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from companion.base.errors import ConfigError
from companion.base.files import must_be_readable, must_exist, unpacked
from companion.flightlog.flights import number_of, numbered_flights
from companion.flightlog.log_file import LOG_NAMES, REPAIRED_NAME, find_log

# ---------------------------------------------------------------- companion logs

LOGS_HELP: Final = """List the recorded flights; export one, repair its log or convert that to tables.

\b
companion logs --record flights
companion logs export 7
companion logs repair flights/flight-0007
companion logs convert 7 --to parquet

FLIGHT is a number or a name from the list, or the path of a flight's folder. Without --record the flights are
those of the service, in /var/lib/companion, if that is there, and else those in the folder 'flights'.
"""
SERVICE_FLIGHTS: Final = Path("/var/lib/companion")
FLIGHTS: Final = Path("flights")


def logs_command(
    action: Annotated[
        Literal["list", "export", "repair", "convert"], typer.Argument(help="What to do.")
    ] = "list",
    flight: Annotated[
        str | None,
        typer.Argument(
            metavar="FLIGHT",
            help="Which one, for all but list; repair and convert also take a flight.mcap.",
            show_default=False,
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", help="Where the flights are.", metavar="DIR")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help=f"What is made; else NAME.zip here, or {REPAIRED_NAME} or tables/ beside the log.",
            metavar="PATH",
        ),
    ] = None,
    form: Annotated[
        Literal["csv", "parquet"], typer.Option("--to", help="What to convert to.", metavar="csv|parquet")
    ] = "csv",
) -> None:
    root = record or flights_folder()
    if action == "list" and (flight is not None or output is not None):
        raise ConfigError("logs list: lists all flights; expected no FLIGHT and no --output")
    if action != "list" and flight is None:
        raise ConfigError(f"logs {action}: which one? Expected a FLIGHT: a number of the list, or a path")
    chosen = root if flight is None else find_flight(root, flight, chosen=record is not None)
    if action == "export":
        must_be_readable(chosen / LOG_NAMES[0], "the folder of a flight")
    elif flight is not None:
        chosen = find_log(chosen)
    from companion.flightlog import logs

    if flight is None:
        logs.list_flights(root)
    elif action == "export":
        logs.export(chosen, output)
    elif action == "convert":
        logs.convert_log(chosen, output, form)
    else:
        logs.repair(chosen, output)


def flights_folder() -> Path:
    """Where flights are recorded, if nothing else is said: by the service, or here."""
    return SERVICE_FLIGHTS if SERVICE_FLIGHTS.is_dir() else FLIGHTS


def find_flight(root: Path, flight: str, *, chosen: bool = False) -> Path:
    """The path that is meant by a number or a name in the list, or by a path.

    Where the root was `chosen`, its names come before paths from here.
    """
    path, named = Path(flight), root / flight
    if named.is_dir() and (chosen or not path.exists()):
        return named
    if path.exists():
        return path
    if not flight.isdecimal():
        return path
    for folder in numbered_flights(root):
        if number_of(folder) == int(flight):
            return folder
    raise ConfigError(f"{root}: no flight {flight}; 'companion logs --record {root}' lists what there is")


# ---------------------------------------------------------------- companion report

REPORT_HELP: Final = """\
Write a flight's report: one HTML page with verdict, events, plots to zoom and pictures.

The page needs no network and no other file, so it can be sent by mail.

\b
companion report flights/circle
companion report 7
companion report flights/flight-0007 -o flight.html
companion report flight-0007.zip
"""


def report_command(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT",
            help="A number or name of 'companion logs', a flight's folder, its flight.mcap or exported zip.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="The page; else report.html in the folder, NAME.html beside another file.",
            metavar="FILE",
        ),
    ] = None,
) -> None:
    if output is not None and output.suffix.lower() not in {".html", ".htm"}:
        raise ConfigError(f"--output {output}: expected the page's name, as {output.stem}.html")
    path = find_flight(flights_folder(), str(path))
    with unpacked(path) as flight:
        from companion.flightlog.report import write_report

        beside = None if flight == path else path.with_suffix(".html")  # a zip file stays as it is
        typer.echo(write_report(flight, output or beside))


# ---------------------------------------------------------------- companion replay

REPLAY_HELP: Final = """Run the estimators again over a recorded log, and hold them against what was recorded.

LOG is a number or a name of 'companion logs', a flight's folder, its flight.mcap or exported zip, an
ArduPilot .bin, or a PX4 .ulg.

\b
companion replay flights/circle
companion replay flights/circle --config mine.yaml -o compared
companion replay 00000042.BIN
"""


def replay_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The log.", show_default=False)],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Leave replay.json and plots here; else in replay/NAME.", metavar="DIR"
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Other settings than the flight's own.", metavar="FILE")
    ] = None,
) -> None:
    log = find_flight(flights_folder(), str(log))
    must_exist(log, "expected a flight's folder, flight.mcap or zip, an ArduPilot .bin or a PX4 .ulg")
    if config is not None:
        must_be_readable(config)
    from companion.flightlog.replay.job import replay_and_show

    with unpacked(log) as flight:
        replay_and_show(flight, output, config)
