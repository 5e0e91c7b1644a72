"""How many samples of each input were used, how many refused, and why the last one was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Final, NamedTuple

UNUSABLE: Final = "not finite, of a wrong time, or before it could be used"
# which innovation tests judge an input
GATES: Final = {
    "sighting": ("sighting",),
    "range": ("range",),
    "gps": ("gps_position", "gps_velocity"),
    "mag": ("mag", "field"),
    "attitude": ("second_attitude",),
}


class InputCount(NamedTuple):
    """Of one input; `reason` is why one was refused last, empty when none was."""

    used: int
    refused: int
    reason: str


class InputCounts:
    """Counts what comes in; what an innovation test refuses is counted by its gate."""

    def __init__(self) -> None:
        self.unusable: Counter[str] = Counter()
        self._taken: Counter[str] = Counter()
        self._gated: dict[str, int] = {}
        self._reasons: dict[str, str] = {}

    def count(self, kind: str, taken: bool) -> bool:
        """Count one sample; returns whether it was taken."""
        if taken:
            self._taken[kind] += 1
        else:
            self.unusable[kind] += 1
            self._reasons[kind] = UNUSABLE
        return taken

    def report(self, gates: Mapping[str, int]) -> dict[str, InputCount]:
        """By kind of input; `gates` is how many each innovation test has refused."""
        return {
            kind: self._of(kind, {name: gates[name] for name in GATES.get(kind, ()) if name in gates})
            for kind in sorted({*self._taken, *self.unusable})
        }

    def _of(self, kind: str, gates: dict[str, int]) -> InputCount:
        for name, refused in gates.items():
            if refused > self._gated.get(name, 0):
                self._reasons[kind] = f"{name.replace('_', ' ')}: off what was expected"
            self._gated[name] = refused
        gated = max(gates.values(), default=0)  # the tests of one sample
        used = max(self._taken[kind] - gated, 0)
        return InputCount(used, self.unusable[kind] + gated, self._reasons.get(kind, ""))
