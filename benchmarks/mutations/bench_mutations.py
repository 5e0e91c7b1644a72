"""A million spoilt inputs to drivers, link, settings and scenario files: our own errors alone, flat memory.

    python -m benchmarks mutations --count 1000000 --seed 0

Every target draws from its own generator, seeded by `--seed` and its name. After an exception the target
begins anew with the next seed. Prints a table and ends in one line that says which bars hold.
"""

import argparse
import random
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from rich.table import Table

from benchmarks.mutations.targets import gps, imu, link, texts, trees, ultrasonic
from benchmarks.report import BenchReport, resident_mb
from companion.base.clock import wall_clock_s
from sitl.campaign.tables import Bar, at_most

SMOKE: Final = ("--count", "200")
Target = Callable[[random.Random], Iterator[None]]
# with each target's share of the inputs
TARGETS: Final[dict[str, tuple[Target, float]]] = {
    "IMU registers and FIFO": (imu, 0.3),
    "GPS: NMEA and UBX": (gps, 0.27),
    "ultrasonic": (ultrasonic, 0.2),
    "MAVLink session": (link, 0.2),
    "settings and scenarios, as trees": (trees, 0.02),
    "settings and scenarios, as text": (texts, 0.01),
}
WARM_SHARE: Final = 0.25  # of the inputs, until memory counts
MEMORY_MB: Final = 4.0
SHOWN: Final = 5


@dataclass
class TargetResult:
    """What became of one target."""

    name: str
    inputs: int = 0
    took_s: float = 0.0
    grown_mb: float = 0.0
    failures: list[str] = field(default_factory=list)


def run_target(name: str, target: Target, count: int, seed: int) -> TargetResult:
    """Give a target so many inputs."""
    found, began_s, run = TargetResult(name), wall_clock_s(), 0
    steps = target(random.Random(f"{seed} {name} {run}"))
    warm_mb, warm_at = resident_mb(), max(1, round(WARM_SHARE * count))
    while found.inputs < count:
        found.inputs += 1
        try:
            next(steps)
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(last.filename).name}:{last.lineno}"
            words = f"{type(error).__name__}: {error}".splitlines()[0][:300]
            found.failures.append(f"{name}, seed {seed} {run}, input {found.inputs}: {where}: {words}")
            run += 1
            steps = target(random.Random(f"{seed} {name} {run}"))
        if found.inputs == warm_at:
            warm_mb = resident_mb()
    found.grown_mb = resident_mb() - warm_mb
    found.took_s = wall_clock_s() - began_s
    return found


def table(results: Sequence[TargetResult]) -> Table:
    """A row a target."""
    made = Table("target", "inputs", "exceptions", "memory after a quarter", "time")
    for found in results:
        grown = f"{found.grown_mb:+.1f} MB"
        made.add_row(found.name, f"{found.inputs}", f"{len(found.failures)}", grown, f"{found.took_s:.0f} s")
    return made


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Spoil; 0 when the bars hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", choices=list(TARGETS), help="this one alone")
    options = parser.parse_args(arguments)
    report = BenchReport()
    results = [
        run_target(name, target, round(options.count * share), options.seed)
        for name, (target, share) in TARGETS.items()
        if options.target in {None, name}
    ]
    report.show(table(results))
    for found in results:
        for text in dict.fromkeys(found.failures[:SHOWN]):
            report.show(text)
    failures = sum(len(found.failures) for found in results)
    grown_mb = max(found.grown_mb for found in results)
    inputs = sum(found.inputs for found in results)
    bars = [
        Bar("exceptions that are not ours", f"{failures} of {inputs} inputs", failures == 0),
        at_most("memory, most grown", grown_mb, MEMORY_MB, "MB"),
    ]
    return report.judge(bars)
