"""`companion-experiments fig14`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import track as progress

from companion.config import ConfigError
from companion.research.fig14.figure import (
    BY_NAME,
    FlightScore,
    flight_of,
    fly_all,
    judge,
    load_settings,
    paper_step_s,
)
from companion.research.fig14.flight import fly
from companion.research.fig14.pilots import PILOTS
from companion.research.fig14.reference import draw_scene
from companion.research.fig14.report import NOTES, picture, step_line, table

HELP: Final = "MPC, the paper's recursion and PID on one minimum-jerk reference to a moving pad (Fig. 14)."


def fig14(
    seed: Annotated[int, typer.Option(min=0, help="The first seed, and the one in the picture.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = 1,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Where the picture goes.", metavar="FILE.png")
    ] = Path("fig14.png"),
    case: Annotated[str, typer.Option(help=f"In the picture: {'; '.join(BY_NAME)}.")] = "all",
    jobs: Annotated[int, typer.Option(min=1, max=64, help="Processes that fly.")] = 1,
) -> None:
    """MPC, the paper's recursion and PID on one minimum-jerk reference to a moving pad (Fig. 14)."""
    _check(case, output)
    if not _run(range(seed, seed + seeds), output, case, jobs):
        raise typer.Exit(1)


def _check(case: str, output: Path) -> None:
    """Before minutes of flying."""
    if case not in BY_NAME:
        raise ConfigError(f"--case: no '{case}'; expected one of: {'; '.join(BY_NAME)}")
    if output.suffix.lower() != ".png" or not output.parent.is_dir():
        raise ConfigError(f"--output {output}: expected a .png file in a folder that exists")


def _run(seeds: range, output: Path, case: str, jobs: int) -> bool:
    """Fly, print and draw; whether all bars hold."""
    console = Console(width=170)
    results: list[FlightScore] = []
    for flown in progress(fly_all(seeds, jobs), "flying", total=len(seeds), console=Console(stderr=True)):
        results += flown
    console.print(table(results))
    for line in NOTES:
        console.print(line, highlight=False)
    _draw(seeds[0], case, output)
    print(step_line(paper_step_s(seeds[0])))
    print(f"picture: {output}")
    found = judge(results)
    print("bars: " + ", ".join(f"{name} {'holds' if holds else 'FAILS'}" for name, holds in found.items()))
    return all(found.values())


def _draw(seed: int, case: str, path: Path) -> None:
    settings = load_settings()
    world, reference = draw_scene(seed)
    flight = flight_of(settings, world, reference)
    tracks = {pilot: fly(pilot, flight, settings.body, BY_NAME[case]) for pilot in PILOTS}
    picture(path, world, reference, tracks, case)
