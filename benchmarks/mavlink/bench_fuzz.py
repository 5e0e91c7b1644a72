"""A million random, mutated and senseless MAVLink frames into the simulated vehicle, and a legal stream.

    python -m benchmarks fuzz --frames 1000000

Prints a table and ends in one line that says whether the bar holds: no exception, every legal frame answered,
a heartbeat every second, the vehicle's state finite. The exit status matches.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import Final

from rich.table import Table

from benchmarks.mavlink.fuzzing import Fuzz, FuzzResult
from benchmarks.report import BenchReport, watched
from companion.base.autopilot_kind import AutopilotKind
from companion.base.clock import wall_clock_s

# autopilot_kind, whether it has a key, whether most frames are orders, share of the frames
SMOKE: Final = ("--frames", "300")
RUNS: tuple[tuple[AutopilotKind, bool, bool, float], ...] = (
    ("px4", False, False, 0.35),
    ("ardupilot", False, False, 0.35),
    ("px4", False, True, 0.05),
    ("ardupilot", False, True, 0.05),
    ("px4", True, False, 0.1),
    ("ardupilot", True, False, 0.1),
)
KEY = bytes(range(32))


def table(results: Sequence[tuple[str, FuzzResult]]) -> Table:
    """A row a run."""
    columns = ("vehicle", "frames", "legal", "commands acked UDP", "TCP", "TIMESYNC UDP", "TCP",
               "heartbeats in", "not believed", "state")  # fmt: skip
    made = Table(*columns)
    for name, found in results:
        pairs = [f"{answered} of {sent}" for sent, answered in (*found.commands, *found.times)]
        made.add_row(
            name,
            f"{found.kinds.total()}",
            f"{found.kinds['legal']}",
            *pairs,
            f"{found.heartbeats} in {found.flown_s:.0f} s",
            f"{found.refused}",
            "finite" if found.finite else "NOT FINITE",
        )
    return made


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fire; 0 when the bar holds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    report = BenchReport(width=160)
    began_s = wall_clock_s()
    results = []
    for autopilot_kind, with_key, orders, share in watched(RUNS, "frames"):
        name = autopilot_kind + ", signed" * with_key + ", orders" * orders
        fuzz = Fuzz(autopilot_kind, options.seed, KEY if with_key else None, orders=orders)
        results.append((name, fuzz.run(round(options.frames * share))))
    report.show(table(results))
    kinds: Counter[str] = sum((found.kinds for _, found in results), Counter())
    report.show("kinds: " + ", ".join(f"{kind} {count}" for kind, count in kinds.most_common()))
    report.show(f"{kinds.total()} frames in {wall_clock_s() - began_s:.0f} s, no exception")
    holds = all(found.holds for _, found in results)
    lost = sum(found.lost for _, found in results)
    return report.judge({f"legal stream between {kinds.total()} frames, {lost} lost": holds})
