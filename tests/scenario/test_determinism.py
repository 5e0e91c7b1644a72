"""A scenario with a seed is one flight, to the bit; another seed is another flight."""

from pathlib import Path
from typing import Any

from tests.scenario.flying import fly


def flown(seed: int, folder: Path) -> dict[str, Any]:
    """The result of a flight but for what depends on the machine."""
    folder.mkdir()
    result = fly("circle", seed, folder).landing
    del result["sim"]["real_time_factor"]
    return result


def test_the_same_seed_gives_the_same_flight_and_another_does_not(tmp_path: Path) -> None:
    first = flown(0, tmp_path / "first")
    assert flown(0, tmp_path / "again") == first
    other = flown(1, tmp_path / "other")
    assert other["touchdown"] != first["touchdown"]
    assert other["events"] != first["events"]
