"""How far a campaign is: a live bar on a terminal, a line now and then in a log."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Final

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from sitl.campaign.rows import Row

LINES_IN_ALL: Final = 10


class CampaignMeter:
    """Counts runs and landings; prints each run that did not land, and the command that repeats it."""

    def __init__(self, console: Console, rows: Sequence[Row], total: int, *, quiet: bool) -> None:
        """Begin with the rows there are; `total` counts them too. Quiet: lines, as for a log."""
        self._console = console
        self._total = total
        self._done = len(rows)
        self._landed = sum(row.landed for row in rows)
        self._bar = None if quiet or not console.is_terminal else _bar(console)

    def __enter__(self) -> CampaignMeter:
        if self._bar is not None:
            self._bar.start()
            self._task = self._bar.add_task(
                "runs", total=self._total, completed=self._done, words=self._words()
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def take(self, row: Row) -> None:
        """A run has ended."""
        tenth = self._done * LINES_IN_ALL // self._total
        self._done += 1
        self._landed += row.landed
        if not row.landed:
            said = row.reason or row.error
            self._console.print(
                f"{row.outcome}: {said}: {row.command}", highlight=False, markup=False, soft_wrap=True
            )
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, words=self._words())
        elif self._done * LINES_IN_ALL // self._total > tenth:
            self._console.print(f"{self._done} of {self._total} runs, {self._words()}", highlight=False)

    def _words(self) -> str:
        return f"{self._landed} landed" + (
            f" ({100 * self._landed / self._done:.0f} %)" if self._done else ""
        )


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[words]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
