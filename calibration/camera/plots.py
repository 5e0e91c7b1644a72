"""Pictures of a camera's calibration: errors over the image, coverage, and the board's poses (PNG)."""

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from calibration.camera.board import CalibrationBoard
from calibration.camera.quality import Assessment
from calibration.camera.views import COLUMNS, ROWS
from companion.base.files import make_folder, save_figure

ERROR_COLOUR: Final = "tab:blue"
# the longest usual error is drawn this long, of the image's width
ARROW_SHARE: Final = 0.03


def write_plots(folder: Path, found: Assessment, board: CalibrationBoard) -> None:
    """Draw all into a folder, which is made."""
    make_folder("--plots", folder)
    drawings = (_errors(found), "errors"), (_coverage(found), "coverage"), (_poses(found, board), "poses")
    for figure, name in drawings:
        save_figure(figure, folder / f"{name}.png", dpi=110)


def _image_axes(axes: Any, size_px: tuple[int, int]) -> None:
    axes.set(xlim=(0, size_px[0]), ylim=(size_px[1], 0), xlabel="u (px)", ylabel="v (px)")
    axes.set_aspect("equal")


def _errors(found: Assessment) -> Figure:
    """Each corner's error as an arrow, much enlarged, over how certain the calibration is there."""
    figure = Figure(figsize=(11.0, 6.8), layout="constrained")
    solution = found.solution
    width, height = size = solution.camera.size_px
    axes = figure.add_subplot()
    shown = axes.imshow(
        found.projection_std_px,
        extent=(0, width, height, 0),
        interpolation="bilinear",
        cmap="YlOrRd",
        vmin=0.0,
        alpha=0.75,
    )
    figure.colorbar(shown, ax=axes, label="uncertainty of what is seen there, 1 σ (px)", shrink=0.8)
    corners = np.concatenate([s.view.corners_px for s in solution.seen])
    errors = solution.errors_px
    usual = float(np.percentile(np.linalg.norm(errors, axis=1), 95))
    scale = ARROW_SHARE * width / max(usual, 1e-6)
    axes.quiver(
        *corners.T,
        *errors.T,
        angles="xy",
        scale_units="xy",
        scale=1.0 / scale,
        color=ERROR_COLOUR,
        width=0.0015,
    )
    cx, cy = solution.camera.numbers[2:4]
    axes.plot(cx, cy, "k+", markersize=14)
    axes.annotate("principal point", (cx, cy), (6, 6), textcoords="offset points", fontsize=8)
    held = found.held_out_rms_px
    axes.set_title(
        f"errors of {len(errors)} corners, drawn {scale:.0f} times as long: rms {found.rms_px:.3f} px"
        + ("" if held is None else f", {held:.3f} px on views held out")
    )
    _image_axes(axes, size)
    return figure


def _coverage(found: Assessment) -> Figure:
    """All corners used, and the cells where there were none."""
    figure = Figure(figsize=(10.0, 6.2), layout="constrained")
    width, height = size = found.solution.camera.size_px
    axes = figure.add_subplot()
    for row, column in np.argwhere(~found.coverage.covered).tolist():
        at = (width * column / COLUMNS, height * row / ROWS)
        axes.add_patch(Rectangle(at, width / COLUMNS, height / ROWS, color="tab:red", alpha=0.2, linewidth=0))
    for seen in found.solution.seen:
        axes.plot(*seen.view.corners_px.T, ".", markersize=4)
    axes.set_title(
        f"corners of {len(found.solution.seen)} views: {100 * found.coverage.share:.0f} % of the image "
        "(red: too few)"
    )
    _image_axes(axes, size)
    return figure


def _poses(found: Assessment, board: CalibrationBoard) -> Figure:
    """The boards before the camera, in its axes: x right, z away from it, and up where the image's top is."""
    figure = Figure(figsize=(8.5, 7.5), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    width, height = board.size_m
    outline = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0), (0, 0, 0)], dtype=float)
    farthest = 0.0
    for seen in found.solution.seen:
        rotation, _ = cv2.Rodrigues(seen.turn)
        x, y, z = (outline @ rotation.T + seen.position_m).T
        axes.plot(x, z, -y, linewidth=1.0)
        farthest = max(farthest, float(z.max()))
    camera = found.solution.camera
    u, v = camera.size_px
    corners = np.array([(0, 0), (u, 0), (u, v), (0, v), (0, 0)], dtype=float)
    rays = camera.rays(corners) * 0.2 * farthest
    axes.plot(rays[:, 0], np.full(5, 0.2 * farthest), -rays[:, 1], color="black", linewidth=1.2)
    for x, y in rays[:4]:
        axes.plot((0, x), (0, 0.2 * farthest), (0, -y), color="black", linewidth=1.2)
    axes.set(xlabel="right (m)", ylabel="away from the camera (m)", zlabel="up in the image (m)")
    axes.set_aspect("equal")
    axes.view_init(elev=22, azim=-62)
    axes.set_title(
        f"{len(found.solution.seen)} boards before the camera, tilted by up to "
        f"{found.coverage.largest_tilt_deg:.0f}°"
    )
    return figure
