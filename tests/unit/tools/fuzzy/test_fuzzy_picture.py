"""The fuzzy speed controller's picture: no label of it is cut off."""

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from companion.plan.speed.fuzzy_rules import load_rules
from companion.plan.speed.speed_table import load_table
from companion.tools.fuzzy import run as plots


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
