"""The fuzzy speed controller's picture: membership functions (Figs. 7 and 8) and the resulting speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from companion.plan.speed.fuzzy_rules import INPUTS, OUTPUT, FuzzyRules, Terms, in_order
from companion.plan.speed.speed_table import SpeedTable

mpl.use("Agg")

LABELS: Final = {
    "distance_m": "distance (m)",
    "velocity_m_s": "closing velocity (m/s)",
    "acceleration_m_s2": "closing acceleration (m/s²)",
    OUTPUT: "average speed V (m/s)",
}
SURFACE_POINTS: Final = 60
BOX_SHARE: Final = 0.86


def draw(rules: FuzzyRules, table: SpeedTable, path: Path) -> None:
    """Draw all into a PNG.

    Raises:
        OSError: it cannot be written.
    """
    figure = Figure(figsize=(15.0, 8.5), dpi=110, layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.7))
    top, bottom = halves
    for axes, name in zip(top.subplots(1, 4), (*INPUTS, OUTPUT), strict=True):
        _draw_terms(axes, getattr(rules, name), LABELS[name])
    axis = table.acceleration_m_s2
    highest = max(max(row) for plane in table.speed_m_s for row in plane)
    for column, acceleration in enumerate((axis[0], 0.5 * (axis[0] + axis[-1]), axis[-1])):
        _draw_surface(bottom.add_subplot(1, 3, column + 1, projection="3d"), table, acceleration, highest)
    figure.suptitle(f"{rules.name}: the expert's terms, and the speed V(distance, velocity, acceleration)")
    figure.savefig(path)


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


def _draw_surface(axes: Any, table: SpeedTable, acceleration_m_s2: float, highest_m_s: float) -> None:
    distance = np.linspace(table.distance_m[0], table.distance_m[-1], SURFACE_POINTS)
    velocity = np.linspace(table.velocity_m_s[0], table.velocity_m_s[-1], SURFACE_POINTS)
    speed = np.array([[table(d, v, acceleration_m_s2) for d in distance.tolist()] for v in velocity.tolist()])
    grid = np.meshgrid(distance, velocity)
    axes.plot_surface(*grid, speed, cmap="viridis", vmin=0.0, vmax=highest_m_s, rcount=40, ccount=40)
    axes.set_xlabel(LABELS["distance_m"])
    axes.set_ylabel(LABELS["velocity_m_s"])
    axes.set_zlabel("V (m/s)")
    axes.set_zlim(0.0, highest_m_s)
    axes.view_init(elev=26.0, azim=-128.0)
    # the layout knows nothing of a 3-D axis's label: without room at its side it is cut off
    axes.set_box_aspect(None, zoom=BOX_SHARE)
    axes.set_title(f"acceleration {acceleration_m_s2:+.1f} m/s²")
