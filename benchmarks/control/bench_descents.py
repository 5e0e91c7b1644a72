"""What the speed law is worth: descents of random landings by the fuzzy speed controller and by fixed speeds.

    python -m benchmarks descents --runs 100 --out flights/bench-descents

Each landing (those of `bench_landing`) flies up to where the pad is taken up once, and from there on by each
law in a process of its own, all else equal to the bit. Rows go to the folder as they end; the same command
goes on. The bar: the fuzzy speed controller is down to 0.6 m in at most 0.8 of the time of the quickest fixed
speed that touches down as softly and as near the centre. POSIX alone.
"""

import argparse
import asyncio
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.landing_cases import random_landings
from benchmarks.report import BenchReport, watched
from companion.app import stages
from companion.base.messages import Conditions, Phase, PlanStep
from companion.config import ConfigError, PlanConfig
from companion.flightlog.record import FlightLog
from companion.flightlog.result import from_start
from companion.plan.speed.laws import SpeedController, load_speed_controller
from companion.sense.vision.opencv import prepare_opencv
from companion.sim.runner import fly
from companion.sim.scoring import score
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from experiments.flown import SETTINGS, EndedFlight
from experiments.profiles import Descent, measure
from sitl.campaign.manifest import code_digest
from sitl.campaign.tables import Bar
from sitl.scenario.scenario import Scenario

SMOKE: Final = ("--runs", "1")
FUZZY: Final = "fuzzy"
PACED: Final = "fuzzy, by conditions"
FIXED_M_S: Final = (0.9, 1.6, 3.0)
QUICKER: Final = 0.8  # of the best fixed speed's time
AS_GOOD: Final = 1.05  # what is still an equal touchdown
FIGURES: Final = ("landed", "down_s", "seconds", "jerk_m_s3", "contact_m_s", "lateral_contact_m")
Row = dict[str, Any]


