"""What a key that nobody knows was probably meant to be: the nearest of the names that are known there."""

import functools
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any

from pydantic import BaseModel

# a slip of the fingers or a forgotten unit; 'gain' for 'wings' is none
LIKENESS = 0.7
# what a setting was called before, where its name is now like another's or like none
FORMER = {
    "contact_lean_deg": ("contact_deck_tilt_deg",),
    "command_patience_s": ("command_timeout_s",),
    "patience_s": ("gentle_wait_s", "sighting_timeout_s"),
}


def near_name(model: type[BaseModel], key: Sequence[str]) -> str | None:
    """The nearest name to the last part of a key, among those that the model knows in its place."""
    schema = _schema(model)
    here = [schema]
    for part in key[:-1]:
        here = [inner for outer in here for inner in _inside(outer, part, schema)]
    known = {name for outer in here for kind in _kinds(outer, schema) for name in kind.get("properties", ())}
    now = [name for name in FORMER.get(key[-1], ()) if name in known]
    return next(iter(now or get_close_matches(key[-1], sorted(known), 1, LIKENESS)), None)


@functools.cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    """The model's JSON schema; of the whole tree it takes a third of a second to make."""
    return model.model_json_schema()


def _kinds(schema: dict[str, Any], root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """All that a part of the schema may be."""
    if "$ref" in schema:
        yield from _kinds(root["$defs"][schema["$ref"].rsplit("/", 1)[1]], root)
        return
    yield schema
    for word in ("anyOf", "oneOf", "allOf"):
        for kind in schema.get(word, ()):
            yield from _kinds(kind, root)


def _inside(schema: dict[str, Any], part: str, root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for kind in _kinds(schema, root):
        candidates = [
            kind.get("properties", {}).get(part),
            kind.get("additionalProperties"),
            kind.get("items"),
        ]
        candidates += kind.get("prefixItems", ())
        yield from (inner for inner in candidates if isinstance(inner, dict))
