"""Mutants of the last gate that no test can tell from it, and why."""

from __future__ import annotations

from typing import Final

_ROUNDING: Final = "an allowance for rounding: a thousand times smaller than what any autopilot resolves"
_EDGE: Final = "differs only for a number that is the bound, its allowance included, to the last bit"
_STAMP: Final = "`apply` stamps what leaves with its own time"
_BETWEEN: Final = "if low - 1e-12 <= value <= high + 1e-12:"
_CHANGE: Final = "low - 1e-12 <= value <= high + 1e-12"
_NUMBER: Final = "numbers.append(size if size > 1e-6 else math.inf)  # no direction is no number either"
_LEVEL: Final = "return Setpoint(time_s=0.0, heading_rad=heading"
SURVIVORS: Final[dict[str, str]] = {
    "ROUNDING = 1.0 + 1e-9: 1e-09  ->  1.5000000000000002e-09": _ROUNDING,
    "if size <= most * ROUNDING:: most * ROUNDING  ->  most / ROUNDING": _ROUNDING,
    f"{_BETWEEN}: 1e-12  ->  0.0": _ROUNDING,
    f"{_BETWEEN}: 1e-12  ->  1.5e-12": _ROUNDING,
    "if size <= radius * ROUNDING:: size <= radius * ROUNDING  ->  size < radius * ROUNDING": _EDGE,
    f"{_BETWEEN}: {_CHANGE}  ->  low - 1e-12 < value <= high + 1e-12": _EDGE,
    f"{_BETWEEN}: {_CHANGE}  ->  low - 1e-12 <= value < high + 1e-12": _EDGE,
    f"{_NUMBER}: size > 1e-06  ->  size >= 1e-06": _EDGE,
    f"{_NUMBER}: 1e-06  ->  1.5e-06": "no estimate gives a quaternion of this size; as small a one is a hold",
    f"{_LEVEL}): 0.0  ->  1.0": _STAMP,
    f"{_LEVEL}, attitude=upright, thrust=self._hover_thrust): 0.0  ->  1.0": _STAMP,
}
