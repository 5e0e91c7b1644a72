"""The flights of `bench_margins`: the app is told something else of the vehicle than what flies.

Five shipped scenarios, each with a response 1.5 times slower and faster than believed, a line that holds
everything back for 80 ms, frames stamped 20 ms early and late, and a mass off by 20 % either way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

from benchmarks.campaign.landing_cases import PASS, LandingCase
from companion.base.autopilot_kind import AutopilotKind
from companion.config import find_file, merge, read_yaml

SCENARIOS: Final = ("static", "line", "circle", "figure_8", "heave")
VEHICLE: Final = "x500"
SLOWER: Final = 1.5
HELD_BACK_S: Final = 0.08
STAMPS_OFF_S: Final = 0.02
MASS_OFF: Final = 0.2
BOUNDS: Final = {
    name: PASS[name] for name in ("lateral_error_m", "vertical_speed_m_s", "horizontal_speed_m_s")
}


def margin_cases(autopilot_kind: AutopilotKind, seeds: range, folder: Path) -> tuple[LandingCase, ...]:
    """All of them, with one autopilot's profile; the vehicle's files are left in `folder`."""
    believed = read_yaml(find_file("vehicles", VEHICLE))
    changes: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "as_believed": ({}, {}),
        "slower": (_quicker(believed, SLOWER), {}),
        "faster": (_quicker(believed, 1.0 / SLOWER), {}),
        "held_back": ({}, {"link": {"delay_s": HELD_BACK_S}}),
        "stamps_early": ({"camera_time_offset_s": -STAMPS_OFF_S}, {}),
        "stamps_late": ({"camera_time_offset_s": STAMPS_OFF_S}, {}),
        "light": ({}, {"mass_factor": 1.0 - MASS_OFF}),
        "heavy": ({}, {"mass_factor": 1.0 + MASS_OFF}),
    }
    cases = []
    for name, (vehicle, world) in changes.items():
        path = folder / f"vehicle_{name}.yaml"
        path.write_text(yaml.safe_dump(merge(believed, vehicle), sort_keys=False), encoding="utf-8")
        told = {**world, "autopilot": autopilot_kind, "companion": {"vehicle": str(path)}, "pass": BOUNDS}
        flights = [
            (_scenario(scenario, name, autopilot_kind, told), seed)
            for scenario in SCENARIOS
            for seed in seeds
        ]
        cases.append(LandingCase(f"{autopilot_kind}-{name}", tuple(flights)))
    return tuple(cases)


def _scenario(
    scenario: str, name: str, autopilot_kind: AutopilotKind, told: dict[str, Any]
) -> dict[str, Any]:
    content = merge(read_yaml(find_file("scenarios", scenario)), told)
    return {**content, "name": f"{autopilot_kind}-{name}-{scenario}"}


def _quicker(vehicle: dict[str, Any], factor: float) -> dict[str, Any]:
    """What to believe of a vehicle that shall be slower than believed by this factor."""

    def scaled(part: Any) -> Any:
        if not isinstance(part, dict):
            return part
        changed = {key: scaled(value) for key, value in part.items()}
        if "dead_time_s" in part:
            changed["dead_time_s"] = part["dead_time_s"] / factor
            changed["frequency_rad_s"] = part["frequency_rad_s"] * factor
        return changed

    return {"responses": scaled(vehicle["responses"])}
