"""The trials: which moment of a flight is interrupted how, and the file of those that are done."""

from __future__ import annotations

import json
import random
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal, get_args

Kind = Literal["kill", "stop", "term"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
# Phases of a good flight in their order, and how long (s) each lasts here: a moment is drawn in each in turn,
# else it would be the climb nearly always.
PHASES: Final = {
    "standby": 3.0,
    "connect": 1.0,
    "arm": 1.0,
    "take_off": 6.0,
    "waypoint": 2.0,
    "search": 2.0,
    "approach": 3.0,
    "descend": 5.0,
    "touchdown": 3.0,
    "landed": 1.0,
}
# of the committed vehicle, the last third of a metre, it takes most to be sure
ORDER: Final = ("descend", "standby", "touchdown", "approach", "take_off", "search", "landed", "waypoint",
                "touchdown", "arm", "connect")  # fmt: skip


@dataclass(frozen=True, slots=True)
class InterruptionMoment:
    """When to interrupt: so long (s) after a phase, or a later one, has begun."""

    phase: str
    delay_s: float


def moment(kind: Kind, seed: int) -> InterruptionMoment:
    """The moment of a trial."""
    phase = ORDER[(seed + 3 * KINDS.index(kind)) % len(ORDER)]
    return InterruptionMoment(phase, random.Random(f"{kind} {seed}").uniform(0.0, PHASES[phase]))


def reached(phase: str, wanted: str) -> bool:
    """Whether a flight in `phase` has come to `wanted`, or has passed it over."""
    names = list(PHASES)
    return phase in names and names.index(phase) >= names.index(wanted)


@dataclass(frozen=True, slots=True)
class InterruptedTrial:
    """A trial that is done: what was interrupted, on which state of the code, and what was found unsafe.

    `failsafe_s` is how long the autopilot took to leave OFFBOARD; None where it was not in it.
    """

    kind: Kind
    seed: int
    code: str
    phase: str
    ordered_s: float
    failsafe_s: float | None
    found: tuple[str, ...]


class TrialsFile:
    """One line of JSON a trial; what an interruption has cut short was not flown."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self, code: str) -> dict[tuple[Kind, int], InterruptedTrial]:
        """The trials of this state of the code."""
        lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() else []
        trials = [trial for trial in map(_trial, lines) if trial is not None and trial.code == code]
        return {(trial.kind, trial.seed): trial for trial in trials}

    def append(self, trial: InterruptedTrial) -> None:
        """Add one, at once."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        cut = self._path.exists() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("a", encoding="utf-8") as file:
            file.write("\n" * cut + json.dumps(asdict(trial)) + "\n")


def _trial(line: str) -> InterruptedTrial | None:
    try:
        told = json.loads(line)
        return InterruptedTrial(**told | {"found": tuple(told["found"])})
    except (ValueError, TypeError, KeyError):
        return None
