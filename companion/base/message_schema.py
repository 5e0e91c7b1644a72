"""JSON schemas of our messages, whole: element types, numbers of elements, units and axes in words.

They keep to what Foxglove's reader takes: an object has properties, an array has items of one plain kind or
objects. So an array of rows is one long array, and what is not known is left out rather than null.
"""

import dataclasses
import types
import typing
from enum import StrEnum
from typing import Any, Final, Literal, Union

import numpy as np

from companion.base.message_json import columns_of
from companion.base.units import without_unit

Schema = dict[str, Any]

_AXES: Final = {"ned": "north, east, down", "body": "forward, right, down", "camera": "right, down, ahead"}
_PLAIN: Final[dict[Any, str]] = {float: "number", int: "integer", bool: "boolean", str: "string"}


def schema_of(kind: Any) -> Schema:
    """The schema of a message dataclass, with the fields that are always there as `required`."""
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {
        "type": "object",
        "title": kind.__name__,
        "description": (kind.__doc__ or "").partition("\n")[0],
        "properties": {item.name: _field(kind, item.name, hints[item.name]) for item in fields},
        "required": [item.name for item in fields if _known(hints[item.name]) is hints[item.name]],
    }


def _field(kind: type[Any], name: str, hint: Any) -> Schema:
    schema = dict(_kind(_known(hint), columns_of(kind, name)))
    words = [*_axes(name, schema), *filter(None, (without_unit(name)[1],))]
    if "description" in schema:
        words.insert(0, schema.pop("description"))
    if _known(hint) is not hint:
        words.append("left out where it is not known")
    return {**schema, "description": "; ".join(words)} if words else schema


def _known(hint: Any) -> Any:
    """The type without None."""
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
