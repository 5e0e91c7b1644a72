"""A campaign as tables for a terminal or a text file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from sitl.campaign.rows import OUTCOMES, Row
from sitl.scenario.scenario import PassBounds

WORST_SHOWN: Final = 10
# a column, its heading, the factor to the unit shown, its digits, and the bound that a touchdown keeps
ERRORS: Final = (
    ("touchdown_lateral_m", "lateral cm", 100.0, 1, "lateral_error_m"),
    ("vertical_speed_m_s", "vertical m/s", 1.0, 2, "vertical_speed_m_s"),
    ("horizontal_speed_m_s", "horizontal m/s", 1.0, 2, "horizontal_speed_m_s"),
    ("tilt_deg", "tilt °", 1.0, 1, "tilt_deg"),
)


def print_summary(console: Console, rows: Sequence[Row], bounds: Mapping[str, PassBounds]) -> None:
    """Outcomes, errors and the worst runs; `bounds` are the scenarios' own by name."""
    if not rows:
        console.print("no run has ended yet")
        return
    console.print(outcome_table(rows))
    console.print(error_table(rows, bounds))
    print_worst(console, rows)


def groups_and_all(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each scenario, and of all where there are several."""
    groups = by_scenario(rows)
    return groups if len(groups) < 2 else {**groups, "all": list(rows)}


def outcome_table(rows: Sequence[Row]) -> Table:
    """How the runs ended, a scenario a row; times and speeds are medians."""
    table = _table("How the runs ended", "scenario")
    table.add_column("runs", justify="right")
    table.add_column("landed", justify="right")
    table.add_column("success, 95 % interval", justify="right", no_wrap=True)
    table.add_column("otherwise")
    table.add_column("flight s", justify="right", no_wrap=True)
    table.add_column("x real", justify="right", no_wrap=True)
    for name, group in groups_and_all(rows).items():
        counts = {outcome: sum(row.outcome == outcome for row in group) for outcome in OUTCOMES}
        otherwise = [
            f"{count} {outcome}" for outcome, count in counts.items() if count and outcome != "landed"
        ]
        success = share(counts["landed"], len(group))
        medians = (_middle(spread(group, "total_s"), 0), _middle(spread(group, "real_time_factor"), 1))
        table.add_row(name, str(len(group)), str(success.hits), str(success), ", ".join(otherwise), *medians)
    return table


def _table(title: str, first: str) -> Table:
    """Narrow enough for eighty columns."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(first, no_wrap=True)
    return table


def _middle(found: Percentiles | None, digits: int) -> str:
    return "-" if found is None else f"{found.p50:.{digits}f}"


def error_table(rows: Sequence[Row], bounds: Mapping[str, PassBounds]) -> Table:
    """The errors of all touchdowns: median, 95th percentile and worst, under what passes."""
    table = _table("At touchdown: p50 p95 worst", "scenario")
    table.add_column("came down", justify="right")
    for _, heading, factor, _, bound in ERRORS:
        # where the scenarios differ in what passes, one heading cannot say it
        limits = {factor * float(getattr(own, bound)) for own in bounds.values()}
        passes = f"\n<= {limits.pop():g}" if len(limits) == 1 else ""
        table.add_column(heading + passes, justify="right", no_wrap=True)
    for name, group in groups_and_all(rows).items():
        cells = [
            _spread_text(spread(group, column), factor, digits) for column, _, factor, digits, _ in ERRORS
        ]
        table.add_row(name, str(sum(row.touchdown_lateral_m is not None for row in group)), *cells)
    return table


def _spread_text(found: Percentiles | None, factor: float, digits: int) -> str:
    if found is None:
        return "-"
    return " ".join(f"{factor * value:.{digits}f}" for value in (found.p50, found.p95, found.worst))


def print_worst(console: Console, rows: Sequence[Row]) -> None:
    shown = worst(rows, WORST_SHOWN)
    console.print(f"The {len(shown)} worst runs, and what repeats each:" if len(shown) > 1 else "The run:")
    for row in shown:
        off = "" if row.touchdown_lateral_m is None else f"{100 * row.touchdown_lateral_m:.1f} cm off"
        said = "; ".join(text for text in (off, row.reason, row.error) if text)
        console.print(f"  {row.outcome}: {said}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"    {row.command}", highlight=False, markup=False, soft_wrap=True)


# ---------------------------------------------------------------- figures

CONFIDENCE: Final = 0.95
# the worst first; a run that came down is judged by how far off it was
SEVERITY: Final = {"crashed": 0, "failed": 1, "timeout": 2, "aborted": 2, "missed": 3, "landed": 3}
MEDIAN_LATERAL_M: Final = 0.05
WORST_LATERAL_M: Final = 0.15
VERTICAL_M_S: Final = 0.4
HORIZONTAL_M_S: Final = 0.3


@dataclass(frozen=True, slots=True)
class Share:
    """A share of runs, and the interval that holds the true one with 95 % (Wilson's score interval)."""

    hits: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        return self.hits / self.of

    def __str__(self) -> str:
        return f"{100 * self.value:.0f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


def share(hits: int, of: int) -> Share:
    """A share of `of` runs, at least one.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference" (1927). It
    is valid where the normal approximation fails: with few runs, and with all of them landed.
    """
    interval = binomtest(hits, of).proportion_ci(CONFIDENCE, method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Half of the values are at most `p50`, 95 % at most `p95`, all at most `worst`."""

    p50: float
    p95: float
    worst: float


def values(rows: Sequence[Row], column: str) -> list[float]:
    """The sizes of a column's values where there are any, ascending."""
    return sorted(abs(value) for row in rows if (value := getattr(row, column)) is not None)


def spread(rows: Sequence[Row], column: str) -> Percentiles | None:
    """The percentiles of a column's sizes; None without values."""
    sizes = values(rows, column)
    if not sizes:
        return None
    p50, p95 = np.percentile(sizes, [50.0, 95.0])
    return Percentiles(float(p50), float(p95), sizes[-1])


def by_scenario(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each scenario, in the order in which these first come."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.scenario, []).append(row)
    return groups


def worst(rows: Sequence[Row], count: int) -> list[Row]:
    """The worst runs: crashes, failed runs, timeouts and aborts, then by distance from the pad's centre."""
    return sorted(
        rows,
        key=lambda row: (SEVERITY[row.outcome], -(row.touchdown_lateral_m or 0.0), row.scenario, row.seed),
    )[:count]


# ---------------------------------------------------------------- bars


@dataclass(frozen=True, slots=True)
class Bar:
    """One acceptance criterion, the measured value, and whether it holds."""

    name: str
    measured: str
    holds: bool

    def __str__(self) -> str:
        return f"{self.name} {self.measured} {'holds' if self.holds else 'FAILS'}"


def at_most(name: str, value: float, limit: float, unit: str = "", digits: int = 1) -> Bar:
    """A bar on a figure, which may be no more; NaN: it was not measured."""
    shown = "NOT MEASURED" if math.isnan(value) else f"{value:.{digits}f} (<= {limit:g}) {unit}".rstrip()
    return Bar(name, shown, value <= limit)


def bars(rows: Sequence[Row]) -> list[Bar]:
    """The landings against the project's acceptance criteria; medians per scenario."""
    landed = sum(row.landed for row in rows)
    lateral = "touchdown_lateral_m"
    medians = [found.p50 for group in by_scenario(rows).values() if (found := spread(group, lateral))]
    measured = (
        ("lateral median", max(medians, default=None), MEDIAN_LATERAL_M, "m"),
        ("lateral worst", max(values(rows, lateral), default=None), WORST_LATERAL_M, "m"),
        ("vertical speed", max(values(rows, "vertical_speed_m_s"), default=None), VERTICAL_M_S, "m/s"),
        ("horizontal speed", max(values(rows, "horizontal_speed_m_s"), default=None), HORIZONTAL_M_S, "m/s"),
    )
    return [Bar("landed", f"{landed} of {len(rows)}", landed == len(rows) > 0)] + [
        Bar(name, f"- (<= {limit:g} {unit})", holds=False)
        if value is None
        else at_most(name, value, limit, unit, digits=3)
        for name, value, limit, unit in measured
    ]
