"""Whether P(success) comes true: what is said at the last commit of random landings, beside the contact.

    python -m benchmarks success --runs 200 --out flights/bench-success

Each landing (those of `bench_landing`) is flown once, as shipped. At every commit the probability of a
contact within the limits is also computed for tighter ones, so that it takes every value; the last commit is
judged by the contact that the simulator saw. The five answers of one flight are not independent. Rows go to
the folder as they end; the same command goes on. The bar: in each tenth with `FEWEST` answers or more, the
mean said and the share that came true differ by no more than 5 points and twice the chance of so many.
"""

import argparse
import copy
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Final
from unittest import mock

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.campaign.landing_cases import random_landings
from benchmarks.report import BenchReport, watched
from companion.config import CONFIG_FOLDER, ConfigError, TouchdownConfig
from companion.flightlog.record import FlightLog
from companion.plan.landing.success import SuccessEstimate
from companion.plan.landing.touchdown import TouchdownSequence
from companion.sim.runner import fly
from companion.sim.settings import sitl_settings
from companion.sim.trial import Trial
from sitl.campaign.manifest import code_digest
from sitl.campaign.tables import Bar
from sitl.scenario.scenario import Scenario

SMOKE: Final = ("--runs", "1", "--jobs", "1")
SHARES: Final = (0.15, 0.25, 0.4, 0.6, 1.0)  # of the limits as shipped
POINTS: Final = 0.05
FEWEST: Final = 20
TENTHS: Final = 10
# by the contact's figure; a pad's tilt at contact is not judged
JUDGED: Final = {
    "lateral offset": "lateral_error_m",
    "lateral speed": "horizontal_speed_m_s",
    "sink": "vertical_speed_m_s",
}


def tighter(config: TouchdownConfig, share: float) -> TouchdownConfig:
    """Limits of so large a share aside, and of what a contact may be faster than planned."""
    spare_m_s = config.fastest_contact_m_s - config.contact_speed_m_s
    return config.model_copy(
        update={
            "break_off_lateral_m": share * config.break_off_lateral_m,
            "lateral_speed_m_s": share * config.lateral_speed_m_s,
            "fastest_contact_m_s": config.contact_speed_m_s + share * spare_m_s,
        }
    )


class SuccessWatch:
    """Looks at what is asked of the estimate; at a commit, what it would have said for tighter limits."""

    def __init__(self, config: TouchdownConfig) -> None:
        """`config` as it is flown by."""
        self._limits = [tighter(config, share) for share in SHARES]
        self._asked: tuple[SuccessEstimate, tuple[Any, ...], dict[str, Any]] | None = None
        self._factors, self._commit = SuccessEstimate.factors, TouchdownSequence.commit
        self.said: dict[str, list[float]] = {}
        self.commits = 0

    def factors(self, success: SuccessEstimate, *args: Any, **named: Any) -> dict[str, float]:
        """Answer, and keep the question."""
        self._asked = success, args, named
        return self._factors(success, *args, **named)

    def commit(self, sequence: TouchdownSequence, now_s: float) -> None:
        """Ask again for the tighter limits."""
        assert self._asked is not None
        success, args, named = self._asked
        self.said = {limit: [] for limit in JUDGED}
        for limits in self._limits:
            strict = copy.copy(success)
            fresh = SuccessEstimate(limits)
            strict._config, strict._fastest_m_s = fresh._config, fresh._fastest_m_s
            likely = self._factors(strict, *args, **{**named, "slack": 1.0})
            for limit, shares in self.said.items():
                shares.append(likely[limit])
        self.commits += 1
        self._commit(sequence, now_s)

    def true(self, contact: Mapping[str, float]) -> dict[str, list[bool]]:
        """Whether the contact was within each of the limits."""
        most: dict[str, list[float]] = {
            "lateral offset": [limits.break_off_lateral_m for limits in self._limits],
            "lateral speed": [SuccessEstimate(limits)._fastest_m_s for limits in self._limits],
            "sink": [limits.fastest_contact_m_s for limits in self._limits],
        }
        return {limit: [contact[JUDGED[limit]] <= one for one in each] for limit, each in most.items()}


