"""`companion-sitl view`: its options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError

HELP: Final = "Show (in a browser) or record the frames that a socket serves."
EXPECTED: Final = "expected a program that serves frames"


def view_command(
    socket: Annotated[str, typer.Argument(help="A socket's path, or tcp:HOST:PORT.")],
    *,
    record: Annotated[
        Path | None, typer.Option(help="Record to FILE.mp4, or to a folder of PNG files.", metavar="PATH")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every N-th frame only.", metavar="N")] = 1,
    frames: Annotated[int, typer.Option(min=0, help="End after N frames taken.", metavar="N")] = 0,
    serve: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Show them in a browser, on this port; 0 takes a free one."),
    ] = None,
) -> None:
    """Show or record frames."""
    address = socket if socket.startswith(("socket:", "tcp:")) else f"socket:{socket}"
    if address.startswith("socket:") and not Path(address.removeprefix("socket:")).exists():
        raise ConfigError(f"{address}: No such file or directory; {EXPECTED}")
    from sitl.run.view import ViewOptions, run_view  # noqa: PLC0415 - OpenCV is not for what is not there

    run_view(address, ViewOptions(record, every, frames, serve))
