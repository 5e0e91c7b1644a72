"""`companion identify`: its options and help. What reads and fits is imported once the logs are there."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.files import must_exist, unpacked

HELP: Final = """Hover thrust and the autopilot's response, from a recorded flight.

LOG is a flight's folder, its flight.mcap or its exported zip. Prints what it finds with its standard
deviations, and the lines for configs/vehicles and the settings; writes nothing. A number that predicts a
flight worse than the assumed one is withheld.

\b
companion identify flights/circle
companion identify flights/circle --check flights/line

Exit codes: 0 found, 1 a number was withheld, 2 something to correct, or the flight shows nothing.
"""
EXPECTED: Final = "expected a flight's folder, its flight.mcap or its exported zip"


def identify_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The flight.", show_default=False)],
    *,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Another flight, to hold the numbers against.", metavar="LOG"),
    ] = None,
) -> None:
    """Read, fit, judge and show.

    Raises:
        ConfigError: something the user can correct; also when the flight shows nothing at all.
        Exit: with 1 when a number was withheld.
    """
    for path in (log,) if check is None else (log, check):
        must_exist(path, EXPECTED)
    from companion.tools.identify.run import identify_and_show  # noqa: PLC0415 - see above

    with unpacked(log) as flight, nullcontext() if check is None else unpacked(check) as other:
        found = identify_and_show(flight, other)
    raise typer.Exit(0 if found else 1)
