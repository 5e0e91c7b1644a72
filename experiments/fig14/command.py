"""`python -m experiments fig14`."""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import must_be_writable
from experiments.fig14 import CASE_NAMES

FIG14_HELP: Final = (
    "MPC, the paper's recursion and PID on one minimum-jerk reference to a moving pad (Fig. 14)."
)


def fig14(
    seed: Annotated[int, typer.Option(min=0, help="The first seed, and the one in the picture.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = 1,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Where the picture goes.", metavar="FILE.png")
    ] = Path("fig14.png"),
    case: Annotated[str, typer.Option(help=f"In the picture: {'; '.join(CASE_NAMES)}.")] = "all",
    jobs: Annotated[int, typer.Option(min=1, max=64, help="Processes that fly.")] = 1,
) -> None:
    """MPC, the paper's recursion and PID on one minimum-jerk reference to a moving pad (Fig. 14)."""
    if case not in CASE_NAMES:
        raise ConfigError(f"--case: no '{case}'; expected one of: {'; '.join(CASE_NAMES)}")
    must_be_writable("--output", output, ".png")
    from experiments.fig14.report import run  # noqa: PLC0415 - minutes of flying, once all is right

    if not run(range(seed, seed + seeds), output, case, jobs):
        raise typer.Exit(1)
