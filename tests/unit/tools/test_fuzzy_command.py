"""`companion fuzzy`: what it prints, draws and writes, and what it says of rules that are no pilot's."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from matplotlib.figure import Figure

from companion.plan.speed.fuzzy_rules import load_rules
from companion.plan.speed.speed_table import load_table
from companion.tools import fuzzy as plots
from tests.programs import ProgramHere

FEW = ("--points", "200")


# two terms a variable, so that the table is small
SMALL = {
    "name": "small",
    "distance_m": {"near": [0.0, 0.0, 4.0], "far": [0.0, 4.0, 8.0]},
    "velocity_m_s": {"opening": [-1.0, -1.0, 1.0], "rushing": [-1.0, 1.0, 1.0]},
    "acceleration_m_s2": {"braking": [-1.0, -1.0, 1.0], "pushing": [-1.0, 1.0, 1.0]},
    "speed_m_s": {"slow": [0.7, 0.8, 0.9], "fast": [1.0, 1.1, 1.2]},
}
RULES = {"near": ["slow", "slow"], "far": ["fast", "slow"]}


def mine(folder: Path, rules: dict[str, list[str]]) -> Path:
    data = SMALL | {"rules": {"braking": rules, "pushing": rules}}
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_the_shipped_rules_are_shown_checked_and_drawn(tmp_path: Path, program: ProgramHere) -> None:
    picture = tmp_path / "fuzzy.png"
    result = program("companion", "fuzzy", "--plot", picture, *FEW)
    assert result.code == 0
    assert "bar 1 %: holds" in result.out
    assert result.out.count(": holds") == 8
    for word in ("acceleration steady", "rushing", "touching", "creep", "gusts breezy", "sliding", "hazy"):
        assert word in result.out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_table_is_written_and_belongs_to_its_rules(tmp_path: Path, program: ProgramHere) -> None:
    path = mine(tmp_path, RULES)
    result = program("companion", "fuzzy", path, "--write-table", *FEW)
    assert result.code == 0
    assert str(path.with_suffix(".table.json")) in result.out
    assert load_table(path)[1] == "stored"


def test_rules_that_rush_are_reported_and_fail(tmp_path: Path, program: ProgramHere) -> None:
    rushed = {distance: row[::-1] for distance, row in RULES.items()}
    result = program("companion", "fuzzy", mine(tmp_path, rushed), *FEW)
    assert result.code == 1
    assert "no stored table for these rules" in result.out
    assert "never faster when already closing faster: BROKEN, by up to" in result.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nobody"], "fuzzy: no 'nobody'"),
        (["--plot", "fuzzy.pdf"], "--plot fuzzy.pdf: expected a .png file"),
        (
            ["--plot", "nowhere/fuzzy.png"],
            "--plot nowhere/fuzzy.png: expected a .png file in a folder that exists",
        ),
    ],
)
def test_what_a_user_gets_wrong_is_one_line(words: list[str], said: str, program: ProgramHere) -> None:
    assert program("companion", "fuzzy", *words, *FEW).refusal.startswith(f"companion: {said}")


# ---------------- The fuzzy speed controller's picture: no label of it is cut off


def test_every_axis_label_lies_within_the_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []

    class Kept(Figure):
        def savefig(self, *args: Any, **options: Any) -> None:
            super().savefig(*args, **options)
            drawn.append(self)

    monkeypatch.setattr(plots, "Figure", Kept)
    plots.draw(load_rules("landing"), load_table("landing")[0], tmp_path / "fuzzy.png")
    (figure,) = drawn
    inside = figure.bbox
    for axes in figure.get_axes():
        for axis in (axes.xaxis, axes.yaxis, *([axes.zaxis] if hasattr(axes, "zaxis") else [])):
            box = axis.label.get_window_extent()
            assert axis.label.get_text()
            assert box.x0 >= inside.x0, axis.label.get_text()
            assert box.x1 <= inside.x1, axis.label.get_text()
