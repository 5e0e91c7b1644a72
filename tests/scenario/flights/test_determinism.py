"""A scenario with a seed is one flight, to the bit; another seed is another flight."""

from pathlib import Path
from typing import Any

from tests.scenario.flying import Flown, fly, scenario_file


def figures(flown: Flown) -> dict[str, Any]:
    """The result of a flight but for what depends on the machine."""
    assert flown.result is not None, flown
    result = dict(flown.result)
    assert result.pop("sim").keys() == {"real_time_factor"}
    return result


def test_the_same_seed_gives_the_same_flight(tmp_path: Path) -> None:
    first = figures(fly("circle", 0, tmp_path))
    assert figures(fly("circle", 0, tmp_path)) == first


def test_another_seed_gives_another_flight(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "circle", {"time_limit_s": 12.0})
    first, other = figures(fly(path, 0, tmp_path)), figures(fly(path, 1, tmp_path))
    assert first["estimate"] != other["estimate"]
