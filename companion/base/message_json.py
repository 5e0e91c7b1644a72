"""Messages as JSON, as they stand in the flight log, and back: every float with all its digits.

Arrays and tuples are lists, an array of rows one list of all numbers (older logs: a list a row). What is None
is left out; NaN and infinity, which JSON does not know, are null.
"""

import dataclasses
import math
import types
import typing
from enum import StrEnum
from functools import cache
from typing import Any, Final, Literal, TypeVar, Union

import numpy as np
from pydantic_core import to_json

from companion.base.units import without_unit

T = TypeVar("T")
# in the metadata of a field that holds rows: the numbers in each
COLUMNS: Final = "columns"


def encode(message: Any) -> bytes:
    """JSON of a message dataclass; arrays become lists, NaN and infinity become null."""
    return to_json(_fields_of(message), inf_nan_mode="null", fallback=_plain)


def _fields_of(message: Any) -> dict[str, Any]:
    """What is known, by name; rows as one list."""
    names, rows = _layout(type(message))  # type: ignore[arg-type]
    values = {name: value for name in names if (value := getattr(message, name)) is not None}
    for name, value in values.items():
        if hasattr(value, "__dataclass_fields__"):
            values[name] = _fields_of(value)
        elif isinstance(value, tuple) and value and hasattr(value[0], "__dataclass_fields__"):
            values[name] = [_fields_of(item) for item in value]
    for name in rows:
        values[name] = [number for row in values[name] for number in row]
    return values


@cache
def _layout(kind: type[Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of all fields, and of those that hold their rows as tuples."""
    if not dataclasses.is_dataclass(kind):
        raise TypeError(f"cannot log a {kind.__name__}")
    rows = tuple(name for name, annotation, _ in _fields(kind) if annotation.startswith("tuple[tuple"))
    return tuple(name for name, _, _ in _fields(kind)), rows


@cache
def _fields(kind: type[Any]) -> tuple[tuple[str, str, int | None], ...]:
    """Of each field its name, its type as it is written, and how many numbers a row of it has."""
    return tuple((item.name, str(item.type), item.metadata.get(COLUMNS)) for item in dataclasses.fields(kind))


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
        name: _value(annotation, plain[name], columns)
        for name, annotation, columns in _fields(kind)  # type: ignore[arg-type]
        if name in plain
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


# ---------------------------------------------------------------- schemas
# Whole: element types, numbers of elements, units and axes in words. They keep to what Foxglove's reader
# takes: an object has properties, an array has items of one plain kind or objects. So an array of rows is one
# long array, and what is not known is left out rather than null.

Schema = dict[str, Any]

_AXES: Final = {"ned": "north, east, down", "body": "forward, right, down", "camera": "right, down, ahead"}
_PLAIN: Final[dict[Any, str]] = {float: "number", int: "integer", bool: "boolean", str: "string"}


def schema_of(kind: Any) -> Schema:
    """The schema of a message dataclass, with the fields that are always there as `required`."""
    hints = typing.get_type_hints(kind)
    fields = _fields(kind)
    return {
        "type": "object",
        "title": kind.__name__,
        "description": (kind.__doc__ or "").partition("\n")[0],
        "properties": {name: _field(name, hints[name], columns) for name, _, columns in fields},
        "required": [name for name, _, _ in fields if _known(hints[name]) is hints[name]],
    }


def _field(name: str, hint: Any, columns: int | None) -> Schema:
    schema = dict(_kind(_known(hint), columns))
    words = [*_axes(name, schema), *filter(None, (without_unit(name)[1],))]
    if "description" in schema:
        words.insert(0, schema.pop("description"))
    if _known(hint) is not hint:
        words.append("left out where it is not known")
    return {**schema, "description": "; ".join(words)} if words else schema


def _known(hint: Any) -> Any:
    if typing.get_origin(hint) in (Union, types.UnionType):
        (known,) = (part for part in typing.get_args(hint) if part is not type(None))
        return known
    return hint


def _kind(hint: Any, columns: int | None) -> Schema:
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin in (tuple, np.ndarray):
        return _array(origin, parts, columns)
    if origin is dict:
        items = _kind(parts[1], None)
        keys = dict.fromkeys(typing.get_args(parts[0]), items)
        return {"type": "object", "properties": keys, "additionalProperties": items}
    if dataclasses.is_dataclass(hint):
        return schema_of(hint)
    return _scalar(hint, parts)


def _scalar(hint: Any, choices: tuple[Any, ...]) -> Schema:
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if typing.get_origin(hint) is Literal:
        return {"type": "string", "enum": list(choices)}
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return {"type": "string", "enum": [item.value for item in hint]}
    raise TypeError(f"a message cannot hold {hint}: no schema for it")


def _array(origin: Any, parts: tuple[Any, ...], columns: int | None) -> Schema:
    if columns is not None:
        rows = f"rows of {columns}, one after another"
        return {"type": "array", "items": {"type": "number"}, "description": rows}
    if origin is np.ndarray:
        return {"type": "array", "items": {"type": "number"}}
    items = _kind(parts[0], None)
    fixed = {} if parts[1:] == (...,) else {"minItems": len(parts), "maxItems": len(parts)}
    return {"type": "array", "items": items, **fixed}


def _axes(name: str, schema: Schema) -> list[str]:
    if schema.get("minItems") == 4:
        return ["unit quaternion w, x, y, z"]
    if schema.get("minItems") != 3:
        return []
    if name in ("origin", "position"):
        return ["latitude °, longitude °, altitude or height m"]
    return [words for axes, words in _AXES.items() if f"_{axes}" in name]
