"""Counts each input's measurements: used or refused, with the reason of the last refusal. Pure.

A filter that refuses everything no longer fits, even if its covariance is small: `starved` reports that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from companion.base.messages import InputUse
from companion.estimate.gating import Gate
from companion.estimate.pad.observation_kinds import KINDS

# on the ground nothing is lost by a new start; in the air a receiver may be off for so long
STARVED_S: Final = 10.0
STARVED_SAMPLES: Final = 10  # in a row: one who has fallen silent is not refused
# the tests by which an input's measurements are refused; the others' noise is no input's
GATES: Final = {
    "gps": ("gps_velocity", "gps_position"),
    "mag": ("field", "mag"),
    "range": ("range",),
    **{kind.name: (kind.name,) for kind in KINDS},
}
NAMES: Final = {"imu": "IMU", "gps": "GPS"}


@dataclass(slots=True)
class _Count:
    used: int = 0
    refused: int = 0
    unusable: int = 0
    reason: str = ""
    in_a_row: int = 0
    since_s: float = math.inf  # when those in a row first were many
    gated: dict[str, int] = field(default_factory=dict)


class InputTally:
    """Counts by input: `imu`, `mag`, `gps`, `range`, `attitude`, and the kinds of observations."""

    def __init__(self) -> None:
        self._counts: dict[str, _Count] = {}

    def note(self, kind: str, why_not: str, gates: Callable[[], Mapping[str, Gate]]) -> None:
        """Count one; `why_not` is empty where it was taken, `gates` tells how all have fared so far."""
        count = self._counts.get(kind)
        if count is None:
            count = self._counts[kind] = _Count()
        failed = []
        for name in GATES.get(kind, ()):
            refused = gates().get(name, Gate()).refused
            if refused > count.gated.get(name, 0):
                failed.append(name)
            count.gated[name] = refused
        if why_not:
            count.unusable += 1
        elif failed:
            why_not = f"innovation test: {', '.join(failed)}"
        if not why_not:
            count.used, count.in_a_row = count.used + 1, 0
            return
        count.refused, count.in_a_row, count.reason = count.refused + 1, count.in_a_row + 1, why_not

    @property
    def unusable(self) -> dict[str, int]:
        """By input, what no filter was given: not finite, of a wrong time, before the alignment."""
        return {kind: count.unusable for kind, count in self._counts.items() if count.unusable}

    def uses(self) -> tuple[InputUse, ...]:
        """All inputs so far."""
        return tuple(
            InputUse(kind, count.used, count.refused, count.in_a_row, count.reason)
            for kind, count in sorted(self._counts.items())
        )

    def starved(self, kind: str, now_s: float) -> str | None:
        """Ask each second: why an input has been refused for all of `STARVED_S`, else None."""
        count = self._counts.get(kind, _Count())
        if count.in_a_row < STARVED_SAMPLES:
            count.since_s = math.inf
            return None
        count.since_s = min(count.since_s, now_s)
        if now_s - count.since_s < STARVED_S:
            return None
        return f"{NAMES[kind]} refused for {now_s - count.since_s:.0f} s: {count.reason}"
