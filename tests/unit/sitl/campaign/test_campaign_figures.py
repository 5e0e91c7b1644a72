"""A campaign's numbers, tables and pictures."""

import io
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from sitl.campaign.manifest import make_plan
from sitl.campaign.plots import (
    draw_outcomes,
    draw_share,
    draw_touchdowns,
    looks_of_all,
    shown_width,
    write_plots,
)
from sitl.campaign.rows import Row
from sitl.campaign.tables import Percentiles, bars, print_summary, share, spread, worst
from sitl.scenario.scenario import PassBounds
from tests.unit.sitl.campaign.campaign_parts import PLOTS, row

SCENARIOS = make_plan(["static", "line"], 0, 1, None).scenarios
GOOD: dict[str, Any] = {"lateral_m": 0.05, "vertical_speed_m_s": 0.4, "horizontal_speed_m_s": 0.3}


# Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17 (1998),
# table I, method 3
@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_the_interval_is_wilsons_and_all_landed_no_certainty(
    hits: int, of: int, low: float, high: float
) -> None:
    found = share(hits, of)
    assert (found.low, found.high) == pytest.approx((low, high), abs=6e-5)
    assert str(share(100, 100)) == "100 % (96.3 to 100.0)"


def test_spread_is_over_sizes_of_what_was_measured() -> None:
    rows = [row(seed=k, vertical_speed_m_s=(-1) ** k * 0.01 * k) for k in range(101)] + [row(seed=101)]
    assert spread(rows, "vertical_speed_m_s") == Percentiles(pytest.approx(0.5), pytest.approx(0.95), 1.0)  # type: ignore[arg-type]
    assert spread([row()], "vertical_speed_m_s") is None


def test_the_worst_are_crashes_then_what_never_landed_then_the_farthest_off() -> None:
    rows = [
        row(seed=0, lateral_m=0.01),
        row(seed=1, outcome="missed", lateral_m=0.4),
        row(seed=2, outcome="aborted"),
        row(seed=3, outcome="timeout"),
        row(seed=4, outcome="crashed"),
        row(seed=5, outcome="failed"),
        row(seed=6, lateral_m=0.1),
    ]
    assert [each.seed for each in worst(rows, 6)] == [4, 5, 2, 3, 1, 6]


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        ({}, []),  # each holds up to itself
        ({"outcome": "aborted"}, ["landed"]),
        ({"lateral_m": 0.1501}, ["lateral worst"]),
        ({"vertical_speed_m_s": 0.401}, ["vertical speed"]),
        ({"horizontal_speed_m_s": 0.301}, ["horizontal speed"]),
    ],
)
def test_each_bar_can_break_by_itself(change: dict[str, Any], broken: list[str]) -> None:
    rows = [row(seed=0, **GOOD), row(seed=1, **GOOD), row(seed=2, **{**GOOD, **change})]
    assert [bar.name for bar in bars(rows) if not bar.holds] == broken


def test_the_median_is_that_of_each_scenario() -> None:
    good = [row("static", seed, **{**GOOD, "lateral_m": 0.001}) for seed in range(20)]
    poor = [row("line", seed, **{**GOOD, "lateral_m": 0.051}) for seed in range(3)]
    assert [bar.name for bar in bars(good + poor) if not bar.holds] == ["lateral median"]


def test_nothing_measured_holds_no_bar() -> None:
    assert not any(bar.holds for bar in bars([row(outcome="failed")]))
    assert not any(bar.holds for bar in bars([]))


def mixed() -> list[Row]:
    """Two scenarios, with everything that can become of a run."""
    landed = [row("static", seed, tilt_deg=1.0, total_s=30.0, **GOOD) for seed in range(8)]
    ended = ["missed", "aborted", "timeout", "crashed", "failed"]
    others = [row("line", seed, outcome, reason=f"why {seed}") for seed, outcome in enumerate(ended)]
    return [*landed, *others, row("line", 9, outcome="missed", lateral_m=0.5, vertical_speed_m_s=0.9)]


