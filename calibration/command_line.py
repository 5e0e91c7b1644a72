"""What the calibration programs have in common: options, how they end, what day it is, and numbers in a row.

Exit codes: 0 calibrated (or made what was asked for), 1 refused: the line says why, 2 something the user can
mend, reported in one line on standard error, 130 interrupted.
"""

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final, NoReturn

import typer

from companion.base.clock import start_unix_s
from companion.base.command_line import INTERRUPTED, Ending, run_program

REFUSED: Final = 1

ForceOption = Annotated[
    bool, typer.Option("--force", help="Write the file even if it is refused; the file says so.")
]
PlotsOption = Annotated[
    Path | None, typer.Option("--plots", help="Write plots to this folder.", metavar="DIR")
]


class RefusedError(Exception):
    """A calibration that is not good enough to fly by; the text is the one line to show."""


def run(app: typer.Typer, name: str) -> NoReturn:
    """Run a program to its end: whatever the user got wrong ends in one line on standard error.

    Raises:
        SystemExit: always, with the exit code.
    """
    run_program(
        app,
        name,
        endings={RefusedError: Ending(REFUSED, "refused: ")},
        interrupted=Ending(INTERRUPTED, "interrupted; nothing was written"),
    )


def today() -> str:
    """The date and time of a calibration, as its file has it: ISO 8601, UTC."""
    return datetime.fromtimestamp(start_unix_s(virtual=True), UTC).isoformat(timespec="seconds")


def listed(values: Iterable[float], form: str, between: str = " ") -> str:
    """Numbers in one form, one after another."""
    return between.join(format(float(value), form) for value in values)
