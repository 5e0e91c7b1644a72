"""The simulated autopilot's parameter table: what a ground station lists, reads and sets.

Small: the flight code reads the ones that act in flight, the others describe the vehicle. Values keep
the unit that the real autopilot gives them (ArduPilot: cm/s, cm); `ParameterRef` carries the factor to SI.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry: its name (at most 16 characters), default, bounds, whether it is an integer, its bits."""

    name: str
    default: float
    minimum: float
    maximum: float
    integer: bool = False
    bits: int = 32


@dataclass(frozen=True, slots=True)
class ParameterRef:
    """A parameter as the flight code reads it: value times `scale` is in SI units."""

    name: str
    scale: float = 1.0


class Parameters:
    """Current values of a fixed set of parameters, in the order they are listed."""

    def __init__(self, table: Iterable[Parameter]) -> None:
        self._table = {parameter.name: parameter for parameter in table}
        self._names = tuple(self._table)
        self._indices = {name: index for index, name in enumerate(self._names)}
        self._values: dict[str, float] = {}
        self.reset()

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def name_at(self, index: int) -> str | None:
        """Name of the index-th parameter, None past either end."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """Place of a known name in the list."""
        return self._indices[name]

    def is_integer(self, name: str) -> bool:
        """Whether a known parameter holds an integer."""
        return self._table[name].integer

    def bits(self, name: str) -> int:
        """Size of a known parameter's number."""
        return self._table[name].bits

    def reset(self) -> None:
        """All defaults again."""
        self._values = {parameter.name: float(parameter.default) for parameter in self._table.values()}

    def si(self, setting: ParameterRef) -> float:
        """Value in SI units."""
        return self._values[setting.name] * setting.scale

    def set(self, name: str, value: float) -> bool:
        """Store a value, rounded for an integer; False (and nothing stored) when unknown or out of bounds."""
        parameter = self._table.get(name)
        if parameter is None or not parameter.minimum <= value <= parameter.maximum:
            return False
        self._values[name] = float(round(value)) if parameter.integer else value
        return True
