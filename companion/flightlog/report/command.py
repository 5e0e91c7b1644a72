"""`companion report`: a flight's folder in, one page out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.files import must_be_readable, unpacked
from companion.config import ConfigError
from companion.flightlog.log_file import LOG_NAMES, log_file

REPORT_HELP: Final = """\
Write a flight's report: one HTML page with verdict, events, plots to zoom and pictures.

The page needs no network and no other file, so it can be sent by mail.

\b
companion report flights/circle
companion report flights/flight-0007 -o flight.html
companion report flight-0007.zip
"""
EXPECTED: Final = "a flight's folder, its flight.mcap or its exported zip"
NO_PLOTLY: Final = "needs plotly; expected it installed: pip install plotly"


def report_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A flight's folder, its flight.mcap or exported zip.", show_default=False
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The page; else report.html in the folder.", metavar="FILE"),
    ] = None,
) -> None:
    """Read the flight, write the page and say where it is.

    Raises:
        ConfigError: there is no flight, plotly is missing, or the page cannot be written.
    """
    with unpacked(folder) as flight:
        file = log_file(flight)
        must_be_readable(file)
        if file.name != LOG_NAMES[0]:
            raise ConfigError(f"{folder}: another file; expected {EXPECTED}")
        beside = (
            None if flight == folder else folder.with_suffix(".html")
        )  # of a zip file, which stays as it is
        typer.echo(write_report(file.parent, output or beside))


def write_report(folder: Path, output: Path | None = None, bounds: Mapping[str, float] | None = None) -> Path:
    """Write the page of a flight; `bounds`: what passes, by the touchdown's keys.

    Raises:
        ConfigError: there is no flight, plotly is missing, or the page cannot be written.
    """
    try:
        from companion.flightlog.report.page import PAGE_NAME, write_page  # noqa: PLC0415 - may be left out
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "plotly":
            raise
        raise ConfigError(f"the report {NO_PLOTLY}") from None
    from companion.flightlog.report.logged_flight import read_flight  # noqa: PLC0415 - reported first

    path = output or folder / PAGE_NAME
    write_page(read_flight(folder), path, bounds)
    return path
