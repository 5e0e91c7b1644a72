"""`python -m experiments`: what a user gets wrong is one line, and comes before minutes of flying."""

import sys
from pathlib import Path

import pytest

from experiments.command import main
from experiments.output import writable


def _said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str
) -> tuple[str, int]:
    monkeypatch.setattr(sys, "argv", ["python -m experiments", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int)
    return capsys.readouterr().err, ended.value.code


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
def test_mistakes_are_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    error, code = _said(capsys, monkeypatch, *words)
    assert code == 2
    assert error.startswith(f"python -m experiments: {said}")
    assert error.count("\n") == 1


def test_a_picture_that_cannot_be_written_is_reported_before_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "folder.png"
    folder.mkdir()
    for output in (folder, Path("/proc/fig13.png")):
        error, code = _said(capsys, monkeypatch, "fig13", "-o", str(output))
        assert code == 2
        assert error.startswith(f"python -m experiments: --output {output}: expected a .png file")
        assert error.count("\n") == 1


def test_what_can_be_written_is_left_as_it_was(tmp_path: Path) -> None:
    old, new = tmp_path / "old.png", tmp_path / "new.png"
    old.write_bytes(b"picture")
    for path in (old, new):
        writable(path, ".png", "--output")
    assert old.read_bytes() == b"picture"
    assert not new.exists()


def test_help_needs_no_flight(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["python -m experiments", "--help"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert "fig13" in capsys.readouterr().out