def fly_landing(number: int) -> dict[str, Any]:
    """Fly one landing: what was said and what came true by limits, where it touched after a commit."""
    ((content, seed),) = random_landings(1, number).flights
    scenario = Scenario.model_validate(content)
    trial = Trial(Path(f"{scenario.name}.yaml"), scenario, seed)
    config = sitl_settings(CONFIG_FOLDER / "companion.yaml", trial, fast=True)
    watch, log = SuccessWatch(config.plan.touchdown), FlightLog(None, start_unix_s=0.0)
    with (
        mock.patch.object(SuccessEstimate, "factors", autospec=True, side_effect=watch.factors),
        mock.patch.object(TouchdownSequence, "commit", autospec=True, side_effect=watch.commit),
    ):
        flight = fly(config, trial, log, lambda _status: None, fast=True)
    report = flight.report
    touched = report.touchdown
    judged = touched is not None and watch.commits > 0
    return {
        "number": number,
        "outcome": report.outcome.value,
        "commits": watch.commits,
        "offset_m": None if touched is None else touched["lateral_error_m"],
        "said": watch.said if judged else {},
        "true": watch.true(touched) if judged and touched is not None else {},
    }


def fly_all(numbers: Sequence[int], path: Path, jobs: int) -> list[dict[str, Any]]:
    """Fly what has no row yet; returns the rows of the landings asked for."""
    flown = {row["number"] for row in read_rows(path)}
    left = [number for number in numbers if number not in flown]
    with ProcessPoolExecutor(jobs, max_tasks_per_child=50) as pool, path.open("a", encoding="utf-8") as file:
        for row in watched(pool.map(fly_landing, left), "landings", len(left)):
            file.write(json.dumps(row) + "\n")
            file.flush()
    return [row for row in read_rows(path) if row["number"] in numbers]


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows so far."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def answers(rows: Sequence[dict[str, Any]], limits: Sequence[str]) -> list[tuple[float, bool]]:
    """What was said of all these limits together, and whether it came true."""
    pairs = []
    for row in rows:
        for k in range(len(SHARES) if row["said"] else 0):
            said = math.prod(row["said"][limit][k] for limit in limits)
            pairs.append((said, all(row["true"][limit][k] for limit in limits)))
    return pairs


def judge_tenths(title: str, pairs: Sequence[tuple[float, bool]]) -> tuple[Table, list[Bar]]:
    """A line a tenth of what was said: how many, the mean said, the share that came true."""
    shown = Table(box=SIMPLE_HEAD, title=title)
    for heading in ("said", "descents", "mean said", "came true"):
        shown.add_column(heading, justify="right")
    bars = []
    for tenth in range(TENTHS):
        rows = [pair for pair in pairs if min(TENTHS - 1, int(TENTHS * pair[0])) == tenth]
        if not rows:
            continue
        said, true = (sum(pair[side] for pair in rows) / len(rows) for side in (0, 1))
        name = f"{10 * tenth} to {10 * (tenth + 1)} %"
        shown.add_row(name, str(len(rows)), f"{100 * said:.0f} %", f"{100 * true:.0f} %")
        if len(rows) >= FEWEST:
            apart, chance = abs(said - true), 2.0 * math.sqrt(said * (1.0 - said) / len(rows))
            words = f"{100 * apart:.0f} points (<= {100 * (POINTS + chance):.0f})"
            bars.append(Bar(f"said {name}", words, apart <= POINTS + chance))
    return shown, bars


def main(arguments: Sequence[str] | None = None) -> BenchReport:
    """Fly, print the table, and say which bars hold."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=200, help="random landings")
    parser.add_argument("--first", type=int, default=7000, help="the first landing's number")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("flights/bench-success"), help="folder for the rows")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    report, path = BenchReport(), options.out / f"{code_digest()}.jsonl"
    numbers = range(options.first, options.first + options.runs)
    rows = fly_all(numbers, path, options.jobs)
    if not rows:
        raise ConfigError(f"{path}: no landing has ended")
    landed, commits = (sum(row["outcome"] == "landed" for row in rows), sum(row["commits"] for row in rows))
    report.show(f"{landed} of {len(rows)} landed, {commits} commits")
    for limit in JUDGED:
        report.show(judge_tenths(limit, answers(rows, [limit]))[0])
    shown, bars = judge_tenths("all", answers(rows, list(JUDGED)))
    report.show(shown)
    return report.judge(bars)
