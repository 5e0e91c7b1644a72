"""Landings by the hundred, beside the bars and beside the strongest peer.

    python -m benchmarks landing --runs 200 --out flights/bench-landing

Flies random landings (rendered, virtual time), the same by vehicles that are not what their builders believe
(as built), then the cases in which ArduCopter's own precision landing was measured on the real firmware. Give
the same command again after an interruption, and it goes on. The time to land is from taking the pad up to
disarmed.
"""

import argparse
import os
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.landing_cases import (
    LandingCase,
    as_built_landings,
    peer_cases,
    random_landings,
    write_flights,
)
from benchmarks.report import BenchReport
from companion.config import ConfigError
from sitl.campaign.manifest import CampaignRun, code_digest
from sitl.campaign.rows import Row, RunsFile, make_row, pending
from sitl.campaign.run import CampaignMeter
from sitl.campaign.tables import Bar, at_most, print_worst, share, values
from sitl.campaign.worker import fly_locally

# measured on the real firmware: landed (%), median lateral error (cm), vertical speed (m/s), time (s)
SMOKE: Final = ("--runs", "1", "--seeds", "0", "--case", "random", "--jobs", "1")
PEER: Final = {"line": "100 %, 1-2 cm, 0.47 m/s, 20 s", "turn": "0 % (0.56 m behind)", "wind": "20 to 60 %"}
PEER_TIME_S: Final = 20.0


def kind_of(name: str) -> str:
    """What the bars of a peer's case are: line, turn or wind."""
    return "wind" if name.endswith("wind_8") else "line" if name.startswith("line") else "turn"


def fly(flights: Sequence[CampaignRun], folder: Path, jobs: int, report: BenchReport) -> list[Row]:
    """Fly what has no row in the folder yet; returns the rows of the flights asked for."""
    version, runs = code_digest(), RunsFile(folder)
    with closing(runs):
        if any(row.version != version for row in runs.rows):
            raise ConfigError(f"{runs.path}: flown by another version of the program; expected a new --out")
        wanted = {(flight.scenario, flight.seed) for flight in flights}
        left = pending(flights, runs.rows)
        done = [row for row in runs.rows if (row.scenario, row.seed) in wanted]
        if left:
            with (
                closing(fly_locally(left, jobs)) as ended,
                CampaignMeter(report, done, len(flights), quiet=False) as meter,
            ):
                for flown in ended:
                    runs.append(make_row(flown, version))
                    meter.take(runs.rows[-1])
        return [row for row in runs.rows if (row.scenario, row.seed) in wanted]


def _percentile(rows: Sequence[Row], column: str, percent: float) -> float:
    sizes = values(rows, column)
    return float(np.percentile(sizes, percent)) if sizes else float("inf")


def _seconds(rows: Sequence[Row]) -> float:
    landed = [
        row.approach_s + row.descent_s for row in rows if row.approach_s and row.descent_s and row.landed
    ]
    return median(landed) if landed else float("inf")


def landed_share(name: str, rows: Sequence[Row], least: float) -> Bar:
    """A bar on the share that landed."""
    hits = sum(row.landed for row in rows)
    return Bar(name, f"{hits} of {len(rows)} (>= {100 * least:g} %)", hits >= least * len(rows) > 0)


def lateral_bars(name: str, rows: Sequence[Row], landed: float, p95_cm: float) -> list[Bar]:
    """Bars of drawn landings: so large a share lands, near the pad's centre."""
    lateral_cm = [100.0 * _percentile(rows, "touchdown_lateral_m", percent) for percent in (50, 95)]
    return [
        landed_share(f"{name} landed", rows, landed),
        unplanned_bar(name, rows),
        at_most(f"{name} lateral p50", lateral_cm[0], 3.0, "cm", 2),
        at_most(f"{name} lateral p95", lateral_cm[1], p95_cm, "cm", 2),
    ]


def random_bars(rows: Sequence[Row]) -> list[Bar]:
    """Bars of the random landings."""
    vertical_m_s = _percentile(rows, "vertical_speed_m_s", 50)
    return [*lateral_bars("random", rows, 0.99, 8.0), at_most("vertical p50", vertical_m_s, 0.2, "m/s", 2)]


