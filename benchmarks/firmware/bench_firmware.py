"""Landings on the real PX4 and the real ArduCopter, in lockstep with the bundled world.

    python -m benchmarks firmware --px4 BIN --arducopter BIN --seeds 10

Every seed flies a vehicle about which its builder is wrong (`sitl.scenario.as_built`); with `--as-believed`
it is what the files say, but for the hover thrust, of which the firmware has its own default.

`--out DIR` says where the flights are kept (default: flights/bench-firmware).

BIN is each firmware's SITL build. Give the same command again after an interruption, and it goes on.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final, get_args

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.bench_landing import fly, landed_share, unplanned_bar
from benchmarks.firmware.firmware_cases import CASES, SETPOINTS, FirmwareCase, write_flights
from benchmarks.report import BenchReport
from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError, Kind
from sitl.campaign.figures import Bar, values
from sitl.campaign.rows import Row
from sitl.campaign.tables import print_worst
from sitl.firmware.spec import FirmwareSpec

SMOKE: Final = ("--seeds", "1", "--jobs", "1")
NEEDS: Final = "PX4 or ARDUCOPTER"
LEAST_LANDED: Final = 0.98
AS_BUILT_LANDED: Final = 0.97
CALM_MEDIAN_CM: Final = 5.0
WINDY_MEDIAN_CM: Final = 8.0


def median_bar(name: str, case: FirmwareCase, rows: Sequence[Row]) -> Bar:
    """The bar on a case's median lateral error."""
    limit = WINDY_MEDIAN_CM if case.windy else CALM_MEDIAN_CM
    lateral = values(rows, "touchdown_lateral_m")
    median = 100.0 * float(np.median(lateral)) if lateral else float("inf")
    return Bar(f"{name} lateral p50", f"{median:.1f} (<= {limit:g}) cm", median <= limit)


def line(name: str, rows: Sequence[Row]) -> list[str]:
    """A row of the table."""
    columns = ("touchdown_lateral_m", "vertical_speed_m_s", "horizontal_speed_m_s")
    figures = [values(rows, column) for column in columns]
    cells = [
        f"{factor * float(np.median(v)):.{digits}f} {factor * max(v):.{digits}f}" if v else "-"
        for v, factor, digits in zip(figures, (100.0, 1.0, 1.0), (1, 2, 2), strict=True)
    ]
    ends = ", ".join(sorted({row.outcome for row in rows if not row.landed}))
    return [name, f"{sum(row.landed for row in rows)}/{len(rows)}", *cells, ends]


def table(lines: Sequence[Sequence[str]]) -> Table:
    """All lines."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("firmware, setpoint, case", no_wrap=True)
    for heading in ("landed", "lateral cm\np50 worst", "down m/s\np50 worst", "sideways m/s\np50 worst"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("other ends")
    for cells in lines:
        shown.add_row(*cells)
    return shown


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--px4", type=Path, help="the program px4")
    parser.add_argument("--arducopter", type=Path, help="the program arducopter")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--case", default="", help="cases whose name begins so, alone")
    parser.add_argument(
        "--setpoint", choices=get_args(Kind), default="", help="this kind alone, instead of those shipped"
    )
    parser.add_argument(
        "--sensors",
        choices=("boards", "autopilot"),
        default="boards",
        help="IMU, compass and GPS of whom the app flies by",
    )
    parser.add_argument("--as-believed", action="store_true", help="vehicles that are as their files say")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=Path("flights/bench-firmware"))
    options = parser.parse_args(arguments)
    paths: dict[AutopilotKind, Path | None] = {"px4": options.px4, "ardupilot": options.arducopter}
    specs = [spec for kind, path in paths.items() if path and (spec := FirmwareSpec.of(kind, path))]
    if not specs:
        raise ConfigError("bench-firmware: expected --px4 BIN, --arducopter BIN or both")
    return judge(specs, options, BenchReport())


def judge(specs: Sequence[FirmwareSpec], options: argparse.Namespace, report: BenchReport) -> BenchReport:
    """Fly what has no row yet."""
    options.out.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.seeds)
    cases = tuple(case for case in CASES if case.name.startswith(options.case))
    kinds = [
        (spec, setpoint)
        for spec in specs
        for setpoint in ((options.setpoint,) if options.setpoint else SETPOINTS[spec.kind])
    ]
    as_built = not options.as_believed
    flights = [
        flight
        for spec, setpoint in kinds
        for flight in write_flights(
            spec, setpoint, options.sensors, cases, seeds, options.out, as_built=as_built
        )
    ]
    report.show(f"{len(flights)} flights")
    rows = fly(flights, options.out, options.jobs, report)
    lines, bars = [], []
    for spec, setpoint in kinds:
        of_kind: list[Row] = []
        for case in cases:
            name = case.title(spec.kind, setpoint, options.sensors, as_built=as_built)
            of_case = [row for row in rows if row.scenario == name]
            of_kind += of_case
            lines.append(line(name, of_case))
            bars.append(median_bar(name, case, of_case))
        least = AS_BUILT_LANDED if as_built else LEAST_LANDED
        bars.append(landed_share(f"{spec.kind} {setpoint} landed", of_kind, least))
        bars.append(unplanned_bar(f"{spec.kind} {setpoint}", of_kind))
    report.show(table(lines))
    print_worst(report, rows)
    return report.judge(bars)
