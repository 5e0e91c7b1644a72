"""A campaign as pictures (PNG): how sure, how exact, how soft, and where on the pad.

`outcomes.png` (shares with the success's 95 % interval), `lateral.png` and `vertical_speed.png` (share of all
runs that came down at most so far off or so hard, a curve a scenario), `touchdowns.png` (places on the pad).
Pad axes: along the pad's heading up, to its right to the right; metres. Colours are Okabe and Ito's, which
people who see few colours tell apart.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator

from companion.base.files import save_figure
from companion.pad import Pad, load_pad
from sitl.campaign.rows import OUTCOMES, Row
from sitl.campaign.tables import by_scenario, share, values
from sitl.scenario.scenario import Scenario

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS: Final = ("o", "^", "s", "D", "v", "P", "X")
LINES: Final = ("-", "--", "-.", ":")
OUTCOME_COLOURS: Final = {
    "landed": "#009E73",
    "missed": "#E69F00",
    "aborted": "#56B4E9",
    "timeout": "#CC79A7",
    "crashed": "#D55E00",
    "failed": "#999999",
}
# from here on a picture would rather show what is inside
FAR_PADS: Final = 1.5
CLOSE_BOUNDS: Final = 1.15
# how far a curve's picture reaches: past the largest bound, or past the largest size
BOUND_SHARE: Final = 1.15
DATA_SHARE: Final = 1.25


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """How a scenario is drawn, in every picture alike."""

    colour: str
    marker: str
    line: str


def write_plots(folder: Path, rows: Sequence[Row], scenarios: Mapping[str, Scenario]) -> list[Path]:
    """Draw a campaign (at least one row) into PNG files; returns their paths."""
    groups = by_scenario(rows)
    looks = dict(zip(groups, looks_of_all(len(groups)), strict=True))
    drawings = {
        "outcomes.png": draw_outcomes(groups),
        "lateral.png": draw_share(
            groups,
            looks,
            "touchdown_lateral_m",
            100.0,
            "lateral error at touchdown (cm)",
            _bounds(groups, scenarios, "lateral_error_m"),
        ),
        "vertical_speed.png": draw_share(
            groups,
            looks,
            "vertical_speed_m_s",
            1.0,
            "closing speed at touchdown (m/s)",
            _bounds(groups, scenarios, "vertical_speed_m_s"),
        ),
        "touchdowns.png": draw_touchdowns(groups, looks, scenarios),
    }
    paths = []
    for name, figure in drawings.items():
        paths.append(folder / name)
        save_figure(figure, paths[-1])
    return paths


def looks_of_all(count: int) -> list[PlotStyle]:
    """So many looks; lines change where colours come round again."""
    endless = zip(
        cycle(COLOURS), cycle(MARKERS), (LINES[k // len(COLOURS) % len(LINES)] for k in range(count))
    )
    return [PlotStyle(*parts) for parts in endless]


def _bounds(groups: Mapping[str, Any], scenarios: Mapping[str, Scenario], name: str) -> list[float]:
    """The different bounds of the scenarios for one figure."""
    return sorted({getattr(scenarios[scenario].pass_bounds, name) for scenario in groups})


def _runs(count: int) -> str:
    return f"{count} run{'' if count == 1 else 's'}"


# ---------------------------------------------------------------- outcomes


def draw_outcomes(groups: Mapping[str, Sequence[Row]]) -> Figure:
    """Shares of the outcomes, a bar a scenario, with the success's interval."""
    figure = Figure(figsize=(9.0, 1.8 + 0.5 * len(groups)), dpi=110, layout="constrained")
    axes: Any = figure.subplots()
    names = list(groups)[::-1]
    left = np.zeros(len(names))
    for outcome in OUTCOMES:
        counts = np.array([sum(row.outcome == outcome for row in groups[name]) for name in names])
        if not counts.any():
            continue
        shares = 100.0 * counts / np.array([len(groups[name]) for name in names])
        axes.barh(names, shares, left=left, height=0.6, color=OUTCOME_COLOURS[outcome], label=outcome)
        left += shares
    for place, name in enumerate(names):
        success = share(sum(row.landed for row in groups[name]), len(groups[name]))
        ends = [[100.0 * (success.value - success.low)], [100.0 * (success.high - success.value)]]
        axes.errorbar(100.0 * success.value, place, xerr=np.maximum(ends, 0.0), color="black", capsize=5)
        axes.text(102.0, place, f"{success.hits} of {success.of}", va="center", fontsize=9)
    axes.set_xlim(0.0, 114.0)
    axes.set_ylim(-0.6, len(names) - 0.4)
    axes.set_xticks(range(0, 101, 10))
    axes.set_xlabel("share of the runs (%); black: landed, 95 % interval")
    axes.set_title("How the runs ended")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=len(OUTCOMES), frameon=False)
    return figure