class Switch:
    """The law that flies; each branch of a landing puts its own."""

    def __init__(self, laws: Mapping[str, SpeedController]) -> None:
        """Fly by the first of them."""
        self._laws = laws
        self.name = next(iter(laws))

    def __call__(self, distance_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Average speed V (m/s)."""
        return self._laws[self.name].law(distance_m, velocity_m_s, acceleration_m_s2)

    def pace(self, conditions: Conditions) -> float:
        """Factor on V."""
        return self._laws[self.name].pace(conditions)

    def branch(self) -> bool:
        """Go on by each law in a process of its own; True in those, False where all have ended."""
        loop = asyncio._get_running_loop()
        for name in self._laws:
            child = os.fork()
            if child == 0:
                asyncio._set_running_loop(loop)
                self.name = name
                return True
            os.waitpid(child, 0)
        return False


class Branching(FlightLog):
    """A log in memory that branches the flight where the approach begins."""

    def __init__(self, law: Switch) -> None:
        """`law` is what the flight goes by."""
        super().__init__(None, start_unix_s=0.0)
        self._law = law
        self.branched = False

    def write(self, topic: str, message: Any, time_s: float) -> None:
        """Keep a message, and look for the approach."""
        super().write(topic, message, time_s)
        if not self.branched and isinstance(message, PlanStep) and message.phase is Phase.APPROACH:
            self.branched = True
            if not self._law.branch():
                os._exit(0)


def laws() -> dict[str, SpeedController]:
    """The fuzzy speed controller first, then at the pace of the conditions, then the fixed speeds."""
    fixed = {f"fixed {v:g} m/s": {"speed_law": "fixed", "fixed_speed_m_s": v} for v in FIXED_M_S}
    settings: dict[str, dict[str, Any]] = {FUZZY: {}, PACED: {"pace": True}, **fixed}
    return {name: load_speed_controller(PlanConfig.model_validate(words)) for name, words in settings.items()}


def fly_landing(number: int, rows: Path) -> None:
    """Fly one landing by all laws, a row each; one that never sees its pad is a row without a law."""
    ((content, seed),) = random_landings(1, number).flights
    scenario = Scenario.model_validate(content)
    trial = Trial(Path(f"{scenario.name}.yaml"), scenario, seed)
    prepare_opencv()
    os.environ["OMP_NUM_THREADS"] = "1"  # no fork takes along what computes beside the loop
    law = Switch(laws())
    log = Branching(law)
    controller = SpeedController(law, law.pace)
    with mock.patch.object(stages, "load_speed_controller", return_value=controller):
        flight = fly(sitl_settings(SETTINGS, trial, fast=True), trial, log, lambda _status: None, fast=True)
    result = score(trial, flight, log)
    kept, truth = from_start(log.kept, flight.report.truth)
    flown = measure(EndedFlight(result, truth, kept, scenario.place), law.name if log.branched else "")
    with rows.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row_of(flown, number)) + "\n")


def row_of(flown: Descent, number: int) -> Row:
    """What is kept of a descent."""
    return {"number": number, "law": flown.law, **{name: getattr(flown, name) for name in FIGURES}}


def fly_all(numbers: Sequence[int], rows: Path) -> None:
    """Fly what has no rows yet, each landing in a process of its own."""
    flown = {row["number"] for row in read_rows(rows)}
    left = [number for number in numbers if number not in flown]
    for number in watched(left, "landings"):
        child = os.fork()
        if child == 0:
            try:
                fly_landing(number, rows)
            finally:
                os._exit(0)
        os.waitpid(child, 0)


def read_rows(path: Path) -> list[Row]:
    """The rows so far."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def figure(rows: Sequence[Row], name: str, percent: float) -> float:
    """A percentile of what has been measured; nothing measured is infinitely bad."""
    values = np.array([row[name] for row in rows], dtype=float)
    values = values[np.isfinite(values)]
    return float(np.percentile(values, percent)) if len(values) else float("inf")


def table(groups: Mapping[str, Sequence[Row]]) -> Table:
    """A line a law."""
    shown = Table(box=SIMPLE_HEAD)
    shown.add_column("law")
    for heading in ("landed", "to 0.6 m (s)\np50 p95", "to contact (s)\np50", "jerk (m/s³)\np50"):
        shown.add_column(heading, justify="right")
    shown.add_column("vertical (m/s)\np95", justify="right")
    shown.add_column("lateral (cm)\np95", justify="right")
    for name, rows in groups.items():
        shown.add_row(
            name,
            f"{sum(row['landed'] for row in rows)} of {len(rows)}",
            f"{figure(rows, 'down_s', 50):.1f} {figure(rows, 'down_s', 95):.1f}",
            f"{figure(rows, 'seconds', 50):.1f}",
            f"{figure(rows, 'jerk_m_s3', 50):.1f}",
            f"{figure(rows, 'contact_m_s', 95):.2f}",
            f"{100.0 * figure(rows, 'lateral_contact_m', 95):.1f}",
        )
    return shown


def bars(groups: Mapping[str, Sequence[Row]]) -> list[Bar]:
    """The fuzzy speed controller against the quickest fixed speed of an equal touchdown."""
    own = groups[FUZZY]

    def equal(rows: Sequence[Row]) -> bool:
        return all(
            figure(rows, name, 95) <= AS_GOOD * figure(own, name, 95)
            for name in ("contact_m_s", "lateral_contact_m")
        )

    times = {
        name: figure(rows, "down_s", 50)
        for name, rows in groups.items()
        if name.startswith("fixed") and equal(rows)
    }
    best = min(times, key=lambda name: times[name], default="none")
    mine, limit = figure(own, "down_s", 50), QUICKER * times.get(best, float("inf"))
    return [
        Bar(
            "time to 0.6 m", f"{mine:.1f} s (<= {limit:.1f} s, 0.8 x {best})", best in times and mine <= limit
        )
    ]


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table and the bars; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100, help="random landings")
    parser.add_argument("--first", type=int, default=8000, help="the first landing's number")
    parser.add_argument(
        "--out", type=Path, default=Path("flights/bench-descents"), help="folder for the rows"
    )
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    report, path = BenchReport(), options.out / f"{code_digest()}.jsonl"
    numbers = range(options.first, options.first + options.runs)
    fly_all(numbers, path)
    rows = [row for row in read_rows(path) if row["number"] in numbers]
    if not rows:
        raise ConfigError(f"{path}: no landing has ended")
    groups = {name: [row for row in rows if row["law"] == name] for name in laws()}
    report.show(table(groups))
    return report.judge(bars(groups))
