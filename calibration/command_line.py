"""What the calibration programs have in common: how they end.

Exit codes: 0 calibrated (or made what was asked for), 1 refused: the line says why, 2 something the user can
mend, told in one line on standard error, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

import typer
from typer.exceptions import TyperException

from companion.config import ConfigError

REFUSED: Final = 1
USER_ERROR: Final = 2
INTERRUPTED: Final = 130


class RefusedError(Exception):
    """A calibration that is not good enough to fly by; the text is the one line to show."""


def run(app: typer.Typer, name: str, words: Sequence[str] | None = None) -> None:
    """Run a program to its end: whatever the user got wrong ends in one line on standard error.

    Raises:
        SystemExit: always, with the exit code.
    """
    try:
        code = app(args=words, standalone_mode=False) or 0
        if code == INTERRUPTED:  # typer has caught it
            raise KeyboardInterrupt
    except TyperException as error:
        code = _fail(name, f"{error.format_message().rstrip('.')}; see {name} --help", USER_ERROR)
    except ConfigError as error:
        code = _fail(name, str(error), USER_ERROR)
    except RefusedError as error:
        code = _fail(name, f"refused: {error}", REFUSED)
    except (KeyboardInterrupt, typer.Abort):
        code = _fail(name, "interrupted; nothing was written", INTERRUPTED)
    sys.exit(code)


def _fail(name: str, text: str, code: int) -> int:
    print(f"{name}: {text}", file=sys.stderr)
    return code
