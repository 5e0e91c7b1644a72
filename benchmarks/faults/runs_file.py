"""The flights that are done, a CSV line each: what is there is not flown again."""

import csv
import hashlib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final, cast

from benchmarks.faults.cases import FaultRun, PhaseName
from companion.base.autopilot_kind import AutopilotKind
from companion.config import CONFIG_FOLDER
from sitl.campaign.manifest import code_digest


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One flight: what was flown by which state of the code, and how it ended.

    `code` is `flights_key`. `began` is 0 when the flight was over before the fault. `said` is the app's last
    text, `ended_s` when the app ended.
    """

    fault: str
    phase: str
    scenario: str
    seed: int
    autopilot: str
    code: str
    began: int
    outcome: str
    unsafe: str
    ended_s: float
    said: str

    @property
    def run(self) -> FaultRun:
        """What was flown."""
        autopilot = cast(AutopilotKind, self.autopilot)
        return FaultRun(self.fault, cast(PhaseName, self.phase), self.scenario, self.seed, autopilot)


WORDS: Final = ("fault", "phase", "scenario", "autopilot", "code", "outcome", "unsafe", "said")


_BENCH: Final = Path(__file__).resolve().parent
_KEY_LENGTH: Final = 12


def flights_key(code: str | None = None, *, bench: Path = _BENCH, configs: Path = CONFIG_FOLDER) -> str:
    """Digest of all that decides a row: the program, the settings and scenarios, the cases and the judge."""
    total = hashlib.sha256((code or code_digest()).encode())
    for folder, pattern in ((bench, "*.py"), (configs, "*")):
        for path in sorted(path for path in folder.rglob(pattern) if path.is_file()):
            for part in (str(path.relative_to(folder)).encode(), path.read_bytes()):
                total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:_KEY_LENGTH]


class FaultRunsFile:
    """The file; a line that an interruption has cut short counts as not flown."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def _whole(self) -> bytes:
        """The lines that are complete."""
        there = self._path.read_bytes() if self._path.exists() else b""
        return there[: there.rfind(b"\n") + 1]

    def read(self, code: str) -> list[FaultRow]:
        """The flights of this state of the code."""
        lines = self._whole().decode("utf-8").splitlines()
        return [row for row in map(_row, csv.DictReader(lines)) if row is not None and row.code == code]

    def append(self, row: FaultRow) -> None:
        """Add one, at once."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        whole = self._whole()
        with self._path.open("r+b" if self._path.exists() else "wb") as file:
            file.truncate(len(whole))
        with self._path.open("a", newline="", encoding="utf-8") as text:
            writer = csv.DictWriter(text, [field.name for field in fields(FaultRow)], lineterminator="\n")
            if not whole:
                writer.writeheader()
            writer.writerow({name: _in_a_line(value) for name, value in asdict(row).items()})


def _in_a_line(value: object) -> object:
    return " ".join(value.split()) if isinstance(value, str) else value


def _row(line: dict[str, str]) -> FaultRow | None:
    try:
        numbers = {"seed": int(line["seed"]), "began": int(line["began"]), "ended_s": float(line["ended_s"])}
        words = {name: line[name] for name in WORDS}
        return FaultRow(**words, **numbers) if None not in words.values() else None  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError):
        return None
