"""Writes the tables of docs/settings.md, scenarios.md and obstacles.md from the settings' own models.

    python -m docs.settings_table

Name, unit, default and bounds come from the pydantic models (`companion.config`, `sitl.scenario.scenario`);
what a setting means comes from docs/meanings.yaml, or from the comment beside the field. A setting without
either stops the writing with a line that names it, and so does a setting of the app whose meaning does not
say when one would change it; meanings of settings that are gone are reported. A table
stands between `<!-- table:NAME -->` and `<!-- end -->`; the rest of a page is left alone.
"""

from __future__ import annotations

import inspect
import io
import re
import sys
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from companion.config import (
    AxisResponse,
    Box,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    Cylinder,
    KindResponse,
    VehicleConfig,
    read_yaml,
)
from companion.pad import Marker, Pad
from sitl.faults.faults import Fault
from sitl.faults.times import FaultTimes
from sitl.pad.motion import PadMotionSettings
from sitl.scenario.scenario import Scenario

DOCS: Final = Path(__file__).resolve().parent
PAGES: Final = ("settings.md", "scenarios.md", "obstacles.md")
MEANINGS: Final = DOCS / "meanings.yaml"
# longest first: a name ends in its unit
UNITS: Final = {
    "rad_s2_rthz": "rad/s²/√Hz",
    "m_s4_rthz": "m/s⁴/√Hz",
    "mrad": "mrad",
    "m_s2_rthz": "m/s²/√Hz",
    "m_s3_rthz": "m/s³/√Hz",
    "rad_s_rts": "rad/s/√s",
    "m_s2_rts": "m/s²/√s",
    "ut_rts": "µT/√s",
    "n_m_s2": "N·m·s²",
    "n_s2": "N·s²",
    "kg_m2": "kg·m²",
    "kg": "kg",
    "deg_s": "°/s",
    "rad_s": "rad/s",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "m_s": "m/s",
    "1_s2": "1/s²",
    "1_s3": "1/s³",
    "1_s": "1/s",
    "deg": "°",
    "hz": "Hz",
    "px": "px",
    "mb": "MB",
    "ut": "µT",
    "grey": "grey values",
    "lux": "lx",
    "g": "g",
    "m": "m",
    "s": "s",
}
BOUND_SIGNS: Final = {"ge": "≥ {:g}", "gt": "> {:g}", "le": "≤ {:g}", "lt": "< {:g}"}
# how a meaning says when one would change the setting: "raise it for ...", "set them where ..."
ADVICE: Final = re.compile(
    r"\b(set|change|raise|lower|lengthen|turn|tune|measure|list) (it|them|these|both)\b",
    re.IGNORECASE,
)
ADVISED: Final = "companion"  # the table whose settings a user tunes; the others describe what was measured
TABLE: Final = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of a table; `key` is dotted from the table's root."""

    key: str
    unit: str
    default: str
    bounds: str
    comment: str


# ---------------------------------------------------------------- models to settings


def settings_of(
    model: type[BaseModel], prefix: str = "", defaults: BaseModel | None = None
) -> Iterator[Setting]:
    """The settings of a model and of those within it, in the order of the source.

    `defaults` is the instance, if any, that the model around it puts there by default.
    """
    comments = field_comments(model)
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        inner = inner_model(field.annotation)
        if inner is not None:
            default = field.default if isinstance(field.default, BaseModel) else None
            yield from settings_of(inner, f"{key}.", default)
        elif not (_is_motion(field) or (name == "kind" and field.is_required())):
            default_text = _default(field) if defaults is None else _value(getattr(defaults, name))
            yield Setting(key, _unit(name), default_text, _bounds(field), comments.get(name, ""))


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


def _is_motion(field: FieldInfo) -> bool:
    return field.discriminator is not None


def _unit(name: str) -> str:
    name = re.sub(r"_(ned|body|sensor|pad)(?=_)", "", name)
    return next((unit for suffix, unit in UNITS.items() if name.endswith(f"_{suffix}")), "")


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


def field_comments(model: type[BaseModel]) -> dict[str, str]:
    """The comment that stands beside each field in the source, by the field's name."""
    comments: dict[str, str] = {}
    kinds = [
        kind for kind in reversed(model.__mro__) if issubclass(kind, BaseModel) and kind is not BaseModel
    ]
    name = ""
    for token in (t for kind in kinds for t in tokenize.generate_tokens(_lines_of(kind))):
        starts_line = token.line.startswith("    ") and token.start[1] == 4
        if token.type == tokenize.NAME and starts_line and token.string in model.model_fields:
            name = token.string
        elif token.type == tokenize.COMMENT and name and token.line.strip() != token.string:
            comments[name] = f"{comments.get(name, '')} {token.string.lstrip('# ')}".strip()
    return comments


