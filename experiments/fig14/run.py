"""Figure 14: the flights, the table, the picture and the bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track as progress

from experiments.fig14.figure import (
    BY_NAME,
    FlightScore,
    flight_of,
    fly_all,
    judge,
    load_settings,
    paper_step_s,
)
from experiments.fig14.flight import fly
from experiments.fig14.pilots import PILOTS
from experiments.fig14.reference import draw_scene
from experiments.fig14.report import NOTES, picture, step_line, table


def run(seeds: Sequence[int], output: Path, case: str, jobs: int) -> bool:
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
