"""Every setting with its unit, default, bounds and meaning, read from the models that check the files.

The one source of docs/reference/settings.md, of the JSON schema and of `companion settings`: a meaning is the
docstring under its field; what an operator sets is marked `json_schema_extra=OPERATOR`, the rest is for
experts.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from companion.base.units import without_unit
from companion.config.reading import OPERATOR, descriptions

BOUND_SIGNS: Final = {"ge": "≥ {:g}", "gt": "> {:g}", "le": "≤ {:g}", "lt": "< {:g}"}


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting; `key` is dotted from the root of its file. `bounds` and `default` are as text."""

    key: str
    unit: str
    default: str
    bounds: str
    meaning: str
    for_operators: bool = False


def settings_of(
    model: type[BaseModel], prefix: str = "", defaults: BaseModel | None = None
) -> Iterator[Setting]:
    """The settings of a model and of those within it, in the order of the source.

    `defaults` is the instance, if any, that the model around it puts there by default.
    """
    told = descriptions(model)
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        inner = inner_model(field.annotation)
        if inner is not None:
            default = field.default if isinstance(field.default, BaseModel) else None
            yield from settings_of(inner, f"{key}.", default)
        elif not (field.discriminator is not None or (name == "kind" and field.is_required())):
            default_text = _default(field) if defaults is None else _value(getattr(defaults, name))
            meaning = told.get(name, field.description or "")
            operator = field.json_schema_extra == OPERATOR
            yield Setting(key, _unit(name), default_text, _bounds(field), meaning, operator)


def inner_model(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, when it holds exactly one."""
    kinds = [kind for kind in _alternatives(annotation) if kind is not type(None)]
    if len(kinds) == 1 and isinstance(kinds[0], type) and issubclass(kinds[0], BaseModel):
        return kinds[0]
    return None


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) in (Union, UnionType):
        return get_args(annotation)
    return (annotation,)


def _unit(name: str) -> str:
    name = re.sub(r"_(ned|body|sensor|pad)(?=_)", "", name)
    return without_unit(name)[1]


def _default(field: FieldInfo) -> str:
    value = field.default
    if value is PydanticUndefined:
        return "required" if field.default_factory is None else "none"
    return _value(value)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(part) for part in value) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None else str(value)


def _bounds(field: FieldInfo) -> str:
    signs = [
        sign.format(getattr(item, name))
        for item in (*field.metadata, *_annotations(field.annotation))
        for name, sign in BOUND_SIGNS.items()
        if hasattr(item, name) and getattr(item, name) is not None
    ]
    words = [_value(word) for kind in _alternatives(field.annotation) for word in _choices(kind)]
    return ", ".join(signs) + (" or " if signs and words else "") + " / ".join(words)


def _annotations(annotation: Any) -> Iterator[Any]:
    """Bounds that stand within the type: those of an alternative, or of a tuple's parts (all alike)."""
    for kind in _alternatives(annotation):
        parts = get_args(kind)
        if get_origin(kind) is Annotated:
            yield from (m for item in parts[1:] for m in getattr(item, "metadata", (item,)))
        elif get_origin(kind) is tuple and parts:
            yield from _annotations(parts[0])


def _choices(kind: Any) -> tuple[Any, ...]:
    if kind is bool:
        return (True, False)
    return get_args(kind) if get_origin(kind) is Literal else ()
