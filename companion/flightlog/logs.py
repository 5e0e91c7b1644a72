"""`companion logs`: the recorded flights as a list, one as an archive or as tables, a cut log made whole.

Our own tools read a cut log as it is; others', Foxglove and the seeking reader of the `mcap` package among
them, look for the index at its end.
"""

import zipfile
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from companion.base.files import must_be_readable, replaced
from companion.config import ConfigError

LOGS_HELP: Final = """List the recorded flights; export one, repair its log or convert that to tables.

\b
companion logs --record flights
companion logs export 7
companion logs repair flights/flight-0007
companion logs convert 7 --to parquet

FLIGHT is a number from the list, or the path of a flight's folder. Without --record the flights are those of
the service, in /var/lib/companion, if that is there, and else those in the folder 'flights'.
"""
REPAIRED_NAME: Final = "flight-repaired.mcap"
SERVICE_FLIGHTS: Final = Path("/var/lib/companion")
FLIGHTS: Final = Path("flights")
MEGABYTE: Final = 1_000_000


class LogsAction(StrEnum):
    LIST = "list"
    EXPORT = "export"
    REPAIR = "repair"
    CONVERT = "convert"


def logs_command(
    action: Annotated[LogsAction, typer.Argument(help="What to do.")] = LogsAction.LIST,
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
    """Carry it out, and say in one line what was made.

    Raises:
        ConfigError: there is no such flight, it cannot be read, or the new file exists or cannot be written.
    """
    root = record or (SERVICE_FLIGHTS if SERVICE_FLIGHTS.is_dir() else FLIGHTS)
    if action is LogsAction.LIST:
        if flight is not None or output is not None:
            raise ConfigError("logs list: lists all flights; expected no FLIGHT and no --output")
        list_flights(root)
        return
    if flight is None:
        raise ConfigError(f"logs {action}: which one? Expected a FLIGHT: a number of the list, or a path")
    chosen = find_flight(root, flight)
    if action is LogsAction.EXPORT:
        export(chosen, output)
    elif action is LogsAction.CONVERT:
        convert_log(chosen, output, form)
    else:
        repair_log(chosen, output)


def find_flight(root: Path, flight: str) -> Path:
    """The path that is meant by a number in the list, or by a path.

    Raises:
        ConfigError: there is none.
    """
    from companion.flightlog.flights import number_of, numbered_flights  # noqa: PLC0415 - see the others

    if flight.isdecimal() and not Path(flight).exists():
        for folder in numbered_flights(root):
            if number_of(folder) == int(flight):
                return folder
        raise ConfigError(f"{root}: no flight {flight}; 'companion logs --record {root}' lists what there is")
    return Path(flight)


def list_flights(root: Path) -> None:
    """Print one line a flight, oldest first.

    Raises:
        ConfigError: the folder cannot be read.
    """
    from companion.flightlog.flights import recorded_flights  # noqa: PLC0415 - a wrong name is reported first
    from companion.flightlog.summary import summary_of  # noqa: PLC0415

    try:
        flights = recorded_flights(root)
    except OSError as error:
        raise ConfigError(
            f"--record {root}: cannot be read: {error.strerror}; expected a folder of flights"
        ) from error
    total = 0
    if flights:
        typer.echo(
            f"{'flight':<18} {'began':<16} {'time':>7} {'off the pad':>10} {'size':>8}  outcome", err=True
        )
    for folder in flights:
        try:
            summary = summary_of(folder)
        except (OSError, ValueError, KeyError) as error:
            typer.echo(f"{folder.name:<18} cannot be read: {error}")
            continue
        total += summary.size_bytes
        date = "no date (clock)"
        if summary.start_unix_s is not None:
            date = f"{datetime.fromtimestamp(summary.start_unix_s, UTC):%Y-%m-%d %H:%M}"
        about = "~" if summary.estimated else ""
        error_text = "-" if summary.lateral_m is None else f"{about}{100.0 * summary.lateral_m:.1f} cm"
        cut = ", log cut short" if summary.cut else ""
        typer.echo(
            f"{folder.name:<18} {date:<16} {summary.seconds:5.0f} s {error_text:>10} "
            f"{summary.size_bytes / MEGABYTE:6.0f} MB  {summary.outcome}{cut}"
        )
    count = "1 flight" if len(flights) == 1 else f"{len(flights)} flights"
    typer.echo(f"{count} in {root}, {total / MEGABYTE:.0f} MB; times in UTC; ~: by the pad filter's estimate")


def export(folder: Path, output: Path | None) -> None:
    """Put a flight's folder into one zip file.

    Raises:
        ConfigError: it holds no log, or the file exists or cannot be written.
    """
    must_be_readable(folder / "flight.mcap")
    target = _new(output or Path(f"{folder.resolve().name}.zip"))
    try:
        # the log is compressed already
        with (
            replaced(target) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        ):
            for path in sorted(folder.rglob("*")):
                archive.write(path, Path(folder.resolve().name) / path.relative_to(folder))
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    typer.echo(f"{target}: {target.stat().st_size / MEGABYTE:.1f} MB, all of {folder}")


def convert_log(log: Path, output: Path | None, form: str) -> None:
    """Write a log's topics as tables.

    Raises:
        ConfigError: the log cannot be read, or the tables cannot be written.
    """
    source = _source(log)
    from companion.flightlog.tables import TableFormat, convert  # noqa: PLC0415 - reported first

    folder = output or source.with_name("tables")
    written = convert(source, folder, TableFormat(form))
    typer.echo(f"{folder}: {len(written)} tables, {sum(written.values())} rows of {source}")


def repair_log(log: Path, output: Path | None) -> None:
    """Write a whole file from what can be read of a log.

    Raises:
        ConfigError: the log cannot be read, or the new file exists or cannot be written.
    """
    source = _source(log)
    target = _new(output or source.with_name(REPAIRED_NAME))
    from companion.flightlog.repair import repair  # noqa: PLC0415 - a wrong name is reported without it

    saved = repair(source, target)
    was = "cut short" if saved.cut else "whole"
    typer.echo(f"{target}: {saved.messages} messages over {saved.seconds:.1f} s; {source} was {was}")


def _source(log: Path) -> Path:
    """The file of a flight's folder, or itself, once it is seen to be readable."""
    source = log / "flight.mcap" if log.is_dir() else log
    must_be_readable(source)
    return source


def _new(target: Path) -> Path:
    if target.is_file() or target.is_dir():
        raise ConfigError(f"{target}: exists already; expected a new file, by --output")
    return target
