"""Rules in; the table of rules, what the flight's table is worth, and a picture out."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.plan.speed.fuzzy_check import LARGEST_ERROR, AnyTable, TableError, table_error, worst_slips
from companion.plan.speed.fuzzy_rules import PaceRules, RuleSet, in_order, load_rules
from companion.plan.speed.speed_table import MONOTONE_TOLERANCE_M_S, load_table, write_table
from companion.tools.fuzzy.plots import draw

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
UNITS: Final = {"m": "m", "m_s": "m/s", "m_s2": "m/s²", "rad": "rad"}


def run_fuzzy(rules: str, plot: Path | None, points: int, seed: int, *, rewrite: bool) -> bool:
    """Show, check and draw; whether the table holds and the rules are a pilot's.

    Raises:
        ConfigError: the rules cannot be read or break a rule, or a file cannot be written.
    """
    console = Console()
    read = load_rules(rules)
    written = write_table(rules) if rewrite else None
    table, how = load_table(rules)
    sets: list[tuple[RuleSet, AnyTable]] = [(read, table)]
    if read.pace is not None and table.pace is not None:
        sets.append((read.pace, table.pace))
    for rule_set, _ in sets:
        for block in rule_tables(rule_set):
            console.print(block)
    if written is not None:
        console.print(f"table written: {written}", highlight=False, soft_wrap=True)
    elif how == "computed":
        console.print("no table belongs to these rules: computed anew, at each start; see --write-table")
    if plot is not None:
        draw(read, table, plot)
        console.print(f"picture: {plot}", highlight=False, soft_wrap=True, markup=False)
    held = [_check(console, *each, points, np.random.default_rng(seed)) for each in sets]
    return all(held)  # all are shown, whichever fails


def _check(console: Console, rules: RuleSet, table: AnyTable, points: int, rng: np.random.Generator) -> bool:
    """Print what a table is worth; whether it holds and the rules are a pilot's."""
    error, slips = table_error(rules, table, points, rng), worst_slips(rules, table)
    for line in (error_line(rules, error), *sense_lines(slips)):
        console.print(line, highlight=False, soft_wrap=True)
    return error.holds and all(slip <= MONOTONE_TOLERANCE_M_S for slip in slips.values())


def rule_tables(rules: RuleSet) -> list[Table]:
    """One block for each term of the third input: rows are the first's, columns the second's."""
    first, second, third = rules.inputs
    blocks = []
    for term in in_order(rules.terms(third)):
        block = Table(title=f"{WORDS[third]} {term}", title_justify="left")
        block.add_column(WORDS[first])
        for column in in_order(rules.terms(second)):
            block.add_column(column)
        for row in in_order(rules.terms(first)):
            block.add_row(row, *rules.rules[term][row])
        blocks.append(block)
    return blocks


def error_line(rules: RuleSet, error: TableError) -> str:
    """What the table is worth, beside its bar."""
    where = ", ".join(
        f"{value:.2f} {UNITS[name.partition('_')[2].removeprefix('speed_')]}"
        for name, value in zip(rules.inputs, error.worst_at, strict=True)
    )
    verdict = "holds" if error.holds else "FAILS"
    return (
        f"table of {rules.output.partition('_')[0]} against scikit-fuzzy at {error.points} inputs: "
        f"largest error {100.0 * error.worst:.2f} % (at {where}), rms {100.0 * error.rms:.2f} %; "
        f"bar {100.0 * LARGEST_ERROR:g} %: {verdict}"
    )


def sense_lines(slips: dict[str, float]) -> list[str]:
    """For each input whether the output does what a pilot would."""
    lines = []
    for name, slip in slips.items():
        broken = slip > MONOTONE_TOLERANCE_M_S
        unit = "" if name in PaceRules.inputs else " m/s"
        lines.append(f"{SENSE[name]}: " + (f"BROKEN, by up to {slip:.3f}{unit}" if broken else "holds"))
    return lines
