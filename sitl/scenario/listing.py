"""What is shipped, and what a scenario may hold, as text."""

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, Final

import yaml

from companion.config import CONFIG_FOLDER, merge
from sitl.scenario.scenario import Scenario, load_scenario
from sitl.world.wind import WindSettings

COLUMNS: Final = ("name", "pad", "wind", "faults")
INDENT: Final = 2 * " "


def shipped() -> list[str]:
    return sorted(path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml"))


def listing(width: int | None = None) -> str:
    """A line for each shipped scenario: name, pad, wind, faults, description.

    On a terminal of a `width` that has no room for that, the name and below it the rest, broken to fit.
    """
    scenarios = [load_scenario(name) for name in shipped()]
    wide = _wide(scenarios)
    if width is None or max(map(len, wide.splitlines())) <= width:
        return wide
    return "".join(_narrow(scenario, width) for scenario in scenarios)


def _narrow(scenario: Scenario, width: int) -> str:
    faults = fault_words(scenario)
    parts = [f"pad {pad_words(scenario)}", f"wind {wind_words(scenario.wind)}"]
    parts += [f"faults {faults}"] if faults != "-" else []
    texts = (scenario.description, "; ".join(parts))
    lines = [wrap(text, width, initial_indent=INDENT, subsequent_indent=INDENT) for text in texts]
    return "\n".join((scenario.name, *lines[0], *lines[1])) + "\n"


def _wide(scenarios: Sequence[Scenario]) -> str:
    rows = [COLUMNS, *((s.name, pad_words(s), wind_words(s.wind), fault_words(s)) for s in scenarios)]
    descriptions = ["description", *(s.description for s in scenarios)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(COLUMNS))]
    return "".join(
        "  ".join(f"{word:<{width}}" for word, width in zip(row, widths, strict=True)) + f"  {description}\n"
        for row, description in zip(rows, descriptions, strict=True)
    )


# ---------------------------------------------------------------- app settings


def settings_text(scenario: Scenario) -> str:
    """Everything a scenario sets, defaults included, as YAML that can be read again."""
    return yaml.safe_dump(
        scenario.model_dump(mode="json", by_alias=True), sort_keys=False, allow_unicode=True
    )


def schema_text() -> str:
    """The JSON schema (draft 2020-12) of a scenario file."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Scenario.model_json_schema(by_alias=True),
    }
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


# ---------------------------------------------------------------- in a few words


def pad_words(scenario: Scenario) -> str:
    """How the pad moves."""
    motion = scenario.pad.motion
    speed = getattr(motion, "speed_m_s", None)
    words = motion.kind if speed is None else f"{motion.kind} {speed:g} m/s"
    return words + ("" if scenario.pad.deck is None else ", at sea")


def wind_words(wind: WindSettings) -> str:
    """How it blows."""
    words = [] if wind.mean_m_s == 0.0 else [f"{wind.mean_m_s:g} m/s"]
    if wind.turbulence != "none":
        words.append(wind.turbulence)
    if wind.gusts is not None or wind.gust is not None:
        words.append("gusts")
    return ", ".join(words) or "calm"


def fault_words(scenario: Scenario) -> str:
    """What fails."""
    return ", ".join(sorted({fault.kind for fault in scenario.faults})) or "-"


_HEAD: Final = "# The app's settings for a simulated vehicle, by companion-sitl; good while that runs.\n"


def app_settings_text(scenario: Scenario, connection: str, devices: dict[str, Any]) -> str:
    """The settings file's text.

    Args:
        scenario: names pad, camera and vehicle, and has the operator's settings.
        connection: where the vehicle's MAVLink is, as `link.connection` has it.
        devices: the settings that lead to the vehicle's devices.
    """
    named = {
        "pad": _findable(scenario.pad.name),
        "camera": _findable(scenario.camera.config),
        "vehicle": _findable(scenario.airframe),
        "sense": {"range": {"kind": scenario.sensors.ultrasonic}},
    }
    there = merge(devices, {"link": {"connection": connection}})
    found = merge(merge(named, scenario.companion), there)
    return _HEAD + str(yaml.safe_dump(found, sort_keys=False))


def signed(scenario: Scenario, key: Path) -> Scenario:
    """With an operator whose app signs with that key."""
    link = {"link": {"signing_key": str(key.resolve()), "actions": "pymavlink"}}
    return scenario.model_copy(update={"companion": merge(scenario.companion, link)})


def _findable(name: str) -> str:
    """A shipped file's name as it is, a path so that it leads there from every folder."""
    return name if Path(name).suffix == "" else str(Path(name).resolve())
