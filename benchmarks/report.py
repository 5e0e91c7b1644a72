"""What a benchmark shows and judges: on the terminal as it comes, and in the end as JSON.

A figure is worth what is known of it: the JSON has the commit, the machine and the date beside the tables,
the lines and the bars.
"""

from __future__ import annotations

import gc
import json
import os
import platform
import resource
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from companion.base.files import write_atomically
from sitl.campaign.tables import Bar

T = TypeVar("T")


def watched(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """The items, with a bar on standard error until all are done; `total` where they have no length."""
    console = Console(stderr=True)
    count = len(items) if total is None and isinstance(items, Sized) else total
    yield from track(
        items, what, total=count, console=console, transient=True, disable=not console.is_terminal
    )


ROOT: Final = Path(__file__).resolve().parents[1]
WIDTH: Final = 150  # where nobody sets one: a file, a pipe


def figures_table(title: str, *headings: str) -> Table:
    """A table of figures, which stand to the right."""
    table = Table(title=title)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


class BenchReport(Console):
    """A console that keeps what it shows; strings are printed as they are."""

    def __init__(self, width: int | None = None) -> None:
        super().__init__(width=width if width or sys.stdout.isatty() else WIDTH)
        self._tables: list[Table] = []
        self._lines: list[str] = []
        self._bars: list[dict[str, Any]] | None = None
        # any figures, for who compares two runs
        self.figures: dict[str, Any] = {}

    def show(self, *objects: Any) -> None:
        """Print and keep tables, strings and what has a string."""
        for each in objects:
            if isinstance(each, Table):
                self._tables.append(each)
                self.print(each)
            else:
                self._lines.append(str(each))
                self.progress(str(each))

    def progress(self, text: str) -> None:
        """Print what is of no use when all is done."""
        self.print(text, highlight=False, soft_wrap=True, markup=False)

    def judge(self, bars: Mapping[str, bool] | Iterable[Bar]) -> BenchReport:
        """Print the bars in one line; returns this report."""
        if isinstance(bars, Mapping):
            said = {name: f"{name} {'holds' if holds else 'FAILS'}" for name, holds in bars.items()}
            found = [(name, bool(holds), said[name]) for name, holds in bars.items()]
        else:
            found = [(bar.name, bar.holds, str(bar)) for bar in bars]
        self._bars = [
            *(self._bars or []),
            *({"name": name, "holds": holds, "text": text} for name, holds, text in found),
        ]
        self.progress(f"bars: {', '.join(text for *_, text in found) or 'none was measured'}")
        return self

    def include(self, other: BenchReport) -> None:
        """Take over what another has shown and judged."""
        self._tables += other._tables
        self._lines += other._lines
        self._bars = [*(self._bars or []), *(other._bars or [])]

    @property
    def exit_status(self) -> int:
        """The exit status: 0 when all bars hold, or it has none."""
        if self._bars is None:
            return 0
        return 0 if self._bars and all(bar["holds"] for bar in self._bars) else 1

    def as_json(self, name: str, words: Sequence[str]) -> dict[str, Any]:
        """All of it, with where and when it was measured."""
        return {
            "benchmark": name,
            "arguments": list(words),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit(),
            "machine": machine(),
            "holds": self.exit_status == 0,
            "bars": self._bars or [],
            "tables": [_rows(table) for table in self._tables],
            "lines": self._lines,
            "figures": self.figures,
        }

    def write(self, path: Path, name: str, words: Sequence[str]) -> None:
        """Write it.

        Raises:
            ConfigError: the file cannot be written.
        """
        write_atomically(path, json.dumps(self.as_json(name, words), indent=1, ensure_ascii=False) + "\n")


def commit() -> str | None:
    """The checkout's commit, with "+" behind it where files differ from it; None without git."""
    try:
        said = [
            subprocess.run(("git", *words), cwd=ROOT, capture_output=True, text=True, check=True).stdout
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        ]
    except (OSError, subprocess.CalledProcessError):
        return None
    return said[0].strip() + ("+" if said[1].strip() else "")


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model"))]
    return {
        "cpu": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.platform(),
        "python": platform.python_version(),
    }


def resident_mb() -> float:
    """What this process holds in memory."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def _rows(table: Table) -> dict[str, Any]:
    """A table as a list of rows by heading."""
    headings = [_plain(column.header) for column in table.columns]
    rows = zip(*(column.cells for column in table.columns), strict=True)
    return {
        "title": "" if table.title is None else _plain(table.title),
        "rows": [dict(zip(headings, map(_plain, row), strict=True)) for row in rows],
    }


def _plain(cell: Any) -> str:
    return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell)
