"""Writes the tables of settings.md, scenarios.md and obstacles.md from the settings' own models.

    python -m docs.settings_table

All that a table says comes from the pydantic models (`companion.config.catalogue`). A setting without a
meaning stops the writing with a line that names it, and so does a setting of the app whose meaning does not
say when one would change it. A table stands between `<!-- table:NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Final, get_args

from pydantic import BaseModel

from companion.config import (
    AxisResponse,
    Box,
    CameraConfig,
    CompanionConfig,
    ConfigError,
    Cylinder,
    KindResponse,
    VehicleConfig,
)
from companion.config.catalogue import Setting, settings_of
from companion.pad import Marker, Pad
from sitl.faults.faults import AnyFault, Fault
from sitl.pad.motion import PadMotionSettings
from sitl.scenario.scenario import Scenario

DOCS: Final = Path(__file__).resolve().parent
PAGES: Final = ("reference/settings.md", "reference/scenarios.md", "how-to/obstacles.md")
# how a meaning says when one would change the setting: "raise it for ...", "set them where ..."
ADVICE: Final = re.compile(
    r"\b(set|change|raise|lower|lengthen|turn|tune|measure|list) (it|them|these|both)\b",
    re.IGNORECASE,
)
ADVISED: Final = "companion"  # the table whose settings a user tunes; the others describe what was measured
# a page that a meaning names
PAGE_NAME: Final = re.compile(r"docs/([\w-]+/([\w-]+)\.md)")
TABLE: Final = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


# ---------------------------------------------------------------- settings to tables


def groups_of(model: type[BaseModel]) -> dict[str, list[Setting]]:
    """The settings by the part of the tree that they stand in; "" is the root."""
    groups: dict[str, list[Setting]] = {}
    for setting in settings_of(model):
        group, _, name = setting.key.rpartition(".")
        groups.setdefault(group, []).append(replace(setting, key=name))
    return groups


def tables() -> dict[str, dict[str, list[Setting]]]:
    """Every table of the pages: by name, then by group."""
    motions = {
        motion.model_fields["kind"].annotation.__args__[0]: motion for motion in get_args(PadMotionSettings)
    }
    times = groups_of(Fault)[""]
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
            for fault in get_args(AnyFault)
        },
    }


def markdown(name: str, groups: dict[str, list[Setting]], page: str) -> str:
    """A heading and a table for each group of table `name`; links start from `page`.

    Raises:
        ConfigError: a setting has no meaning.
    """
    for_whom = " For |" if name == ADVISED else ""
    parts = []
    for group, settings in groups.items():
        if not settings:
            continue
        rows = [_row(group, setting, page, audience=bool(for_whom)) for setting in settings]
        title = f"### `{group}`\n\n" if group else ""
        head = f"| Setting | Unit | Default | Bounds |{for_whom} Meaning |\n"
        parts.append(f"{title}{head}|{'---|' * (head.count('|') - 1)}\n" + "\n".join(rows) + "\n")
    return "\n" + "\n".join(parts) + "\n"


def _row(group: str, setting: Setting, page: str, *, audience: bool) -> str:
    if not setting.meaning:
        key = f"{group}.{setting.key}".lstrip(".")
        raise ConfigError(f"{key}: nothing says what it means; expected a docstring under it")
    whom = f" {'operator' if setting.for_operators else 'expert'} |" if audience else ""
    facts = f"| `{setting.key}` | {setting.unit} | {setting.default} | {setting.bounds} |"
    return f"{facts}{whom} {_linked(setting.meaning, page)} |"


def _linked(meaning: str, page: str) -> str:
    """A meaning whose names of pages are links that start from `page`."""
    up = "../" * page.count("/")
    return PAGE_NAME.sub(lambda m: f"[{m[2].replace('-', ' ')}]({up}{m[1]})", meaning)


def page_text(text: str, page: str) -> str:
    """The text of `page` with its tables written afresh.

    Raises:
        ConfigError: a setting has no meaning.
    """
    made = tables()
    return TABLE.sub(lambda m: m[1] + markdown(m[2], made[m[2]], page) + m[3], text)


def without_advice() -> list[str]:
    """Settings of the app whose meaning does not say when one would change them."""
    return [s.key for s in settings_of(CompanionConfig) if ADVICE.search(s.meaning) is None]


def main() -> None:
    """Entry point: write the pages."""
    try:
        for name in PAGES:
            page = DOCS / name
            page.write_text(page_text(page.read_text(encoding="utf-8"), name), encoding="utf-8")
        if silent := without_advice():
            raise ConfigError(f"{silent[0]}: expected when one would change it ('raise it for ...')")
    except ConfigError as error:
        sys.exit(f"settings_table: {error}")


if __name__ == "__main__":
    main()