def summary(rows: list[Row], bounds: dict[str, PassBounds], width: int = 80) -> str:
    out = io.StringIO()
    print_summary(Console(file=out, width=width), rows, bounds)
    return out.getvalue()


def test_the_tables_fit_eighty_columns_and_name_what_repeats_the_worst() -> None:
    text = summary(mixed(), {name: scenario.pass_bounds for name, scenario in SCENARIOS.items()})
    assert "…" not in text
    assert "100 % (67.6 to 100.0)" in text
    assert "0 % (0.0 to 39.0)" in text
    told = text.partition("worst runs")[2]
    assert told.index("crashed: why 3") < told.index("aborted: why 1") < told.index("missed: 50.0 cm off")
    assert "    companion --scenario line --seed 3\n" in told


def test_bounds_that_differ_are_not_in_one_heading_and_no_run_is_no_table() -> None:
    text = summary(mixed(), {"static": PassBounds(), "line": PassBounds(lateral_error_m=0.3)}, 100)
    assert "<= 0.4" in text
    assert "<= 15" not in text
    assert summary([], {}) == "no run has ended yet\n"


def test_pictures_are_written_even_when_nothing_came_down(tmp_path: Path) -> None:
    for name, rows in {"mixed": mixed(), "none": [row("static", 0, "timeout")]}.items():
        (tmp_path / name).mkdir()
        paths = write_plots(tmp_path / name, rows, SCENARIOS)
        assert {path.name for path in paths} == PLOTS
        assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def grouped() -> dict[str, list[Row]]:
    rows = mixed()
    return {name: [each for each in rows if each.scenario == name] for name in ("static", "line")}


def test_a_curve_ends_at_the_share_that_came_down_within_the_picture() -> None:
    looks = dict(zip(grouped(), looks_of_all(2), strict=True))
    figure = draw_share(grouped(), looks, "touchdown_lateral_m", 100.0, "error (cm)", [0.15])
    axes: Any = figure.axes[0]
    ends = [line.get_ydata()[-1] for line in axes.get_lines()[:2]]
    assert ends == [100.0, 0.0]
    assert "1 run farther right" in axes.get_xlabel()


def test_the_bars_of_the_outcomes_fill_the_whole() -> None:
    axes: Any = draw_outcomes(grouped()).axes[0]
    widths: defaultdict[float, float] = defaultdict(float)
    for patch in axes.patches:
        widths[round(patch.get_y(), 3)] += patch.get_width()
    assert list(widths.values()) == [pytest.approx(100.0), pytest.approx(100.0)]


def test_touchdowns_are_drawn_with_the_heading_up_and_those_outside_are_counted() -> None:
    groups = {"static": [row(touchdown_lateral_m=0.1, touchdown_along_m=0.1, touchdown_across_m=-0.02)]}
    looks = dict(zip(grouped(), looks_of_all(2), strict=True))
    figure = draw_touchdowns(groups, looks, SCENARIOS)
    for axes in figure.axes:
        assert axes.collections[0].get_offsets().tolist() == [[-0.02, 0.1]]  # type: ignore[union-attr]
    far = {"static": [row(lateral_m=7.0)]}
    notes = [text.get_text() for axes in draw_touchdowns(far, looks, SCENARIOS).axes for text in axes.texts]
    assert notes == ["1 outside", "1 outside"]


def test_many_scenarios_each_look_different() -> None:
    assert len({(look.colour, look.line) for look in looks_of_all(20)}) == 20


def test_a_picture_reaches_as_far_as_there_is_something_to_see() -> None:
    # all within a third of the bound: they fill the picture, and the bound is named at its edge
    assert shown_width([1.0, 2.0, 4.0], [15.0]) == pytest.approx(5.0)
    # near the bound or past it: the bound is in the picture
    assert shown_width([1.0, 13.0, 200.0], [15.0]) == pytest.approx(1.15 * 15.0)
    assert shown_width([], [15.0]) == pytest.approx(1.15 * 15.0)
    assert shown_width([0.0], [15.0]) == pytest.approx(1.15 * 15.0)
