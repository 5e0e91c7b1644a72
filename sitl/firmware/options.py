"""The command line's options that name a firmware, for every command that flies one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from companion.base.autopilot_kind import AutopilotKind

FirmwareOption = Annotated[
    AutopilotKind | None,
    typer.Option("--firmware", help="Fly the real firmware in lockstep instead of the bundled autopilot."),
]
FirmwarePathOption = Annotated[
    Path | None,
    typer.Option("--firmware-path", help="Its SITL build: the program px4 or arducopter.", metavar="BIN"),
]
FirmwareParamOption = Annotated[
    list[str] | None,
    typer.Option("--firmware-param", help="A parameter of it; may be given often.", metavar="NAME=VALUE"),
]
