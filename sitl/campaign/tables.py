"""A campaign as tables for a terminal or a text file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rich.console import Console
from rich.table import Table

from sitl.campaign.figures import Spread, by_scenario, share, spread, worst
from sitl.campaign.rows import OUTCOMES, Row
from sitl.scenario import PassBounds

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
    """How the runs ended, a scenario a row."""
    table = Table(title="How the runs ended", title_justify="left")
    table.add_column("scenario")
    met = [outcome for outcome in OUTCOMES if outcome == "landed" or any(r.outcome == outcome for r in rows)]
    for heading in ("runs", *met, "success % (95 % interval)", "flight s", "x real time"):
        table.add_column(heading, justify="right")
    for name, group in groups_and_all(rows).items():
        counts = [sum(row.outcome == outcome for row in group) for outcome in met]
        success = share(counts[0], len(group))
        medians = (_middle(spread(group, "total_s"), 0), _middle(spread(group, "real_time_factor"), 1))
        if name == "all" and len(table.rows) > 1:
            table.add_section()
        table.add_row(name, str(len(group)), *(str(count) for count in counts), str(success), *medians)
    return table


def _middle(found: Spread | None, digits: int) -> str:
    return "-" if found is None else f"{found.p50:.{digits}f}"


def error_table(rows: Sequence[Row], bounds: Mapping[str, PassBounds]) -> Table:
    """The errors of all touchdowns: median, 95th percentile and worst, beside what passes."""
    table = Table(title="At touchdown: p50 / p95 / worst (passes at)", title_justify="left")
    table.add_column("scenario")
    table.add_column("touchdowns", justify="right")
    for _, heading, *_ in ERRORS:
        table.add_column(heading, justify="right")
    for name, group in groups_and_all(rows).items():
        cells = []
        for column, _, factor, digits, bound in ERRORS:
            limit = getattr(bounds[name], bound) if name in bounds else None
            cells.append(_spread_text(spread(group, column), factor, digits, limit))
        if name == "all" and len(table.rows) > 1:
            table.add_section()
        table.add_row(name, str(sum(row.touchdown_lateral_m is not None for row in group)), *cells)
    return table


def _spread_text(found: Spread | None, factor: float, digits: int, limit: float | None) -> str:
    if found is None:
        return "-"
    text = " / ".join(f"{factor * value:.{digits}f}" for value in (found.p50, found.p95, found.worst))
    return text if limit is None else f"{text} ({factor * limit:g})"


def print_worst(console: Console, rows: Sequence[Row]) -> None:
    """The worst runs, each with the command that repeats it."""
    shown = worst(rows, WORST_SHOWN)
    console.print(f"The {len(shown)} worst runs, and what repeats each:" if len(shown) > 1 else "The run:")
    for row in shown:
        off = "" if row.touchdown_lateral_m is None else f"{100 * row.touchdown_lateral_m:.1f} cm off"
        said = "; ".join(text for text in (off, row.reason, row.error) if text)
        console.print(f"  {row.outcome}: {said}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"    {row.command}", highlight=False, markup=False, soft_wrap=True)
