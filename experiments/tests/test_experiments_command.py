"""`python -m experiments`: what a user gets wrong is one line, and comes before minutes of flying."""

from pathlib import Path

import pytest

from companion.base.files import must_be_writable
from experiments.command import PROGRAM
from tests.programs import ProgramHere


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fig13", "-o", "nowhere/fig13.png"), "--output nowhere/fig13.png: expected a .png file"),
        (("profiles", "-o", "profiles.txt"), "--output profiles.txt: expected a .png file"),
        (("fig13", "--scenario", "moon"), "scenarios: no 'moon'"),
        (("profiles", "--flights", "0"), "Invalid value for '--flights'"),
        (("fig99",), "No such command 'fig99'"),
    ],
)
def test_mistakes_are_one_line(words: tuple[str, ...], said: str, program: ProgramHere) -> None:
    assert program(PROGRAM, *words).refusal.startswith(f"python -m experiments: {said}")


def test_a_picture_that_cannot_be_written_is_reported_before_the_flight(
    tmp_path: Path, program: ProgramHere
) -> None:
    folder = tmp_path / "folder.png"
    folder.mkdir()
    for output in (folder, Path("/proc/fig13.png")):
        said = program(PROGRAM, "fig13", "-o", output).refusal
        assert said.startswith(f"python -m experiments: --output {output}: expected a .png file")


def test_what_can_be_written_is_left_as_it_was(tmp_path: Path) -> None:
    old, new = tmp_path / "old.png", tmp_path / "new.png"
    old.write_bytes(b"picture")
    for path in (old, new):
        must_be_writable("--output", path, ".png")
    assert old.read_bytes() == b"picture"
    assert not new.exists()


def test_help_needs_no_flight(program: ProgramHere) -> None:
    said = program(PROGRAM, "--help")
    assert said.code == 0
    assert "fig13" in said.out
