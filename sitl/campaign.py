"""Many flights: every shipped scenario under several seeds, each through the command a user would type.

    python -m sitl.campaign --seeds 10 --jobs 2

Prints a row a scenario beside the bars and ends in one line that says which hold; the exit status is 0 when
all do. Each flight is a process of its own, so that a campaign measures what a user gets.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

SCENARIOS: Final = ("static", "line", "circle", "figure_8", "heave")
FLIGHT_TIMEOUT_S: Final = 600.0
MEDIAN_LATERAL_M: Final = 0.05
WORST_LATERAL_M: Final = 0.15
VERTICAL_M_S: Final = 0.4
HORIZONTAL_M_S: Final = 0.3
REAL_TIME_FACTOR: Final = 3.0


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight of the campaign; no result when the process failed."""

    scenario: str
    seed: int
    result: dict[str, Any] | None
    words: str

    @property
    def landed(self) -> bool:
        """Whether it landed within its scenario's bounds."""
        return self.result is not None and self.result["outcome"] == "landed"

    @property
    def command(self) -> str:
        """What repeats it."""
        return f"companion --sitl --fast --scenario {self.scenario} --seed {self.seed}"


def fly(scenario: str, seed: int, extra: Sequence[str] = ()) -> Flight:
    """Fly once."""
    with tempfile.TemporaryDirectory(prefix="companion-campaign-") as folder:
        result_path = Path(folder) / "result.json"
        command = (
            *(sys.executable, "-m", "companion.cli", "--sitl", "--fast", "--no-ui"),
            *("--scenario", scenario, "--seed", str(seed), "--json", str(result_path), *extra),
        )
        done = subprocess.run(command, capture_output=True, text=True, timeout=FLIGHT_TIMEOUT_S, check=False)
        words = done.stderr.strip().splitlines()
        result = json.loads(result_path.read_text()) if result_path.exists() else None
        return Flight(scenario, seed, result, words[-1] if words else "")


def fly_all(scenarios: Sequence[str], seeds: Sequence[int], jobs: int) -> Iterator[Flight]:
    """Fly every scenario under every seed; flights come as they end."""
    with ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(fly, scenario, seed) for seed in seeds for scenario in scenarios]
        for future in as_completed(waiting):
            yield future.result()


# ---------------------------------------------------------------- figures


def touchdowns(flights: Sequence[Flight], key: str) -> list[float]:
    """One value of every touchdown, sorted."""
    return sorted(
        abs(flight.result["touchdown"][key])
        for flight in flights
        if flight.result is not None and flight.result["touchdown"] is not None
    )


def row(name: str, flights: Sequence[Flight]) -> tuple[str, ...]:
    """A scenario's line of the table."""
    lateral = touchdowns(flights, "lateral_error_m")
    vertical = touchdowns(flights, "vertical_speed_m_s")
    horizontal = touchdowns(flights, "horizontal_speed_m_s")
    results = [flight.result for flight in flights if flight.result is not None]
    totals = [result["time"]["total_s"] for result in results]
    attitudes = [result["estimate"]["attitude_rmse_deg"] or 0.0 for result in results]
    factors = [result["sim"]["real_time_factor"] for result in results]
    landed = f"{sum(flight.landed for flight in flights)}/{len(flights)}"
    if not lateral:
        return (name, landed, *("-",) * 7)
    return (
        name,
        landed,
        f"{100 * median(lateral):.1f}",
        f"{100 * lateral[-1]:.1f}",
        f"{vertical[-1]:.2f}",
        f"{horizontal[-1]:.2f}",
        f"{median(totals):.0f}",
        f"{max(attitudes):.2f}",
        f"{median(factors):.1f}",
    )


def table(flights: Sequence[Flight]) -> Table:
    """The whole campaign, the bars in the headings."""
    grid = Table(title="Landings in the SITL, rendered, virtual time")
    grid.add_column("scenario")
    for heading in (
        "landed (all)",
        f"lateral median cm (<= {100 * MEDIAN_LATERAL_M:g})",
        f"worst cm (<= {100 * WORST_LATERAL_M:g})",
        f"vertical worst m/s (<= {VERTICAL_M_S:g})",
        f"horizontal worst m/s (<= {HORIZONTAL_M_S:g})",
        "flight s (median)",
        "attitude rms worst °",
        "x real time (median)",
    ):
        grid.add_column(heading, justify="right")
    names = sorted({flight.scenario for flight in flights})
    for name in names:
        grid.add_row(*row(name, [flight for flight in flights if flight.scenario == name]))
    grid.add_section()
    grid.add_row(*row("all", flights))
    return grid


def bars(flights: Sequence[Flight]) -> dict[str, bool]:
    """Which bars hold; the medians for each scenario by itself."""
    by_scenario = [
        [flight for flight in flights if flight.scenario == name]
        for name in sorted({flight.scenario for flight in flights})
    ]
    medians = [median(values) for group in by_scenario if (values := touchdowns(group, "lateral_error_m"))]
    return {
        "all landed": all(flight.landed for flight in flights),
        "lateral median": max(medians, default=1.0) <= MEDIAN_LATERAL_M,
        "lateral worst": max(touchdowns(flights, "lateral_error_m"), default=1.0) <= WORST_LATERAL_M,
        "vertical speed": max(touchdowns(flights, "vertical_speed_m_s"), default=9.0) <= VERTICAL_M_S,
        "horizontal speed": max(touchdowns(flights, "horizontal_speed_m_s"), default=9.0) <= HORIZONTAL_M_S,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(prog="campaign", description=__doc__.split("\n")[0])
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    chosen = parser.parse_args(arguments)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    console = Console()
    flights: list[Flight] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("flights", total=len(chosen.scenarios) * len(seeds))
        for flight in fly_all(chosen.scenarios, seeds, chosen.jobs):
            flights.append(flight)
            progress.advance(task)
            if not flight.landed:
                progress.console.print(f"{flight.command}: {flight.words}", highlight=False, soft_wrap=True)
    console.print(table(flights))
    held = bars(flights)
    words = ", ".join(f"{name} {'holds' if holds else 'FAILS'}" for name, holds in held.items())
    console.print(f"bars: {words}", highlight=False, soft_wrap=True)
    return 0 if all(held.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
