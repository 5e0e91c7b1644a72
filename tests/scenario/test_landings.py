"""The app lands in every shipped scenario, within its bounds, whatever the seed."""

from pathlib import Path
from typing import Any

import pytest

from companion.config import CONFIG_FOLDER
from sitl.scenario import load_scenario
from tests.scenario.flying import fly, scenario_file

SHIPPED = sorted(path.stem for path in (CONFIG_FOLDER / "scenarios").glob("*.yaml"))
LATERAL_M = 0.15
ATTITUDE: dict[str, Any] = {
    "companion": {"control": {"setpoint": "attitude"}, "link": {"set_parameters": True}}
}
ARDUPILOT: dict[str, Any] = {"autopilot": "ardupilot"}


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("scenario", SHIPPED)
def test_lands_within_the_bounds(scenario: str, seed: int, tmp_path: Path) -> None:
    flown = fly(scenario, seed, tmp_path)
    touchdown = flown.landing["touchdown"]
    for name, bound in load_scenario(scenario).pass_bounds.model_dump().items():
        assert touchdown[name] <= bound, f"{name}\n{flown}"
    assert touchdown["lateral_error_m"] <= LATERAL_M, flown


@pytest.mark.parametrize(
    "changes", [ATTITUDE, ARDUPILOT, {**ATTITUDE, **ARDUPILOT}], ids=["attitude", "ardupilot", "both"]
)
def test_lands_by_another_setpoint_and_another_autopilot(changes: dict[str, Any], tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "line", changes)
    assert fly(path, 0, tmp_path).landing["touchdown"]["lateral_error_m"] <= LATERAL_M
