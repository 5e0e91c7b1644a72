"""Every benchmark is found, imports and knows its words: one that nobody runs dies unseen."""

from __future__ import annotations

import sys

import pytest

from benchmarks.command import discover, main


@pytest.mark.parametrize("name", discover())
def test_a_benchmark_says_what_it_is_for(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [])
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert f"python -m benchmarks {name}" in capsys.readouterr().out


def test_without_a_name_all_are_listed_each_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == list(discover())
    assert [line for line in lines if len(line.split()) < 5] == []


def test_a_name_that_is_none_is_answered_with_those_there_are() -> None:
    assert str(main(["wings"])).startswith(
        "python -m benchmarks: wings: no such benchmark; expected one of ahrs,"
    )
