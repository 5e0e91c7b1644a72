"""Options that the subcommands of `calibrate-mount` share, and what is seen before heavy imports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import DEFAULT_SETTINGS

NAME: Final = "calibrate-mount"
ConfigOption = Annotated[Path, typer.Option("--config", help="The app's settings.", metavar="FILE")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", help="File to write.", metavar="FILE")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Write the file even if it is refused; the file says so.")
]
SETTINGS: Final = DEFAULT_SETTINGS


def check_output(path: Path) -> None:
    """Make sure before the work that its result can be written after it.

    Raises:
        ConfigError: it cannot.
    """
    if path.is_dir() or not path.parent.is_dir():
        raise ConfigError(f"-o {path}: expected a file in an existing folder")
