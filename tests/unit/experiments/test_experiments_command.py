"""`companion-experiments`: what a user gets wrong is one line, and comes before minutes of flying."""

import sys

import pytest

from companion.experiments.command import main


def _said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str
) -> tuple[str, int]:
    monkeypatch.setattr(sys, "argv", ["companion-experiments", *words])
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
    assert error.startswith(f"companion-experiments: {said}")
    assert error.count("\n") == 1


def test_help_needs_no_flight(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["companion-experiments", "--help"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert "fig13" in capsys.readouterr().out
