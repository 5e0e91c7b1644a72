"""The command line's small decisions."""

from pathlib import Path

from companion.base.messages import Outcome
from companion.cli import EXIT_CODES, next_flight_folder


def test_every_outcome_has_an_exit_code_of_its_own() -> None:
    assert EXIT_CODES.keys() == set(Outcome)
    assert len(set(EXIT_CODES.values())) == len(Outcome)
    assert EXIT_CODES[Outcome.LANDED] == 0


def test_flights_on_the_vehicle_are_numbered(tmp_path: Path) -> None:
    assert next_flight_folder(tmp_path / "new") == tmp_path / "new" / "flight-0001"
    (tmp_path / "flight-0009").mkdir()
    (tmp_path / "flight-0010").mkdir()
    (tmp_path / "flight-9-of-last-year").mkdir()
    assert next_flight_folder(tmp_path) == tmp_path / "flight-0011"
