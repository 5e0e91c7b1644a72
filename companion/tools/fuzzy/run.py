"""Rules in; the table of rules, what the flight's table is worth, and a picture out."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.config import ConfigError
from companion.plan.speed.fuzzy_check import LARGEST_ERROR, TableError, table_error, worst_slips_m_s
from companion.plan.speed.fuzzy_rules import FuzzyRules, in_order, load_rules
from companion.plan.speed.speed_table import MONOTONE_TOLERANCE_M_S, SpeedTable, load_table, write_table
from companion.tools.fuzzy.plots import draw

SENSE: Final = {
    "distance_m": "never faster when closer",
    "velocity_m_s": "never faster when already closing faster",
    "acceleration_m_s2": "never faster when already speeding up more",
}


def run_fuzzy(rules: str, plot: Path | None, points: int, seed: int, *, rewrite: bool) -> bool:
    """Show, check and draw; whether the table holds and the rules are a pilot's.

    Raises:
        ConfigError: the rules cannot be read or break a rule, or a file cannot be written.
    """
    console = Console()
    read = load_rules(rules)
    written = write_table(rules) if rewrite else None
    table, how = load_table(rules)
    for block in rule_tables(read):
        console.print(block)
    if written is not None:
        console.print(f"table written: {written}", highlight=False, soft_wrap=True)
    elif how == "computed":
        console.print("no table belongs to these rules: computed anew, at each start; see --write-table")
    if plot is not None:
        _draw(read, table, plot)
        console.print(f"picture: {plot}", highlight=False, soft_wrap=True, markup=False)
    error = table_error(read, table, points, np.random.default_rng(seed))
    slips = worst_slips_m_s(table)
    for line in (error_line(error), *sense_lines(slips)):
        console.print(line, highlight=False, soft_wrap=True)
    sensible = all(slip <= MONOTONE_TOLERANCE_M_S for slip in slips.values())
    return error.holds and sensible


def rule_tables(rules: FuzzyRules) -> list[Table]:
    """One block for each acceleration: rows are distances, columns closing velocities, cells speeds."""
    blocks = []
    for acceleration in in_order(rules.acceleration_m_s2):
        block = Table(title=f"acceleration {acceleration}", title_justify="left")
        block.add_column("distance")
        for velocity in in_order(rules.velocity_m_s):
            block.add_column(velocity)
        for distance in in_order(rules.distance_m):
            block.add_row(distance, *rules.rules[acceleration][distance])
        blocks.append(block)
    return blocks


def error_line(error: TableError) -> str:
    """What the table is worth, beside its bar."""
    d, v, a = error.worst_at
    verdict = "holds" if error.holds else "FAILS"
    return (
        f"table against scikit-fuzzy at {error.points} inputs: largest error {100.0 * error.worst:.2f} % "
        f"(at {d:.2f} m, {v:.2f} m/s, {a:.2f} m/s²), rms {100.0 * error.rms:.2f} %; "
        f"bar {100.0 * LARGEST_ERROR:g} %: {verdict}"
    )


def sense_lines(slips_m_s: dict[str, float]) -> list[str]:
    """For each input whether the speed does what a pilot would."""
    lines = []
    for name, slip in slips_m_s.items():
        broken = slip > MONOTONE_TOLERANCE_M_S
        lines.append(f"{SENSE[name]}: " + (f"BROKEN, by up to {slip:.3f} m/s" if broken else "holds"))
    return lines


def _draw(rules: FuzzyRules, table: SpeedTable, path: Path) -> None:
    try:
        draw(rules, table, path)
    except OSError as error:
        raise ConfigError(f"--plot {path}: cannot be written: {error.strerror}") from error
