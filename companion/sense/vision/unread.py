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
from companion.sense.vision.aruco import Detection, farthest_apart, refine_corners, side_px
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

    def find(self, image: NDArray[np.uint8], pose: PoseFit) -> list[Detection]:
        """Markers that are not in the pose, with refined corners."""
        pixels = self._pixels(pose.camera_from_pad, pose.position_camera_m)
        width, height = self._lens.size_px
        inside = ((pixels > 0.0) & (pixels < (width - 1.0, height - 1.0))).all(axis=(1, 2))
        std_px = self._std_px(pose, pixels)
        used = {detection.marker for detection in pose.used}
        expected = []
        for k in np.flatnonzero(inside):
            marker, corners = self._markers[k], pixels[k]
            side = side_px(corners)
            cell = side / marker.cells
            legible = side >= self._config.minimum_side_px and cell >= CELL_PX
            if marker not in used and legible and std_px[k] < VAGUE_CELLS * cell:
                expected.append(Detection(marker, self._corners[k], corners, side))
        chosen = farthest_apart(expected, self._config.maximum_markers)
        refined = (d for d in refine_corners(image, chosen, self._lens, self._dot_m) if d.refined)
        return [d for d in refined if self._prints.likeness(image, d.marker, d.corners_px) >= LIKENESS]

    def _pixels(self, rotation: FloatArray, position: FloatArray) -> FloatArray:
        """Corners (n, 4, 2) of all markers; NaN where the lens cannot see."""
        return self._lens.project(self._corners.reshape(-1, 3) @ rotation.T + position)[0].reshape(-1, 4, 2)

    def _std_px(self, pose: PoseFit, pixels: FloatArray) -> FloatArray:
        """How far (n,) off each marker's corners may be expected, by the pose's covariance.

        Without the calibration's error, which is the same in all that this picture shows.
        """
        covariance = pose.covariance.copy()
        covariance[:3, :3] -= pose.common_variance_m2 * np.eye(3)
        values, axes = np.linalg.eigh(covariance)
        variance = np.zeros(len(pixels))
        for step in (axes * np.sqrt(np.maximum(values, 0.0))).T:
            turn = matrix_from_quat(quat_from_rotation_vector(vector3(step[3:].tolist())))
            moved = self._pixels(turn @ pose.camera_from_pad, pose.position_camera_m + step[:3])
            variance += ((moved - pixels) ** 2).sum(axis=2).max(axis=1)
        return np.asarray(np.sqrt(variance))
