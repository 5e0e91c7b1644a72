"""`companion logs repair`: a log that was cut short becomes a whole file again.

Our own tools read a cut log as it is; others', Foxglove and the seeking reader of the `mcap` package among
them, look for the index at its end.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.files import must_be_readable
from companion.config import ConfigError

HELP: Final = """Repair a flight log that a crash, a kill or a power cut has cut short.

\b
companion logs repair flights/flight-0007
companion logs repair flight.mcap -o whole.mcap
"""
REPAIRED_NAME: Final = "flight-repaired.mcap"


class LogsAction(StrEnum):
    """What to do with a log."""

    REPAIR = "repair"


def logs_command(
    action: Annotated[LogsAction, typer.Argument(help="What to do.", show_default=False)],
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A flight's folder or its flight.mcap.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help=f"The new file; else {REPAIRED_NAME} beside the log.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Carry it out, and say in one line what was saved.

    Raises:
        ConfigError: the log cannot be read, or the new file exists or cannot be written.
    """
    assert action is LogsAction.REPAIR
    source = log / "flight.mcap" if log.is_dir() else log
    must_be_readable(source)
    target = output or source.with_name(REPAIRED_NAME)
    if target.exists():
        raise ConfigError(f"{target}: exists already; expected a new file, by --output")
    from companion.flightlog.repair import repair  # noqa: PLC0415 - the wrong name is told without it

    saved = repair(source, target)
    was = "cut short" if saved.cut else "whole"
    typer.echo(f"{target}: {saved.messages} messages over {saved.seconds:.1f} s; {source} was {was}")