def _lines_of(model: type[BaseModel]) -> Callable[[], str]:
    return io.StringIO(inspect.getsource(model)).readline


# ---------------------------------------------------------------- settings to tables


def groups_of(model: type[BaseModel]) -> dict[str, list[Setting]]:
    """The settings by the part of the tree that they stand in; "" is the root."""
    groups: dict[str, list[Setting]] = {}
    for setting in settings_of(model):
        group, _, name = setting.key.rpartition(".")
        named = Setting(name, setting.unit, setting.default, setting.bounds, setting.comment)
        groups.setdefault(group, []).append(named)
    return groups


def tables() -> dict[str, dict[str, list[Setting]]]:
    """Every table of the pages: by name, then by group."""
    motions = {
        motion.model_fields["kind"].annotation.__args__[0]: motion for motion in get_args(PadMotionSettings)
    }
    times = groups_of(FaultTimes)[""]
    vehicle = {g: s for g, s in groups_of(VehicleConfig).items() if not g.startswith("responses.")}
    # alike for each autopilot, kind of setpoint and direction
    vehicle["responses.AUTOPILOT.KIND"] = groups_of(KindResponse)[""]
    vehicle["responses.AUTOPILOT.KIND.DIRECTION"] = groups_of(AxisResponse)[""]
    return {
        "companion": groups_of(CompanionConfig),
        "camera": groups_of(CameraConfig),
        "vehicle": vehicle,
        "pad": {**groups_of(Pad), "markers": groups_of(Marker)[""]},
        "scenario": groups_of(Scenario),
        "motion": {kind: groups_of(motion).get("", []) for kind, motion in motions.items()},
        "meet": groups_of(motions["static"]),
        "obstacle": {"cylinder": groups_of(Cylinder)[""], "box": groups_of(Box)[""]},
        "fault_times": {"": times},
        "fault": {
            fault.model_fields["kind"].annotation.__args__[0]: groups_of(fault)[""][len(times) :]
            for fault in get_args(Fault)
        },
    }


def markdown(groups: dict[str, list[Setting]], meanings: dict[str, Any]) -> str:
    """A heading and a table for each group.

    Raises:
        ConfigError: a setting has no meaning.
    """
    parts = []
    for group, settings in groups.items():
        if not settings:
            continue
        rows = [_row(group, setting, meanings) for setting in settings]
        title = f"### `{group}`\n\n" if group else ""
        parts.append(f"{title}| Setting | Unit | Default | Bounds | Meaning |\n|---|---|---|---|---|\n")
        parts[-1] += "\n".join(rows) + "\n"
    return "\n" + "\n".join(parts) + "\n"


def _row(group: str, setting: Setting, meanings: dict[str, Any]) -> str:
    key = f"{group}.{setting.key}".lstrip(".")
    meaning = meanings.get(key) or setting.comment
    if not meaning:
        raise ConfigError(
            f"docs/meanings.yaml: nothing says what {key} means; expected a line there, "
            "or a comment beside the field"
        )
    return f"| `{setting.key}` | {setting.unit} | {setting.default} | {setting.bounds} | {meaning} |"


def page_text(text: str) -> str:
    """A page with its tables written afresh.

    Raises:
        ConfigError: a setting has no meaning.
    """
    meanings, made = read_yaml(MEANINGS), tables()
    return TABLE.sub(lambda m: m[1] + markdown(made[m[2]], meanings.get(m[2], {})) + m[3], text)


def without_advice(meanings: dict[str, Any]) -> list[str]:
    """Settings of the app whose meaning does not say when one would change them."""
    rows = [(group, s) for group, settings in tables()[ADVISED].items() for s in settings]
    meant = {f"{group}.{s.key}".lstrip("."): s.comment for group, s in rows} | meanings[ADVISED]
    return [key for key, meaning in meant.items() if ADVICE.search(meaning) is None]


def left_over() -> list[str]:
    """Meanings of settings that are gone."""
    gone = []
    meanings = read_yaml(MEANINGS)
    for name, groups in tables().items():
        known = {f"{group}.{s.key}".lstrip(".") for group, settings in groups.items() for s in settings}
        gone += [f"{name}: {key}" for key in meanings.get(name, {}) if key not in known]
    return gone


def main() -> None:
    """Entry point: write the pages."""
    try:
        for name in PAGES:
            page = DOCS / name
            page.write_text(page_text(page.read_text(encoding="utf-8")), encoding="utf-8")
        if silent := without_advice(read_yaml(MEANINGS)):
            raise ConfigError(
                f"docs/meanings.yaml: {silent[0]}: expected when one would change it ('raise it for ...')"
            )
        for key in left_over():
            print(f"docs/meanings.yaml: {key}: there is no such setting any more")
    except ConfigError as error:
        sys.exit(f"settings_table: {error}")


if __name__ == "__main__":
    main()
