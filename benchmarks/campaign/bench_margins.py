"""Landings of a vehicle that is not as the app believes, with the bundled autopilots, in virtual time.

    python -m benchmarks margins --seeds 5 --out flights/bench-margins

Every one of them has to land: within 15 cm, at no more than 0.5 m/s down and 0.3 m/s sideways. Give the same
command again after an interruption, and it goes on.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.campaign.bench_landing import fly, landed_share
from benchmarks.campaign.landing_cases import margin_cases, write_flights
from benchmarks.firmware.bench_firmware import line, table
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from sitl.campaign.rows import Row
from sitl.campaign.tables import print_worst

SMOKE: Final = ("--seeds", "1", "--case", "px4-as_believed", "--jobs", "1")
AUTOPILOT_KINDS: tuple[AutopilotKind, ...] = ("px4", "ardupilot")


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="of each scenario")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--case", default="", help="cases whose name begins so, alone: px4-slower")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-margins"))
    options = parser.parse_args(arguments)
    report = BenchReport()
    options.out.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.seeds)
    cases = [
        case
        for autopilot_kind in AUTOPILOT_KINDS
        for case in margin_cases(autopilot_kind, seeds, options.out.resolve())
        if case.name.startswith(options.case)
    ]
    lines, bars, flown = [], [], list[Row]()
    for case in cases:
        rows = fly(write_flights(case, options.out), options.out, options.jobs, report)
        lines.append(line(case.name, rows))
        bars.append(landed_share(case.name, rows, 1.0))
        flown += rows
    report.show(table(lines))
    print_worst(report, flown)
    return report.judge(bars)
