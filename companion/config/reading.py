"""Reading settings: YAML into strict models, and one line for what is wrong with it."""

import ast
import copy
import functools
import re
import sys
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.config import JsonDict
from pydantic_core import ErrorDetails

from companion.base.errors import ConfigError
from companion.base.files import SETTINGS_FILE, cannot_read

# ---------------------------------------------------------------- what an unknown key may have meant

# a slip of the fingers or a forgotten unit; 'gain' for 'wings' is none
LIKENESS = 0.7
# what a setting was called before, where its name is now like another's or like none
FORMER = {
    "contact_lean_deg": ("contact_deck_tilt_deg",),
    "command_patience_s": ("command_timeout_s",),
    "patience_s": ("sighting_timeout_s",),
}


def near_name(model: type[BaseModel], key: Sequence[str]) -> str | None:
    """The nearest name to the last part of a key, among those that the model knows in its place."""
    here = [model]
    for part in key[:-1]:  # that of an item of a list or a mapping is no field's name
        here = [inner for kind in here for inner in _inside(kind, part)] or here
    known = {field.alias or name for kind in here for name, field in kind.model_fields.items()}
    now = [name for name in FORMER.get(key[-1], ()) if name in known]
    return next(iter(now or get_close_matches(key[-1], sorted(known), 1, LIKENESS)), None)


def _inside(kind: type[BaseModel], part: str) -> list[type[BaseModel]]:
    fields = (field for name, field in kind.model_fields.items() if part == (field.alias or name))
    return [inner for field in fields for inner in models_in(field.annotation)]


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that a value of a type may hold, by itself or in a list or mapping."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models_in(part)


# marks the settings that an operator sets: `json_schema_extra=OPERATOR`; the others are for experts
OPERATOR: Final[JsonDict] = {"audience": "operator"}

_LONGEST_FOUND = 80
_NAMED = 4
# The shipped files nest seven deep. Far deeper, libyaml's composer overruns the stack: the process dies.
_DEEPEST = 100
# pydantic's words for these name its own types
_EXPECTED = {
    "missing": "expected a value, found none",
    "dict_type": "expected keys with values",
    "model_type": "expected keys with values",
    "tuple_type": "expected a list",
}


def _describe(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Put the descriptions into a model's JSON schema."""
    properties = schema.get("properties", {})
    for name, text in descriptions(model).items():
        properties[model.model_fields[name].alias or name]["description"] = text


class StrictModel(BaseModel):
    """Base of all settings: unknown keys are refused, values cannot change after loading.

    The docstring under a field is its description: what the setting means, and when to change it.
    """

    # a validator is built when it is first used, and a part's own never: a quarter of a start's imports
    model_config = ConfigDict(
        defer_build=True, extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=_describe
    )


def descriptions(model: type[BaseModel]) -> dict[str, str]:
    """What the fields mean, by name.

    The source is read when somebody asks for it, which no flight does. pydantic's own way, tokenizing each
    class where it is made, takes ten times as long.
    """
    told: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, StrictModel):
            told |= _field_docstrings(kind.__module__).get(kind.__name__, {})
    return told


@functools.cache
def _field_docstrings(module: str) -> dict[str, dict[str, str]]:
    """The docstrings under the fields of a module's classes, each as one line, by class and field."""
    source = getattr(sys.modules.get(module), "__file__", None)
    if source is None:
        return {}
    classes = [
        kind
        for kind in ast.parse(Path(source).read_text(encoding="utf-8")).body
        if isinstance(kind, ast.ClassDef)
    ]
    return {kind.name: dict(_described(kind)) for kind in classes}


def _described(kind: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for field, text in pairwise(kind.body):
        match field, text:
            case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(words))):
                yield name, " ".join(words.split())


