"""What each plot says by itself: its title, what passes, the touchdown; one colour set for the groups."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from companion.base.messages import Phase, PlanStep
from companion.config import CONFIG_FOLDER
from companion.flightlog.errors import TruthTrack
from companion.flightlog.report import plots
from companion.flightlog.report.tables import stage_text
from companion.pad.colours import GROUP_COLOURS, bgr
from tests.unit.flightlog.test_result import truth_at

TRUTH = [replace(truth_at(0.1 * k), in_contact=k >= 76) for k in range(100)]
PLANS = [PlanStep(0.1 * k, Phase.DESCEND if k < 80 else Phase.LANDED) for k in range(100)]


def test_each_plot_has_a_title_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles: list[str] = []
    suptitle = Figure.suptitle

    def kept(figure: Figure, text: str) -> None:
        titles.append(text)
        suptitle(figure, text)

    monkeypatch.setattr(Figure, "suptitle", kept)
    written = plots.write_plots(tmp_path, {"plan": PLANS}, TRUTH, title="circle, seed 0")
    assert len(set(titles)) == len(written) == 5
    assert all(text.endswith("circle, seed 0") for text in titles)


def test_the_distance_has_the_pass_line_and_the_touchdown_s_mark_in_centimetres() -> None:
    figure = Figure()
    plots.draw_lateral(figure, TruthTrack(TRUTH), {"plan": PLANS}, 0.15)
    axes = next(axes for axes in figure.axes if "(cm)" in axes.get_ylabel())
    heights = [line.get_ydata() for line in axes.lines]
    assert any(np.all(np.asarray(y) == 15.0) for y in heights)
    assert any(np.all(np.asarray(line.get_xdata()) == PLANS[80].time_s) for line in axes.lines)
    assert any(np.all(np.asarray(line.get_xdata()) == TRUTH[76].time_s) for line in axes.lines)
    assert [text.get_text() for text in axes.texts] == ["contact", "landed"]


def test_the_sink_rate_has_its_pass_line_and_the_legend_names_it() -> None:
    figure = Figure()
    plots.draw_height(figure, TruthTrack(TRUTH), {"plan": PLANS}, 0.4)
    axes = next(axes for axes in figure.axes if "sink rate" in axes.get_ylabel())
    assert any(np.all(np.asarray(line.get_ydata()) == 0.4) for line in axes.lines)
    (legend,) = figure.legends
    assert "passes below this, at the touchdown" in [text.get_text() for text in legend.get_texts()]


def test_a_stage_that_was_never_reached_has_no_time() -> None:
    assert [stage_text(seconds) for seconds in (0.0, 4.96)] == ["-", "5.0"]


def test_the_marker_groups_have_one_colour_set() -> None:
    assert bgr(GROUP_COLOURS["M"]) == (0, 159, 230)
    root = CONFIG_FOLDER.parent
    for folder in ("companion", "docs", "sitl", "calibration"):
        for path in (root / folder).rglob("*.py"):
            own = re.search(r'"F": ["(][#\d]', path.read_text())
            assert own is None or path.name == "colours.py", path