# ---------------------------------------------------------------- distributions


def shown_width(sizes: Sequence[float], bounds: Sequence[float]) -> float:
    """How far a picture of these sizes reaches: past the bounds only as far as they lie among the sizes.

    Sizes far within the bounds fill the picture; those far beyond are counted instead of drawn.
    """
    limit = BOUND_SHARE * max(bounds)
    largest = max((size for size in sizes if size <= limit), default=limit)
    reach = DATA_SHARE * largest
    return limit if largest <= 0.0 or reach >= min(bounds) else reach


def draw_share(
    groups: Mapping[str, Sequence[Row]],
    looks: Mapping[str, PlotStyle],
    column: str,
    factor: float,
    label: str,
    bounds: Sequence[float],
) -> Figure:
    """Share of all runs whose `column` is at most so large; one that never came down is in none."""
    figure = Figure(figsize=(9.0, 5.5), dpi=110, layout="constrained")
    axes: Any = figure.subplots()
    quantity, _, unit = label.removesuffix(")").partition(" (")
    widest = shown_width(
        [factor * value for group in groups.values() for value in values(group, column)],
        [factor * bound for bound in bounds],
    )
    beyond = 0
    for name, group in groups.items():
        sizes = factor * np.array(values(group, column))
        beyond += int(np.sum(sizes > widest))
        sizes = sizes[sizes <= widest]
        x = np.concatenate([[0.0], sizes, [widest]])
        y = 100.0 * np.concatenate([[0.0], np.arange(1, len(sizes) + 1), [len(sizes)]]) / len(group)
        look = looks[name]
        axes.step(
            x,
            y,
            where="post",
            color=look.colour,
            linestyle=look.line,
            linewidth=1.8,
            label=f"{name} ({_runs(len(group))})",
        )
    for line, bound in enumerate(bounds):
        place = min(factor * bound, widest)
        farther = " →" if factor * bound > widest else " "
        axes.axvline(factor * bound, color="black", linestyle=":", linewidth=1.2)
        axes.text(
            place, 2.0 + 5.0 * line, f" passes at {factor * bound:g} {unit}{farther}", ha="right", fontsize=9
        )
    axes.set_xlim(0.0, widest)
    axes.set_ylim(0.0, 103.0)
    axes.grid(visible=True, alpha=0.25)
    axes.set_xlabel(label + (f"; {_runs(beyond)} farther right than this" if beyond else ""))
    axes.set_ylabel("share of all runs (%)")
    axes.set_title(f"{quantity.capitalize()}: share of the runs at or below")
    figure.legend(loc="outside lower center", ncols=min(5, len(groups)), frameon=False)
    return figure


# ---------------------------------------------------------------- places


