"""A campaign as tables for a terminal or a text file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from sitl.campaign.figures import Percentiles, by_scenario, share, spread, worst
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
    """The worst runs, each with the command that repeats it."""
    shown = worst(rows, WORST_SHOWN)
    console.print(f"The {len(shown)} worst runs, and what repeats each:" if len(shown) > 1 else "The run:")
    for row in shown:
        off = "" if row.touchdown_lateral_m is None else f"{100 * row.touchdown_lateral_m:.1f} cm off"
        said = "; ".join(text for text in (off, row.reason, row.error) if text)
        console.print(f"  {row.outcome}: {said}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"    {row.command}", highlight=False, markup=False, soft_wrap=True)
