"""Writes docs/reference/second-sources.md from the table of second sources.

python -m docs.second_sources
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from companion.base.second_sources import OLDEST_S, ROWS, SourceRow

PAGE: Final = Path(__file__).resolve().parent / "reference" / "second-sources.md"
INTRODUCTION: Final = """\
# Second sources

Written by `python -m docs.second_sources` from `companion/base/second_sources.py`.

Each quantity in this table has two sources, which the app compares. If the difference exceeds the notice
value, the app announces it with both figures and flies on. If it exceeds the bound, the app acts as in the
last two columns. A difference counts only if it exceeds the value by three of its own standard deviations.
The refusal of an order, the failsafe in flight, `companion check` and `companion status` all use this table.
A comparison counts for {oldest:g} s. Longer counts only what is built or set: {built}.

| Quantity | First source | Second source | Notice | Bound | Before control is taken | In flight |
|---|---|---|---|---|---|---|
"""


def page_text() -> str:
    """The whole page."""
    built = ", ".join(row.quantity for row in ROWS if row.built)
    return INTRODUCTION.format(oldest=OLDEST_S, built=built) + "".join(map(_line, ROWS))


def _line(row: SourceRow) -> str:
    notice, bound = (_figure(value, row.unit) for value in (row.notice, row.bound))
    cells = (row.quantity, row.first, row.second, notice, bound, row.before, row.in_flight)
    return f"| {' | '.join(cells)} |\n"


def _figure(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:g} {unit}"


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
