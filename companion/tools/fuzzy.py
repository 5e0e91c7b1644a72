"""Rules in; the table of rules, what the flight's table is worth, and a picture out."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Console
from rich.table import Table

from companion.base.command_line import say
from companion.base.files import save_figure
from companion.base.units import without_unit
from companion.plan.speed.fuzzy_rules import (
    OUTPUT,
    FuzzyRules,
    PaceRules,
    RuleSet,
    Terms,
    in_order,
    load_rules,
)
from companion.plan.speed.speed_table import MONOTONE_TOLERANCE_M_S, SpeedTable, load_table, write_table
from companion.tools.fuzzy_check import LARGEST_ERROR, AnyTable, TableError, table_error, worst_slips

mpl.use("Agg")

LABELS: Final = {
    "distance_m": "distance (m)",
    "velocity_m_s": "closing velocity (m/s)",
    "acceleration_m_s2": "closing acceleration (m/s²)",
    OUTPUT: "average speed V (m/s)",
    "sight_rad": "sight: error as an angle (rad)",
    "relative_speed_m_s": "relative speed (m/s)",
    "gust_m_s2": "gusts (m/s²)",
    "factor": "pace: factor on V",
}
SURFACE_POINTS: Final = 60
BOX_SHARE: Final = 0.86


def draw(rules: FuzzyRules, table: SpeedTable, path: Path) -> None:
    sets = _sets(rules, table)
    figure = Figure(figsize=(15.0, 8.5 * len(sets)), dpi=110, layout="constrained")
    halves: Any = figure.subfigures(2 * len(sets), 1, height_ratios=(1.0, 1.7) * len(sets))
    for (rule_set, surface), terms, surfaces in zip(sets, halves[::2], halves[1::2], strict=True):
        for axes, name in zip(terms.subplots(1, 4), (*rule_set.inputs, rule_set.output), strict=True):
            _draw_terms(axes, rule_set.terms(name), LABELS[name])
        third = getattr(surface, rule_set.inputs[2])
        for column, value in enumerate((third[0], 0.5 * (third[0] + third[-1]), third[-1])):
            axes = surfaces.add_subplot(1, 3, column + 1, projection="3d")
            _draw_surface(axes, rule_set, surface, value)
    figure.suptitle(f"{rules.name}: the expert's terms, the speed V, and its pace by the conditions")
    save_figure(figure, path)


def _sets(rules: FuzzyRules, table: SpeedTable) -> list[tuple[RuleSet, AnyTable]]:
    """The rules of the speed and, where there are, those of its pace, with their tables."""
    sets: list[tuple[RuleSet, AnyTable]] = [(rules, table)]
    if rules.pace is not None and table.pace is not None:
        sets.append((rules.pace, table.pace))
    return sets


def _draw_terms(axes: Any, terms: Terms, label: str) -> None:
    low = min(corners[0] for corners in terms.values())
    high = max(corners[-1] for corners in terms.values())
    for name in in_order(terms):
        corners = terms[name]
        heights = (0.0, 1.0, 0.0) if len(corners) == 3 else (0.0, 1.0, 1.0, 0.0)
        (line,) = axes.plot(corners, heights, linewidth=1.4, label=name)
        axes.fill_between(corners, heights, alpha=0.12, color=line.get_color())
    axes.set_xlim(low, high)
    axes.set_ylim(0.0, 1.45)
    axes.legend(loc="upper center", ncols=3, fontsize=7, frameon=False)
    axes.set_yticks((0.0, 0.5, 1.0))
    axes.set_xlabel(label)
    axes.set_ylabel("membership")


def _draw_surface(axes: Any, rules: RuleSet, table: AnyTable, third: float) -> None:
    first, second, name = rules.inputs
    x, y = (
        np.linspace(getattr(table, axis)[0], getattr(table, axis)[-1], SURFACE_POINTS)
        for axis in (first, second)
    )
    output = np.array([[table(d, v, third) for d in x.tolist()] for v in y.tolist()])
    highest = float(np.max(getattr(table, rules.output)))
    grid = np.meshgrid(x, y)
    axes.plot_surface(*grid, output, cmap="viridis", vmin=0.0, vmax=highest, rcount=40, ccount=40)
    axes.set_xlabel(LABELS[first])
    axes.set_ylabel(LABELS[second])
    axes.set_zlabel(LABELS[rules.output])
    axes.set_zlim(0.0, highest)
    # from below of the slope: V rises with distance, the pace falls with whatever is worse
    axes.view_init(elev=26.0, azim=-128.0 if rules.output == OUTPUT else 52.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    # the layout knows nothing of a 3-D axis's label: without room at its side it is cut off
    axes.set_box_aspect(None, zoom=BOX_SHARE)
    sign = "+" if name == "acceleration_m_s2" else ""  # gusts have none
    axes.set_title(f"{LABELS[name].partition(' (')[0]} {third:{sign}.1f} m/s²")


# ---------------------------------------------------------------- the table and the picture

SENSE: Final = {
    "distance_m": "never faster when closer",
    "velocity_m_s": "never faster when already closing faster",
    "acceleration_m_s2": "never faster when already speeding up more",
    "sight_rad": "never quicker where the pad is seen worse",
    "relative_speed_m_s": "never quicker where the pad is followed worse",
    "gust_m_s2": "never quicker in more gusts",
}
WORDS: Final = {
    "distance_m": "distance",
    "acceleration_m_s2": "acceleration",
    "sight_rad": "sight",
    "gust_m_s2": "gusts",
}


def run_fuzzy(rules: str, plot: Path | None, points: int, seed: int, *, rewrite: bool) -> bool:
    """Show, check and draw; whether the table holds and the rules are a pilot's."""
    console = Console()
    read = load_rules(rules)
    written = write_table(rules) if rewrite else None
    table, how = load_table(rules)
    sets = _sets(read, table)
    for rule_set, _ in sets:
        for block in rule_tables(rule_set):
            console.print(block)
    if written is not None:
        say(console, f"table written: {written}")
    elif how == "computed":
        say(console, "no stored table for these rules: it is computed at each start; see --write-table")
    if plot is not None:
        draw(read, table, plot)
        say(console, f"picture: {plot}")
    held = [_check(console, *each, points, np.random.default_rng(seed)) for each in sets]
    return all(held)  # all are shown, whichever fails