_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
# YAML 1.2's core schema, 10.3.2, without octal numbers
_NUMBERS = {
    _INT: re.compile(r"(?:[-+]?[0-9]+|0x[0-9a-fA-F]+)$"),
    _FLOAT: re.compile(
        r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
}
_OTHERWISE_IN_1_1 = {_INT, _FLOAT, "tag:yaml.org,2002:bool", "tag:yaml.org,2002:timestamp"}


def _resolvers() -> dict[str, list[tuple[str, re.Pattern[str]]]]:
    """What plain words may be, by their first letter."""
    resolvers = {
        first: [(tag, pattern) for tag, pattern in kinds if tag not in _OTHERWISE_IN_1_1]
        for first, kinds in yaml.resolver.Resolver.yaml_implicit_resolvers.items()
    }
    for first in "-+.0123456789":
        resolvers[first] = [*resolvers.get(first, []), *_NUMBERS.items()]
    return resolvers


class _PlainYaml(yaml.constructor.SafeConstructor):
    """Stricter than PyYAML's.

    As YAML has it, a key may stand in a mapping once; the plain loader takes the last one silently. Plain
    words are what they say, as in YAML 1.2: PyYAML's "on" and "yes" would be 1 where a number is expected,
    "010" 8 and "1:05" 65. True and false are words too: a setting that is one or the other reads them.
    """

    yaml_implicit_resolvers = _resolvers()

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        met = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # a list is no key at all, which the plain loader says
            if key.value in met:
                raise yaml.constructor.ConstructorError(
                    problem=f"'{key.value}' stands here twice", problem_mark=key.start_mark
                )
            met.add(key.value)
        return super().construct_mapping(node, deep)


def _integer(_: Any, node: yaml.ScalarNode) -> int:
    return int(node.value, 16 if "x" in node.value else 10)


class _Loader(_PlainYaml, yaml.SafeLoader):
    """PyYAML's own: it words what is wrong."""


class _QuickLoader(_PlainYaml, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """By libyaml where PyYAML was built with it: the same values in a seventh of the time."""


_Loader.add_constructor(_INT, _integer)
_QuickLoader.add_constructor(_INT, _integer)


Model = TypeVar("Model", bound=BaseModel)
Vector = tuple[float, float, float]


def read_yaml(path: Path, key: str | None = None) -> dict[str, Any]:
    """Read a YAML mapping; `key` is the setting that names the file, if one does.

    Raises:
        ConfigError: unreadable, not YAML (with line and column), or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
        data = _load(text)
    except OSError as error:
        raise cannot_read(path, error, key, SETTINGS_FILE) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text at byte {error.start}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply; expected settings") from error
    except yaml.YAMLError as error:
        if text.startswith("%YAML:"):  # no directive of YAML: OpenCV's FileStorage begins so
            raise ConfigError(
                f"{path}: a file of OpenCV's own kind; expected YAML like that in configs/"
            ) from error
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not readable"
        raise ConfigError(f"{path}{where}: broken YAML: {problem}") from error
    except ValueError as error:  # a number of thousands of digits
        raise ConfigError(f"{path}: broken YAML: {error}") from error
    if data is None:
        return {}  # empty, or all of it is commented out
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected a mapping of keys to values, found {data!r:.40}")
    return data


def _load(text: str) -> Any:
    try:
        _check_depth(text)
        return yaml.load(text, Loader=_QuickLoader)
    except yaml.YAMLError:
        return yaml.load(text, Loader=_Loader)


def _check_depth(text: str) -> None:
    """Read the events alone, which takes no recursion.

    Raises:
        RecursionError: more than `_DEEPEST` collections stand in one another.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_QuickLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise RecursionError


def validate(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """Build a model from plain data.

    Raises:
        ConfigError: one line with the source, the key, what was expected and what was found.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(_one_line(error, source, data, model)) from error


def validate_recorded(
    model: type[Model], data: dict[str, Any], source: str, notes: list[str] | None = None
) -> Model:
    """Build a model from settings that an earlier version recorded: keys that it no longer has are left out.

    What is left out is named in `notes`: the flight was flown with it, and what reads it now is without.

    Raises:
        ConfigError: see `validate`.
    """
    data = copy.deepcopy(data)
    gone: list[str] = []
    try:
        model.model_validate(data)
    except ValidationError as error:
        for problem in error.errors(include_url=False):
            if problem["type"] == "extra_forbidden":
                gone += _leave_out(problem["loc"], data)
    if gone and notes is not None:
        more = f" and {len(gone) - _NAMED} more" if len(gone) > _NAMED else ""
        named = ", ".join(sorted(gone)[:_NAMED])
        notes.append(f"{source}: {named}{more}: not in this version, left out")
    return validate(model, data, source)


def load_model(model: type[Model], path: Path) -> Model:
    """Read one settings file into its model.

    Raises:
        ConfigError: see `read_yaml` and `validate`.
    """
    return validate(model, read_yaml(path), str(path))


def merge(base: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    """Deep merge of two plain trees; lists and scalars of the second replace the first's."""
    merged = dict(base)
    for key, value in overrides.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def _one_line(error: ValidationError, source: str, data: Any, model: type[BaseModel]) -> str:
    """What is wrong first of all: a key that nobody knows, since what it was meant to be is then missing."""
    errors = error.errors(include_url=False)
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    key = _key(first["loc"], data)
    # what may be of several kinds fails once for each
    same = [e for e in errors if _key(e["loc"], data) == key]
    more = len({_key(e["loc"], data) for e in errors}) - 1
    tail = f" (and {more} more)" if more else ""
    where = f"{source}: {key}" if key else source
    if first["type"] == "extra_forbidden":
        meant = near_name(model, key.split("."))
        return f"{source}: unknown key '{key}'" + (f"; did you mean '{meant}'?" if meant else "")
    if first["type"].startswith("union_tag"):
        context = first["ctx"]
        kind, tags = context["discriminator"].strip("'"), context.get("expected_tags")
        wrong = f"one of {tags}, found '{context['tag']}'" if tags else "a value, found none"
        return f"{where}.{kind}: expected {wrong}{tail}"
    texts = list(dict.fromkeys(_expected(e) for e in same))
    text = " or ".join(texts[:1] + [t.removeprefix("expected ") for t in texts[1:]])
    found = (
        ""
        if first["type"] in {"missing", "value_error", "too_long", "too_short"}
        else f", found {_short(first['input'])}"
    )
    return f"{where}: {text}{found}{tail}"


def _leave_out(location: tuple[int | str, ...], data: Any) -> list[str]:
    """Delete the key there; returns its name, or nothing where it has gone already."""
    *way, last = parts = _parts(location, data)
    for part in way:
        data = data[part]
    if not isinstance(data, dict) or last not in data:
        return []
    del data[last]
    return [".".join(map(str, parts))]


def _short(found: Any) -> str:
    """What was found instead, or its beginning: a whole section is no line to read."""
    text = repr(found)
    return text if len(text) <= _LONGEST_FOUND else f"{text[:_LONGEST_FOUND]}..."


def _expected(error: ErrorDetails) -> str:
    if error["type"] in {"too_long", "too_short"}:
        most, least = error["ctx"].get("max_length"), error["ctx"].get("min_length")
        bound = f"at least {least}" if most is None else f"at most {most}"
        return f"expected {bound} items, found {error['ctx']['actual_length']}"
    text = _EXPECTED.get(error["type"]) or error["msg"].removeprefix("Value error, ")
    return text.replace("Input should be", "expected").split(", unable to parse")[0]


def _key(location: tuple[int | str, ...], data: Any) -> str:
    """The key as it stands in the file."""
    return ".".join(map(str, _parts(location, data)))


def _parts(location: tuple[int | str, ...], data: Any) -> list[int | str]:
    """The way to a key in the file: without what pydantic adds for the kind that it tried."""
    parts, here = list[int | str](), data
    for i, part in enumerate(location):
        inside = isinstance(here, dict) and part in here
        inside |= isinstance(here, (list, tuple)) and isinstance(part, int) and part < len(here)
        if inside:
            here = here[part]
        elif i < len(location) - 1 or not isinstance(here, dict):
            continue
        parts.append(part)
    return parts
