"""Command-line options that every served vehicle has: where its clients find it."""

from __future__ import annotations

from typing import Annotated, Final

import typer

LOOPBACK: Final = "127.0.0.1"
COMPANION_PORT: Final = 14540
GROUND_PORT: Final = 14550
TCP_PORT: Final = 5760

PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port where companions listen; 0: they call a free one.")
]
GroundPortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port where ground stations listen; 0: likewise.")
]
TcpPortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="TCP port for several clients; 0 takes a free one.")
]
