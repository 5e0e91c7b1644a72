"""The fuzzy speed controller's picture: membership functions (Figs. 7 and 8) and the resulting speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from companion.base.files import save_figure
from companion.plan.speed.fuzzy_check import AnyTable
from companion.plan.speed.fuzzy_rules import OUTPUT, FuzzyRules, RuleSet, Terms, in_order
from companion.plan.speed.speed_table import SpeedTable

mpl.use("Agg")

LABELS: Final = {
    "distance_m": "distance (m)",
    "velocity_m_s": "closing velocity (m/s)",
    "acceleration_m_s2": "closing acceleration (m/s²)",
    OUTPUT: "average speed V (m/s)",
    "sight_rad": "sight: error as an angle (rad)",
    "relative_speed_m_s": "relative speed (m/s)",
    "gust_m_s2": "gusts (m/s²)",
    "factor": "pace: factor on V",
}
SURFACE_POINTS: Final = 60
BOX_SHARE: Final = 0.86


def draw(rules: FuzzyRules, table: SpeedTable, path: Path) -> None:
    """Draw all into a PNG.

    Raises:
        ConfigError: it cannot be written.
    """
    sets: list[tuple[RuleSet, AnyTable]] = [(rules, table)]
    if rules.pace is not None and table.pace is not None:
        sets.append((rules.pace, table.pace))
    figure = Figure(figsize=(15.0, 8.5 * len(sets)), dpi=110, layout="constrained")
    halves: Any = figure.subfigures(2 * len(sets), 1, height_ratios=(1.0, 1.7) * len(sets))
    for (rule_set, surface), terms, surfaces in zip(sets, halves[::2], halves[1::2], strict=True):
        for axes, name in zip(terms.subplots(1, 4), (*rule_set.inputs, rule_set.output), strict=True):
            _draw_terms(axes, rule_set.terms(name), LABELS[name])
        third = getattr(surface, rule_set.inputs[2])
        for column, value in enumerate((third[0], 0.5 * (third[0] + third[-1]), third[-1])):
            axes = surfaces.add_subplot(1, 3, column + 1, projection="3d")
            _draw_surface(axes, rule_set, surface, value)
    figure.suptitle(f"{rules.name}: the expert's terms, the speed V, and its pace by the conditions")
    save_figure(figure, path)


def _draw_terms(axes: Any, terms: Terms, label: str) -> None:
    low = min(corners[0] for corners in terms.values())
    high = max(corners[-1] for corners in terms.values())
    for name in in_order(terms):
        corners = terms[name]
        heights = (0.0, 1.0, 0.0) if len(corners) == 3 else (0.0, 1.0, 1.0, 0.0)
        (line,) = axes.plot(corners, heights, linewidth=1.4, label=name)
        axes.fill_between(corners, heights, alpha=0.12, color=line.get_color())
    axes.set_xlim(low, high)
    axes.set_ylim(0.0, 1.45)
    axes.legend(loc="upper center", ncols=3, fontsize=7, frameon=False)
    axes.set_yticks((0.0, 0.5, 1.0))
    axes.set_xlabel(label)
    axes.set_ylabel("membership")


def _draw_surface(axes: Any, rules: RuleSet, table: AnyTable, third: float) -> None:
    first, second, name = rules.inputs
    x, y = (
        np.linspace(getattr(table, axis)[0], getattr(table, axis)[-1], SURFACE_POINTS)
        for axis in (first, second)
    )
    output = np.array([[table(d, v, third) for d in x.tolist()] for v in y.tolist()])
    highest = float(np.max(getattr(table, rules.output)))
    grid = np.meshgrid(x, y)
    axes.plot_surface(*grid, output, cmap="viridis", vmin=0.0, vmax=highest, rcount=40, ccount=40)
    axes.set_xlabel(LABELS[first])
    axes.set_ylabel(LABELS[second])
    axes.set_zlabel(LABELS[rules.output])
    axes.set_zlim(0.0, highest)
    # from below of the slope: V rises with distance, the pace falls with whatever is worse
    axes.view_init(elev=26.0, azim=-128.0 if rules.output == OUTPUT else 52.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    # the layout knows nothing of a 3-D axis's label: without room at its side it is cut off
    axes.set_box_aspect(None, zoom=BOX_SHARE)
    sign = "+" if name == "acceleration_m_s2" else ""  # gusts have none
    axes.set_title(f"{LABELS[name].partition(' (')[0]} {third:{sign}.1f} m/s²")
