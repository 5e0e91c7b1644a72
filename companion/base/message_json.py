"""Messages as JSON, as they stand in the flight log, and back: every float with all its digits.

Arrays and tuples are lists, an array of rows one list of all numbers (older logs: a list a row). What is None
is left out; NaN and infinity, which JSON does not know, are null.
"""

import dataclasses
import math
from typing import Any, Final, TypeVar

import numpy as np
from pydantic_core import to_json

T = TypeVar("T")
# in the metadata of a field that holds rows: the numbers in each
COLUMNS: Final = "columns"


def encode(message: Any) -> bytes:
    """JSON of a message dataclass; arrays become lists, NaN and infinity become null."""
    return to_json(_fields_of(message), inf_nan_mode="null", fallback=_plain)


def _fields_of(message: Any) -> dict[str, Any]:
    """What is known, by name; rows as one list."""
    names, rows = _layout(type(message))
    values = {name: value for name in names if (value := getattr(message, name)) is not None}
    for name, value in values.items():
        if hasattr(value, "__dataclass_fields__"):
            values[name] = _fields_of(value)
        elif isinstance(value, tuple) and value and hasattr(value[0], "__dataclass_fields__"):
            values[name] = [_fields_of(item) for item in value]
    for name in rows:
        values[name] = [number for row in values[name] for number in row]
    return values


_Layout = tuple[tuple[str, ...], tuple[str, ...]]
_LAYOUTS: Final[dict[type[Any], _Layout]] = {}


def _layout(kind: type[Any]) -> _Layout:
    """The names of all fields, and of those that hold their rows as tuples."""
    if kind not in _LAYOUTS:
        if not dataclasses.is_dataclass(kind):
            raise TypeError(f"cannot log a {kind.__name__}")
        fields = dataclasses.fields(kind)
        rows = tuple(item.name for item in fields if str(item.type).startswith("tuple[tuple"))
        _LAYOUTS[kind] = (tuple(item.name for item in fields), rows)
    return _LAYOUTS[kind]


def columns_of(kind: type[Any], name: str) -> int | None:
    """How many numbers a row of this field has; None for a field without rows."""
    (item,) = (item for item in dataclasses.fields(kind) if item.name == name)
    columns: int | None = item.metadata.get(COLUMNS)
    return columns


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot log a {type(value).__name__}")


def decode(kind: type[T], plain: dict[str, Any]) -> T:
    """A message dataclass from its JSON: the inverse of `encode`, but for infinity, which becomes NaN.

    Fields that the class does not know are passed over.

    Raises:
        TypeError: a field without a default is missing.
        ValueError: an array is not one of numbers.
    """
    values = {
        item.name: _value(str(item.type), plain[item.name], item.metadata.get(COLUMNS))
        for item in dataclasses.fields(kind)  # type: ignore[arg-type]
        if item.name in plain
    }
    return kind(**values)


def _value(annotation: str, plain: Any, columns: int | None) -> Any:
    if plain is None:
        return None if "None" in annotation else math.nan
    if annotation.startswith("FloatArray"):
        array = np.array(plain, dtype=float)
        return array if columns is None else array.reshape(-1, columns)
    if columns is not None:
        return tuple(tuple(row) for row in np.array(plain, dtype=float).reshape(-1, columns).tolist())
    if isinstance(plain, list):
        return tuple(math.nan if value is None else value for value in plain)
    return plain
