"""Markers that are in view but could not be read, found from where a few that were read say that they are.

A code of cells of 3 px is read with luck, and one that is half in the shade or dirty is not; its sides can be
followed all the same. Where few markers give the pose, the others are where that puts them to within a part
of a cell: their sides are refined from there, and they count when their print is to be seen between.

Pixels: u right, v down. Pad frame: metres.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_rotation_vector, vector3
from companion.config import VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import ENOUGH, Detection, farthest_apart, refine_corners, sides_px
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import PoseFit
from companion.sense.vision.print_check import CELL_PX, LIKENESS, PrintCheck

# one that is expected with a larger standard deviation may be refined to its neighbour's side: cells
VAGUE_CELLS: Final = 0.8


class UnreadMarkers:
    """Knows one pad's markers before one camera."""

    def __init__(self, pad: Pad, lens: Lens, config: VisionConfig, prints: PrintCheck) -> None:
        self._lens, self._config, self._prints = lens, config, prints
        self._markers = pad.markers
        self._dot_m = pad.sheet.dot_m
        self._corners = np.array([marker.corners_pad_m() for marker in pad.markers])
        cells = np.array([marker.cells for marker in pad.markers])
        self._least_px = np.maximum(config.minimum_side_px, CELL_PX * cells)

    def find(self, image: NDArray[np.uint8], pose: PoseFit) -> list[Detection]:
        """Some markers that are not in the pose, with refined corners: those farthest from what is in it."""
        points = self._corners.reshape(-1, 3)
        seen = points @ pose.camera_from_pad.T + pose.position_camera_m
        pixels = self._lens.project(seen)[0].reshape(-1, 4, 2)
        width, height = self._lens.size_px
        inside = ((pixels > 0.0) & (pixels < (width - 1.0, height - 1.0))).all(axis=(1, 2))
        used = {detection.marker for detection in pose.used}
        sides = sides_px(pixels)
        legible = []
        for k in np.flatnonzero(inside & (sides >= self._least_px)):
            marker, side = self._markers[k], float(sides[k])
            if marker not in used:
                legible.append((k, Detection(marker, self._corners[k], pixels[k], side)))
        if not legible:
            return []
        numbers = [k for k, _ in legible]
        std_px = self._std_px(pose, self._corners[numbers].reshape(-1, 3), pixels[numbers])
        expected = [
            d for (_, d), std in zip(legible, std_px.tolist(), strict=True)
            if std < VAGUE_CELLS * d.side_px / d.marker.cells
        ]  # fmt: skip
        chosen = farthest_apart(expected, max(ENOUGH - len(used), 1), pose.used)
        refined = (d for d in refine_corners(image, chosen, self._lens, self._dot_m) if d.refined)
        return [d for d in refined if self._prints.likeness(image, d.marker, d.corners_px) >= LIKENESS]

    def _std_px(self, pose: PoseFit, points: FloatArray, pixels: FloatArray) -> FloatArray:
        """How far (n,) off markers' corners (4n, 3) on the pad may be from (n, 4, 2) px, by the covariance.

        Without the calibration's error, which is the same in all that this picture shows.
        """
        covariance = pose.covariance.copy()
        covariance[:3, :3] -= pose.common_variance_m2 * np.eye(3)
        values, axes = np.linalg.eigh(covariance)
        moved = []
        for step in (axes * np.sqrt(np.maximum(values, 0.0))).T:
            turn = matrix_from_quat(quat_from_rotation_vector(vector3(step[3:].tolist())))
            moved.append(points @ (turn @ pose.camera_from_pad).T + pose.position_camera_m + step[:3])
        there = self._lens.project(np.concatenate(moved))[0].reshape(len(moved), -1, 4, 2)
        return np.asarray(np.sqrt(((there - pixels) ** 2).sum(axis=3).max(axis=2).sum(axis=0)))
