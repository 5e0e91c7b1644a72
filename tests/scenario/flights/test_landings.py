"""The app lands in the five standard scenarios under two seeds, and in some with more in their way.

A scenario with a seed is one flight, to the bit, also in another process (test_docs.py). How it fares in the
other shipped ones is in docs/reference/scenarios.md.
"""

from pathlib import Path
from typing import Any

import pytest

from sitl.campaign import SCENARIOS
from sitl.scenario.scenario import load_scenario
from tests.scenario.flying import FEW_PICTURES, SharedFlights, fly, scenario_file

HARDER = ("deck", "glare", "hexacopter", "random_turns", "waypoints", "weak_motor")
STANDARD = [pytest.param(scenario, 0, marks=pytest.mark.fast) for scenario in SCENARIOS]
FLOWN = [*STANDARD, *((scenario, 1) for scenario in SCENARIOS), *((name, 0) for name in HARDER)]
LATERAL_M = 0.15
ATTITUDE: dict[str, Any] = {
    "companion": {"control": {"setpoint": "attitude"}, "link": {"set_parameters": True}}
}
ARDUPILOT: dict[str, Any] = {"autopilot": "ardupilot"}


@pytest.mark.parametrize(("scenario", "seed"), FLOWN)
def test_lands_within_the_bounds(scenario: str, seed: int, shared_flights: SharedFlights) -> None:
    flight = shared_flights.flown(scenario, seed)
    touchdown = flight.landing["touchdown"]
    for name, bound in load_scenario(scenario).pass_bounds.model_dump().items():
        assert touchdown[name] <= bound, f"{name}\n{flight}"
    assert touchdown["lateral_error_m"] <= LATERAL_M, flight


def test_another_seed_gives_another_flight(shared_flights: SharedFlights) -> None:
    one, other = (shared_flights.flown("circle", seed).landing for seed in (0, 1))
    assert one["estimate"] != other["estimate"]


@pytest.mark.fast
@pytest.mark.parametrize(
    "changes", [ATTITUDE, ARDUPILOT, {**ATTITUDE, **ARDUPILOT}], ids=["attitude", "ardupilot", "both"]
)
def test_lands_by_another_setpoint_and_another_autopilot(changes: dict[str, Any], tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "line", {**FEW_PICTURES, **changes})
    assert fly(path, 0, tmp_path).landing["touchdown"]["lateral_error_m"] <= LATERAL_M
