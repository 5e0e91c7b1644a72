"""Writes docs/reference/second-sources.md from the table of second sources.

python -m docs.second_sources
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from companion.base.second_sources import ROWS, SourceRow

PAGE: Final = Path(__file__).resolve().parent / "reference" / "second-sources.md"
INTRODUCTION: Final = """\
# Second sources

Written by `python -m docs.second_sources` from `companion/base/second_sources.py`.

Each quantity of this table has two sources. A difference beyond the notice is announced, with both
figures, and flown with. Beyond the bound the app acts as the last two columns say. A difference counts
when it exceeds notice or bound by three of its own standard deviations. The refusal of an order, the
failsafe in flight, `companion check` and `companion status` use this table and the same words.

| Quantity | First source | Second source | Notice | Bound | Before control is taken | In flight |
|---|---|---|---|---|---|---|
"""


def page_text() -> str:
    """The whole page."""
    return INTRODUCTION + "".join(map(_line, ROWS))


def _line(row: SourceRow) -> str:
    notice, bound = (_figure(value, row.unit) for value in (row.notice, row.bound))
    cells = (row.quantity, row.first, row.second, notice, bound, row.before, row.in_flight)
    return f"| {' | '.join(cells)} |\n"


def _figure(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:g} {unit}"


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