def draw_touchdowns(
    groups: Mapping[str, Sequence[Row]], looks: Mapping[str, PlotStyle], scenarios: Mapping[str, Scenario]
) -> Figure:
    """Where the vehicles came down: the whole pad on the left, then the middle of it for each scenario."""
    columns = math.ceil(math.sqrt(len(groups)))
    lines = math.ceil(len(groups) / columns)
    beside_in = max(5.0, 3.0 * columns)
    figure = Figure(figsize=(6.0 + beside_in, max(6.6, 3.2 * lines)), dpi=110, layout="constrained")
    halves = figure.add_gridspec(1, 2, width_ratios=(5.5, beside_in))
    panels = halves[1].subgridspec(lines, columns)
    whole: Any = figure.add_subplot(halves[0])
    pads = {scenario.pad.name: load_pad(scenario.pad.name) for scenario in scenarios.values()}
    reach_m = 0.5 * FAR_PADS * max(max(pad.length_m, pad.width_m) for pad in pads.values())
    draw_places(whole, groups, looks, scenarios, pads, reach_m)
    whole.set_title("Touchdowns on the pad; dashed: passes within")
    whole.set_xlabel("to the right of the pad's heading (m)")
    whole.set_ylabel("along the pad's heading (m)")
    # all on one scale, so that they can be compared
    reach_m = max(_close_reach_m(group, scenarios[name]) for name, group in groups.items())
    for place, (name, group) in enumerate(groups.items()):
        axes: Any = figure.add_subplot(panels[divmod(place, columns)])
        bound_m = scenarios[name].pass_bounds.lateral_error_m
        draw_places(axes, {name: group}, looks, scenarios, pads, reach_m)
        axes.set_title(f"{name} (cm): passes within {100.0 * bound_m:g} cm", fontsize=10)
        axes.tick_params(labelsize=7)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(5, symmetric=True))
            axis.set_major_formatter(lambda metres, _place: f"{100.0 * metres:g}")
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(6, len(groups)), frameon=False)
    return figure


def _close_reach_m(group: Sequence[Row], scenario: Scenario) -> float:
    met = [row for row in group if row.touchdown_along_m is not None]
    farthest = [max(abs(row.touchdown_along_m or 0), abs(row.touchdown_across_m or 0)) for row in met]
    return shown_width(farthest, [CLOSE_BOUNDS * scenario.pass_bounds.lateral_error_m])


def draw_places(
    axes: Any,
    groups: Mapping[str, Sequence[Row]],
    looks: Mapping[str, PlotStyle],
    scenarios: Mapping[str, Scenario],
    pads: Mapping[str, Pad],
    reach_m: float,
) -> None:
    """Pads, bounds and touchdowns within `reach_m` of the centre; a note counts those beyond."""
    for name in {scenarios[group].pad.name for group in groups}:
        _draw_pad(axes, pads[name])
    for bound in _bounds(groups, scenarios, "lateral_error_m"):
        axes.add_patch(Circle((0.0, 0.0), bound, fill=False, linestyle="--", linewidth=1.3, color="black"))
    beyond = sum(_draw_group(axes, name, group, looks[name], reach_m) for name, group in groups.items())
    axes.set_aspect("equal")
    axes.set_xlim(-reach_m, reach_m)
    axes.set_ylim(-reach_m, reach_m)
    if beyond:
        axes.text(0.02, 0.98, f"{beyond} outside", transform=axes.transAxes, va="top", fontsize=8)


def _draw_pad(axes: Any, pad: Pad) -> None:
    corner = (-0.5 * pad.width_m, -0.5 * pad.length_m)
    axes.add_patch(
        Rectangle(corner, pad.width_m, pad.length_m, facecolor="#fafafa", edgecolor="black", linewidth=1.4)
    )
    for marker in pad.markers:
        corners = marker.corners_pad_m()
        # pad axes are x along, y right: drawn with x up
        axes.fill(corners[:, 1], corners[:, 0], facecolor="#e4e4e4", edgecolor="none", zorder=1)
    axes.axhline(0.0, color="grey", linewidth=0.4)
    axes.axvline(0.0, color="grey", linewidth=0.4)


def _draw_group(axes: Any, name: str, group: Sequence[Row], look: PlotStyle, reach_m: float) -> int:
    """A scenario's touchdowns; returns how many lie outside the picture."""
    met = [row for row in group if row.touchdown_along_m is not None]
    across = np.array([row.touchdown_across_m for row in met], dtype=float)
    along = np.array([row.touchdown_along_m for row in met], dtype=float)
    axes.scatter(
        across,
        along,
        s=24,
        marker=look.marker,
        facecolor=look.colour,
        edgecolor="white",
        linewidth=0.5,
        alpha=0.85,
        zorder=3,
        label=f"{name} ({len(met)})",
    )
    return int(np.sum(np.maximum(np.abs(across), np.abs(along)) > reach_m))
