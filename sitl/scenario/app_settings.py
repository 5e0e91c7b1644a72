"""The app's settings for a served vehicle, as a file for `--config`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

from companion.config import merge
from sitl.scenario.scenario import Scenario

_HEAD: Final = "# The app's settings for a simulated vehicle, by companion-sitl; good while that runs.\n"


def settings_text(scenario: Scenario, connection: str, devices: dict[str, Any]) -> str:
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
    found = merge(merge(named, scenario.operator_settings), there)
    return _HEAD + str(yaml.safe_dump(found, sort_keys=False))


def signed(scenario: Scenario, key: Path) -> Scenario:
    """With an operator whose app signs with that key."""
    link = {"link": {"signing_key": str(key.resolve()), "actions": "pymavlink"}}
    return scenario.model_copy(update={"companion": merge(scenario.companion, link)})


def _findable(name: str) -> str:
    """A shipped file's name as it is, a path so that it leads there from every folder."""
    return name if Path(name).suffix == "" else str(Path(name).resolve())
