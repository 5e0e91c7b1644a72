"""The flights that are done, a CSV line each: what is there is not flown again."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final, cast

from tests.bench.faults.cases import PhaseName, Run
from tests.bench.faults.judge import Outcome


@dataclass(frozen=True, slots=True)
class Row:
    """One flight: what was flown by which state of the code, and how it ended.

    `began` is 0 when the flight was over before the fault. `said` is the app's last text, `ended_s` when the
    app ended.
    """

    fault: str
    phase: str
    scenario: str
    seed: int
    code: str
    began: int
    outcome: str
    unsafe: str
    ended_s: float
    said: str

    @property
    def run(self) -> Run:
        """What was flown."""
        return Run(self.fault, cast(PhaseName, self.phase), self.scenario, self.seed)

    @property
    def ending(self) -> Outcome:
        """How it ended."""
        return cast(Outcome, self.outcome)


WORDS: Final = ("fault", "phase", "scenario", "code", "outcome", "unsafe", "said")


class RunsFile:
    """The file; a line that an interruption has cut short counts as not flown."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self, code: str) -> list[Row]:
        """The flights of this state of the code."""
        if not self._path.exists():
            return []
        with self._path.open(newline="", encoding="utf-8") as file:
            found = [_row(line) for line in csv.DictReader(file)]
        return [row for row in found if row is not None and row.code == code]

    def append(self, row: Row) -> None:
        """Add one, at once."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = not self._path.exists()
        whole = new or self._path.read_bytes().endswith(b"\n")
        with self._path.open("a", newline="", encoding="utf-8") as file:
            if not whole:
                file.write("\n")
            writer = csv.DictWriter(file, [field.name for field in fields(Row)], lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerow(asdict(row))


def _row(line: dict[str, str]) -> Row | None:
    try:
        numbers = {"seed": int(line["seed"]), "began": int(line["began"]), "ended_s": float(line["ended_s"])}
        words = {
            name: line[name] for name in ("fault", "phase", "scenario", "code", "outcome", "unsafe", "said")
        }
        return Row(**words, **numbers) if None not in words.values() else None  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError):
        return None
