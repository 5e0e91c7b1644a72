"""To freeze a stage in flight, and to go on in another process as if it had never stopped.

A stage is a tree of parts: objects of this package that change. `parts` walks it in a fixed order, each part
once, so that what two of them share is shared again in the new tree. Of a part everything is kept but its
settings, which are the new one's own; a filter that can be put back (`gating.Replayable`) gives its snapshot.

Values are kept as plain data that strict JSON keeps to the bit: numbers, texts, and lists for tuples; all
else is a dict of one key that names what it is, such as {"array": [[1.0, 0.0], [0.0, 1.0]]},
{"float": "-inf"} or {"estimate.gating.Gate": [4, 0, 0, 0.0]}.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from pydantic import BaseModel

from companion.estimate.gating import Replayable

FORMAT: Final = 1
_PARTS: Final = "companion.estimate."
_RECORDS: Final = "companion."
_GIVEN: Final = (BaseModel, MappingProxyType)  # settings: read-only, and the new object has its own
_SEALED: Final = ("format", "settings", "start", "parts")


def freeze(root: object, settings: Mapping[str, Any], start: object) -> dict[str, Any]:
    """A stage as plain data; `start` is what the new one needs before it can have the same parts.

    Raises:
        TypeError: the stage holds what cannot be frozen.
    """
    state = {"format": FORMAT, "settings": dict(settings), "start": plain(start), "parts": held(root)}
    return {**state, "digest": _digest(state)}


def opened(state: Mapping[str, Any], settings: Mapping[str, Any]) -> Any:
    """What was given to `freeze` as `start`, after a look at the seal.

    Raises:
        ValueError: damaged or truncated, or frozen by another version or with other settings.
    """
    if not isinstance(state, Mapping) or state.get("format") != FORMAT:
        raise ValueError(f"frozen state: expected one of format {FORMAT}")
    if set(state) != {*_SEALED, "digest"} or state["digest"] != _digest(state):
        raise ValueError("frozen state: damaged or truncated, its digest does not fit")
    for name, frozen, now in _differences("", state["settings"], dict(settings)):
        raise ValueError(f"frozen state: was frozen with {name} {frozen!r}, expected {now!r}")
    return thawed(state["start"])


def held(root: object) -> list[Any]:
    """What all parts of a tree hold: [[part's class, {attribute: plain data}], ...]."""
    return [[_name(type(part)), _held(part)] for part in parts(root)]


def fill(root: object, state: list[Any]) -> None:
    """Give all parts of a tree what `held` found in another.

    Raises:
        ValueError: the other tree is of another shape, hence of another version.
    """
    tree = list(parts(root))
    shape = [(_name(type(part)), set(_held(part))) for part in tree]
    if shape != [(name, set(values)) for name, values in state]:
        raise ValueError("frozen state: its parts are those of another version")
    for part, (_, values) in zip(tree, state, strict=True):
        if isinstance(part, Replayable):
            part.restore(thawed(values["snapshot"]))
        else:
            vars(part).update((name, thawed(value)) for name, value in values.items())


def parts(root: object, met: set[int] | None = None) -> Iterator[object]:
    """The root and the parts under it, each once, in the order of their attributes; none under a filter."""
    met = set() if met is None else met
    if id(root) in met:
        return
    met.add(id(root))
    yield root
    for value in () if isinstance(root, Replayable) else vars(root).values():
        if _is_part(value):
            yield from parts(value, met)


def plain(value: Any) -> Any:
    """Plain data of a value; `thawed` makes the value of it again.

    Raises:
        TypeError: a value of a kind that is not known here.
    """
    kind = type(value)
    if value is None or kind in (bool, int, str) or (kind is float and math.isfinite(value)):
        return value
    if kind is tuple:
        return [plain(item) for item in value]
    return dict([_tagged(value, kind)])


def _tagged(value: Any, kind: type) -> tuple[str, Any]:
    tag = kind.__name__
    content: Any
    if kind is float:
        content = repr(value)
    elif isinstance(value, np.ndarray | np.generic):
        # sums run in the order of the memory: an array by columns must become one by columns
        by_columns = isinstance(value, np.ndarray) and value.flags.fnc
        tag, content = ("array_by_columns", value.T.tolist()) if by_columns else ("array", value.tolist())
    elif kind is list:
        content = [plain(item) for item in value]
    elif kind is dict and all(type(key) is str for key in value):
        content = {key: plain(item) for key, item in value.items()}
    elif _is_record(kind):
        tag, content = _name(kind), [plain(getattr(value, name)) for name in _fields(kind)]
    else:
        raise TypeError(f"cannot freeze a {tag}")
    return tag, content


def thawed(data: Any) -> Any:
    """The inverse of `plain`.

    Raises:
        ValueError: a record that this version does not know, or knows with other fields.
    """
    if isinstance(data, list):
        return tuple(thawed(item) for item in data)
    if not isinstance(data, dict):
        return data
    ((tag, content),) = data.items()
    make = _MAKERS.get(tag)
    return make(content) if make else _record(tag, content)


def _record(name: str, content: list[Any]) -> Any:
    module, _, kind_name = name.rpartition(".")
    kind = getattr(sys.modules.get(_RECORDS + module), kind_name, None)
    if not isinstance(kind, type) or not _is_record(kind) or len(_fields(kind)) != len(content):
        raise ValueError(f"frozen state: a {name} is of another version")
    return kind(*(thawed(item) for item in content))


_MAKERS: Final[dict[str, Callable[[Any], Any]]] = {
    "float": float,
    "array": lambda content: np.array(content)[()],
    "array_by_columns": lambda content: np.array(content).T,
    "list": lambda content: [thawed(item) for item in content],
    "dict": lambda content: {key: thawed(item) for key, item in content.items()},
}


def _held(part: object) -> dict[str, Any]:
    if isinstance(part, Replayable):
        return {"snapshot": plain(part.snapshot())}
    own = {name: value for name, value in vars(part).items() if not isinstance(value, _GIVEN)}
    return {name: plain(value) for name, value in own.items() if not _is_part(value)}


def _is_part(value: object) -> bool:
    return type(value).__module__.startswith(_PARTS) and not _is_record(type(value))


def _is_record(kind: type) -> bool:
    """A dataclass or NamedTuple of ours: made of its fields and nothing else."""
    of_ours = kind.__module__.startswith(_RECORDS)
    return of_ours and (is_dataclass(kind) or (issubclass(kind, tuple) and hasattr(kind, "_fields")))


def _fields(kind: type) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind)) if is_dataclass(kind) else kind._fields  # type: ignore[attr-defined]


def _name(kind: type) -> str:
    return f"{kind.__module__.removeprefix(_RECORDS)}.{kind.__qualname__}"


def _digest(state: Mapping[str, Any]) -> str:
    text = json.dumps([state[name] for name in _SEALED], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _differences(name: str, one: Any, other: Any) -> Iterator[tuple[str, Any, Any]]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other}):
            yield from _differences(f"{name}.{key}".lstrip("."), one.get(key), other.get(key))
    elif one != other:
        yield name, one, other
