"""What the calibration programs have in common: how they end.

Exit codes: 0 calibrated (or made what was asked for), 1 refused: the line says why, 2 something the user can
mend, reported in one line on standard error, 130 interrupted.
"""

from collections.abc import Sequence
from typing import Final, NoReturn

import typer

from companion.base.command_line import INTERRUPTED, USER_ERROR, Ending, run_program

REFUSED: Final = 1
__all__ = ["INTERRUPTED", "REFUSED", "USER_ERROR", "RefusedError", "run"]


class RefusedError(Exception):
    """A calibration that is not good enough to fly by; the text is the one line to show."""


def run(app: typer.Typer, name: str, words: Sequence[str] | None = None) -> NoReturn:
    """Run a program to its end: whatever the user got wrong ends in one line on standard error.

    Raises:
        SystemExit: always, with the exit code.
    """
    run_program(
        app,
        name,
        words,
        endings={RefusedError: Ending(REFUSED, "refused: ")},
        interrupted=Ending(INTERRUPTED, "interrupted; nothing was written"),
    )
