"""`companion permit`: the operator's word that the next start may fly."""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.app.service.latch import FlightLatch, LatchState, state_folder

HELP: Final = """Let the next start of the app fly.

After a crash, a kill or a power cut, and whenever it is not started at a terminal, the app stays in standby
until this was said. It holds for one start, for an hour, and until the computer starts anew.
"""


def permit_command(
    record: Annotated[
        Path | None,
        typer.Option("--record", help="The folder that the app records to, if it does.", metavar="DIR"),
    ] = None,
) -> None:
    """Write the permission, and say what stood there.

    Raises:
        ConfigError: the folder cannot be written to.
    """
    latch = FlightLatch(record or state_folder())
    state, words = latch.read()
    latch.permit()
    before = {
        LatchState.NONE: "no flight before",
        LatchState.PERMITTED: "permitted already",
        LatchState.TAKEN: "a start took the last permission, and has begun no flight",
        LatchState.BEGUN: "the last flight never ended",
        LatchState.ENDED: f"the last flight ended: {words}",
        LatchState.UNREADABLE: "the file could not be read",
    }[state]
    typer.echo(f"{latch.path}: the next start may fly ({before})")
