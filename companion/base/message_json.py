"""Messages as JSON, as they stand in the flight log, and back: every float with all its digits.

Arrays and tuples are lists; NaN and infinity, which JSON does not know, are null.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, TypeVar

import numpy as np
from pydantic_core import to_json

T = TypeVar("T")


def encode(message: Any) -> bytes:
    """JSON of a message dataclass; arrays become lists, NaN and infinity become null."""
    return to_json(message, inf_nan_mode="null", fallback=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot log a {type(value).__name__}")


def decode(kind: type[T], plain: dict[str, Any]) -> T:
    """A message dataclass from its JSON: the inverse of `encode`, but for infinity, which becomes NaN.

    Fields that the class does not know are passed over.

    Raises:
        TypeError: a field without a default is missing.
        ValueError: an array is not one of numbers.
    """
    values = {
        item.name: _value(str(item.type), plain[item.name])
        for item in dataclasses.fields(kind)  # type: ignore[arg-type]
        if item.name in plain
    }
    return kind(**values)


def _value(annotation: str, plain: Any) -> Any:
    if plain is None:
        return None if "None" in annotation else math.nan
    if annotation.startswith("FloatArray"):
        return np.array(plain, dtype=float)
    if isinstance(plain, list):
        return tuple(math.nan if value is None else value for value in plain)
    return plain


def schema_of(kind: type[Any]) -> dict[str, Any]:
    """A JSON schema of a message dataclass, as much as Foxglove needs to plot its fields."""
    properties: dict[str, Any] = {}
    for item in dataclasses.fields(kind):
        properties[item.name] = _schema_of_annotation(str(item.type))
    return {"type": "object", "title": kind.__name__, "properties": properties}


_SEQUENCES: Final = ("Vector3", "Quaternion", "tuple", "FloatArray", "NDArray", "list")
_SCALARS: Final = {"float": "number", "int": "integer", "bool": "boolean"}


def _schema_of_annotation(annotation: str) -> dict[str, Any]:
    if annotation.startswith(_SEQUENCES):
        return {"type": "array", "items": {}}
    if annotation.startswith("dict"):
        return {"type": "object"}
    return {"type": _SCALARS.get(annotation.split(" ", maxsplit=1)[0], "string")}