def unplanned_bar(name: str, rows: Sequence[Row]) -> Bar:
    """No contact before the landing, and none harder than allowed."""
    contacts = sum(row.unplanned_contacts or 0 for row in rows)
    return Bar(f"{name} unplanned contacts", str(contacts), contacts == 0)


def as_built_bars(rows: Sequence[Row]) -> list[Bar]:
    """Bars of the landings as built."""
    return lateral_bars("as built", rows, 0.97, 10.0)


def peer_bars(name: str, rows: Sequence[Row]) -> list[Bar]:
    """Bars of one of the peer's cases."""
    if kind_of(name) != "line":
        return [landed_share(name, rows, 0.95)]
    return [
        landed_share(name, rows, 1.0),
        at_most(f"{name} lateral p50", 100.0 * _percentile(rows, "touchdown_lateral_m", 50), 2.0, "cm", 2),
        at_most(f"{name} vertical p50", _percentile(rows, "vertical_speed_m_s", 50), 0.25, "m/s", 2),
        at_most(f"{name} time p50", _seconds(rows), PEER_TIME_S, "s", 2),
    ]


def table(groups: dict[str, list[Row]]) -> Table:
    """A line a case."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("case", no_wrap=True)
    for heading in ("landed", "95 % interval", "lateral cm\np50 p95 worst", "vertical m/s\np50 p95 worst"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("horizontal m/s\np50 worst", justify="right", no_wrap=True)
    shown.add_column("s p50", justify="right")
    shown.add_column("real ArduCopter", no_wrap=True)
    for name, rows in groups.items():
        hits = share(sum(row.landed for row in rows), len(rows))
        lateral = [100.0 * _percentile(rows, "touchdown_lateral_m", p) for p in (50, 95, 100)]
        vertical = [_percentile(rows, "vertical_speed_m_s", p) for p in (50, 95, 100)]
        horizontal = [_percentile(rows, "horizontal_speed_m_s", p) for p in (50, 100)]
        shown.add_row(
            name,
            f"{hits.hits}/{hits.of}",
            f"{100 * hits.low:.1f} to {100 * hits.high:.1f} %",
            " ".join(f"{v:.1f}" for v in lateral),
            " ".join(f"{v:.2f}" for v in vertical),
            " ".join(f"{v:.2f}" for v in horizontal),
            f"{_seconds(rows):.1f}",
            "" if name.startswith(("random", "as_built")) else PEER[kind_of(name)],
        )
    return shown


def by_motion(case: LandingCase, rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The random landings by the pad's motion, and all."""
    kinds = {content["name"]: content["pad"]["motion"]["kind"] for content, _ in case.flights}
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(f"{case.name}, {kinds[row.scenario]}", []).append(row)
    return {**dict(sorted(groups.items())), case.name: list(rows)}


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="random landings")
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--seeds", type=int, default=20, help="of each of the peer's cases")
    parser.add_argument("--case", default="", help="cases whose name begins so, alone")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-landing"))
    options = parser.parse_args(arguments)
    report = BenchReport()
    drawn = (random_landings(options.runs, options.first), as_built_landings(options.runs, options.first))
    cases, drawn_bars = (
        (*drawn, *peer_cases(options.seeds)),
        {"random": random_bars, "as_built": as_built_bars},
    )
    groups: dict[str, list[Row]] = {}
    bars: list[Bar] = []
    options.out.mkdir(parents=True, exist_ok=True)
    for case in (case for case in cases if case.flights and case.name.startswith(options.case)):
        report.show(f"{case.name}: {len(case.flights)} flights")
        rows = fly(write_flights(case, options.out), options.out, options.jobs, report)
        groups |= by_motion(case, rows) if case.name in drawn_bars else {case.name: rows}
        bars += drawn_bars[case.name](rows) if case.name in drawn_bars else peer_bars(case.name, rows)
    report.show(table(groups))
    print_worst(report, [row for name, rows in groups.items() if "," not in name for row in rows])
    return report.judge(bars)
