"""Predicted recall by height, as a table and as a picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
from rich.table import Table

from companion.base.files import save_figure
from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import CameraConfig
from companion.pad import Pad
from companion.pad.colours import GROUP_COLOURS
from companion.sense.vision.aruco import GROUPS
from companion.tools.pads.coverage import BLIND_RECALL, PredictedRecall, seen_between

TABLE_HEIGHTS_M: Final = (0.05, 0.08, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 4.0, 6.0, 9.0, 12.0, 15.0)
TICKS_M: Final = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SURE_RECALL: Final = 0.99
COLOURS: Final = GROUP_COLOURS
NAMES: Final[dict[MarkerGroup, str]] = {"F": "F (far)", "M": "M (medium)", "C": "C (close)"}


def coverage_table(coverage: PredictedRecall) -> Table:
    """Recall in per cent, a row a height."""
    made = Table(title="predicted recall (%) by height", title_justify="left")
    for name in ("m", *(NAMES[g] for g in GROUPS if g in coverage.groups), "pad"):
        made.add_column(name, justify="right")
    columns = [
        coverage.heights_m,
        *(coverage.groups[g] for g in GROUPS if g in coverage.groups),
        coverage.pad,
    ]
    for height, *recalls in zip(*columns, strict=True):
        made.add_row(f"{height:g}", *(f"{100 * r:.1f}" for r in recalls))
    return made


def coverage_lines(coverage: PredictedRecall) -> list[str]:
    """From where to where each group and the pad are seen, the weakest height between, the blind height."""
    rows = [(f"  {NAMES[g]}", coverage.groups[g]) for g in GROUPS if g in coverage.groups]
    lines = [
        f"{name}: {_span(coverage.heights_m, recall)}" for name, recall in [*rows, ("  pad", coverage.pad)]
    ]
    if math.isnan(coverage.blind_height_m):
        return [*lines, "blind at every height"]
    low, high = seen_between(coverage.heights_m, coverage.pad, SURE_RECALL)
    between = (coverage.heights_m >= low) & (coverage.heights_m <= high)
    if between.any():
        weakest = np.flatnonzero(between)[int(np.argmin(coverage.pad[between]))]
        lines.append(
            f"weakest in between: {100 * coverage.pad[weakest]:.2f} % at {coverage.heights_m[weakest]:.2g} m"
        )
    return [*lines, f"blind height: {blind_words(coverage)} (there, seen in less than half of the frames)"]


def blind_words(coverage: PredictedRecall) -> str:
    """How low the pad is seen, where a prediction ends before it is blind: less than that."""
    return f"{'less than' if coverage.seen_at_the_lowest else 'below'} {100 * coverage.blind_height_m:.1f} cm"


def _span(heights_m: FloatArray, recall: FloatArray) -> str:
    words = []
    for least in (SURE_RECALL, BLIND_RECALL):
        low, high = seen_between(heights_m, recall, least)
        span = "nowhere" if math.isnan(low) else f"{low:.2g} to {high:.2g} m"
        words.append(f"{100 * least:g} % {span}")
    return ", ".join(words)


def draw_coverage(coverage: PredictedRecall, pad: Pad, camera: CameraConfig, path: Path) -> None:
    """Recall over the height, a line for each group and the pad.

    Raises:
        ConfigError: it cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow

    figure = Figure(figsize=(9.0, 4.6), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.plot(coverage.heights_m, 100.0 * coverage.pad, color="0.7", linewidth=5.0, label="pad")
    for group, recall in coverage.groups.items():
        axes.plot(coverage.heights_m, 100.0 * recall, color=COLOURS[group], label=NAMES[group])
    if not (math.isnan(coverage.blind_height_m) or coverage.seen_at_the_lowest):
        words = f"blind: {blind_words(coverage)}"
        axes.axvspan(coverage.heights_m[0], coverage.blind_height_m, color="0.9", label=words)
    axes.set_xscale("log")
    axes.set_xticks(TICKS_M, [f"{h:g}" for h in TICKS_M])
    axes.minorticks_off()
    axes.set(xlim=(coverage.heights_m[0], coverage.heights_m[-1]), ylim=(-2.0, 102.0))
    axes.set(xlabel="height of the camera (m)", ylabel="predicted recall (%)")
    axes.set_title(f"{pad.name} seen by {camera.name}")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    save_figure(figure, path)