def _check(console: Console, rules: RuleSet, table: AnyTable, points: int, rng: np.random.Generator) -> bool:
    """Print what a table is worth; whether it holds and the rules are a pilot's."""
    error, slips = table_error(rules, table, points, rng), worst_slips(rules, table)
    say(console, error_line(rules, error), *sense_lines(slips))
    return error.holds and all(slip <= MONOTONE_TOLERANCE_M_S for slip in slips.values())


def rule_tables(rules: RuleSet) -> Iterator[Table]:
    """One block for each term of the third input: rows are the first's, columns the second's."""
    first, second, third = rules.inputs
    for term in in_order(rules.terms(third)):
        block = Table(title=f"{WORDS[third]} {term}", title_justify="left")
        block.add_column(WORDS[first])
        for column in in_order(rules.terms(second)):
            block.add_column(column)
        for row in in_order(rules.terms(first)):
            block.add_row(row, *rules.rules[term][row])
        yield block


def error_line(rules: RuleSet, error: TableError) -> str:
    """What the table is worth, beside its bar."""
    where = ", ".join(
        f"{value:.2f} {without_unit(name)[1]}"
        for name, value in zip(rules.inputs, error.worst_at, strict=True)
    )
    verdict = "holds" if error.holds else "FAILS"
    return (
        f"table of {rules.output.partition('_')[0]} against scikit-fuzzy at {error.points} inputs: "
        f"largest error {100.0 * error.worst:.2f} % (at {where}), rms {100.0 * error.rms:.2f} %; "
        f"bar {100.0 * LARGEST_ERROR:g} %: {verdict}"
    )


def sense_lines(slips: dict[str, float]) -> Iterator[str]:
    """For each input whether the output does what a pilot would."""
    for name, slip in slips.items():
        broken = slip > MONOTONE_TOLERANCE_M_S
        unit = "" if name in PaceRules.inputs else " m/s"
        yield f"{SENSE[name]}: " + (f"BROKEN, by up to {slip:.3f}{unit}" if broken else "holds")
