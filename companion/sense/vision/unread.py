"""Markers that are in view but could not be read, found from where the pad is expected to have them.

A code of cells of 3 px is read with luck, and one that is half in the shade or dirty is not; its sides can be
followed all the same. Where few markers give the pose, the others are where that puts them to within a part
of a cell: their sides are refined from there, and they count when their print is to be seen between
(`UnreadMarkers`).

A tag that is alone grows out of the image, half a metre below a usual camera; one that something lies on,
or that lies half in the shade, has sides that cannot be followed. Where the pad is expected to within a part
of a cell, its print is laid on whatever of it is in the image, and counts when it is to be seen there. The
part is a rectangle of whole and half cells; its corners take the place of the marker's (`PartialMarkers`).

Pixels: u right, v down. Pad frame: metres.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_rotation_vector, vector3
from companion.config import VisionConfig
from companion.pad import Marker, Pad
from companion.sense.vision.aruco import (
    ENOUGH,
    Detection,
    by_print,
    farthest_apart,
    refine_corners,
    sides_px,
)
from companion.sense.vision.edges import PROPORTIONAL
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import PoseFit
from companion.sense.vision.print_check import CELL_PX, LIKENESS, PrintCheck
from companion.sense.vision.print_fit import PrintFit, fit_prints
from companion.sense.vision.search import EDGE_PX

# one that is expected with a larger standard deviation may be refined to its neighbour's side: cells
VAGUE_CELLS: Final = 0.8
# a print is found from half a cell beside it
FOUND_FROM_CELLS: Final = 0.5
EXPECTED_SIGMA: Final = 2.0
# one whose corners are less certain is not held by what is seen of it: cells
LOOSE_CELLS: Final = 0.1
# a print is found in an image whose cells are shrunk to so many pixels, and then measured in one in which the
# sides of what is in view are so long: where a few cells fill the image, their edges are all that there is
FITTED_CELL_PX: Final = 8.0
FITTED_SIDE_PX: Final = 72.0
# and is smoothed by so much: what is sharper than its pixels is like a print of no blur, and fits nowhere
SMOOTHED_PX: Final = 0.9
STEPS: Final = 2  # a cell is divided into
# a part that is narrower has too few edges side by side: its blur, its shade and its width are not told apart
LEAST_ACROSS_CELLS: Final = 2.5
# of the part that is in the image: where more is not like the print, it is something else
LEAST_LEFT: Final = 0.4


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


class PartialMarkers:
    """Knows one pad's markers before one camera, cell by cell."""

    def __init__(self, pad: Pad, lens: Lens, prints: PrintCheck) -> None:
        self._lens, self._prints, self._dot_m = lens, prints, pad.sheet.dot_m
        self._linear = np.rint(lens.light).astype(np.uint8)
        self._grids = [(marker, _grid(marker)) for marker in pad.markers]

    def find(
        self,
        image: NDArray[np.uint8],
        camera_from_pad: FloatArray,
        pad_position_camera_m: FloatArray,
        position_std_m: float,
    ) -> list[Detection]:
        """The largest parts of markers that are to be seen where they are expected, of four at most.

        Args:
            image: (height, width).
            camera_from_pad: rotation (3, 3).
            pad_position_camera_m: (3,) of the pad's centre.
            position_std_m: standard deviation of that position, each axis.
        """
        least_m = EXPECTED_SIGMA / FOUND_FROM_CELLS * position_std_m
        parts = []
        for marker, grid in self._grids:
            if marker.cell_m > least_m:
                pixels = self._pixels(grid @ camera_from_pad.T + pad_position_camera_m)
                part = _largest(self._inside(pixels))
                if part is not None:
                    parts.append((marker, pixels, part))
        parts.sort(key=lambda each: -_area(each[2]))
        found = (self._measured(image, *each) for each in parts[:ENOUGH])
        return [detection for detection in found if detection is not None]

    def _pixels(self, grid_camera_m: FloatArray) -> FloatArray:
        """Where places (n, n, 3) on a marker, in camera axes, are in the image (n, n, 2)."""
        return self._lens.project(grid_camera_m.reshape(-1, 3))[0].reshape(*grid_camera_m.shape[:2], 2)

    def _inside(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Which of these (n, n, 2) the image shows."""
        far = np.array(self._lens.size_px) - EDGE_PX
        with np.errstate(invalid="ignore"):
            return np.asarray(((pixels > EDGE_PX) & (pixels < far)).all(axis=2))

    def _measured(
        self, image: NDArray[np.uint8], marker: Marker, pixels: FloatArray, part: FloatArray
    ) -> Detection | None:
        """A part of a marker, if its print is seen about where places (n, n, 2) px on it are expected.

        What something lies on is left out: what is like the print by chance there would move the rest.
        """
        found = self._fitted(image, marker, pixels, part)
        corners = _quad(pixels, part) if found is None else found.corners_px
        covered = self._prints.covered(image, marker, corners, part)
        if not len(covered):
            return found
        places = np.moveaxis(np.indices(pixels.shape[:2])[::-1], 0, 2) / STEPS
        from_middles = np.abs(places[:, :, None] - covered).max(axis=3).min(axis=2)
        rest = _largest(self._inside(pixels) & (from_middles > 0.5))
        if rest is None or _area(rest) < LEAST_LEFT * _area(part):
            return None
        found = self._fitted(image, marker, pixels, rest)
        if found is None or len(self._prints.covered(image, marker, found.corners_px, rest)):
            return None
        return found

    def _fitted(
        self, image: NDArray[np.uint8], marker: Marker, pixels: FloatArray, part: FloatArray
    ) -> Detection | None:
        quad = _quad(pixels, part)
        side_px = float(sides_px(quad[None])[0])
        cell_px = side_px / math.sqrt(_area(part))
        if cell_px < CELL_PX:
            return None
        coarse, fine = max(1, int(cell_px / FITTED_CELL_PX)), max(1, int(side_px / FITTED_SIDE_PX))
        fit = self._laid(image, marker, quad, part, coarse)
        if fit is not None and fine < coarse:
            fit = self._laid(image, marker, fit.corners[0], part, fine) or fit
        if fit is None:
            return None
        corners, covariance = fit.corners[0], fit.covariance_px2[0]
        # what shows an edge alone, or nothing, leaves no covariance that can be relied on
        if not 0.0 < float(np.trace(covariance)) < len(covariance) * (LOOSE_CELLS * cell_px) ** 2:
            return None
        if self._prints.likeness(image, marker, corners, part) < LIKENESS:
            return None
        d = Detection(marker, _corners_pad_m(marker, part), corners, cell_px * marker.cells)
        blur_px = float(fit.blur_px[0])
        return by_print(d, corners, covariance, blur_px, self._lens.encoding_error, self._dot_m)

    def _laid(
        self, image: NDArray[np.uint8], marker: Marker, quad: FloatArray, part: FloatArray, shrink: int
    ) -> PrintFit | None:
        """The print as it lies in an image that is shrunk, from corners (4, 2) px."""
        margin = FOUND_FROM_CELLS * float(sides_px(quad[None])[0]) / math.sqrt(_area(part))
        left, top = np.maximum(quad.min(axis=0) - margin, 0.0).astype(int).tolist()
        right, bottom = (quad.max(axis=0) + margin + 1.0).astype(int).tolist()
        # a pixel that shows black and white is as bright as both together in light, not in grey values
        seen = np.asarray(cv2.LUT(image[top:bottom, left:right], self._linear), np.uint8)
        if shrink > 1:
            size = (seen.shape[1] // shrink, seen.shape[0] // shrink)
            seen = seen[: size[1] * shrink, : size[0] * shrink]
            shrunk = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
            seen = np.asarray(cv2.GaussianBlur(shrunk, (0, 0), SMOOTHED_PX), np.uint8)
        origin, focal = np.array([left, top], dtype=np.float64), self._lens.focal_px / shrink

        def straightened(shrunk: FloatArray) -> FloatArray:
            return focal * self._lens.undistort((shrunk + 0.5) * shrink - 0.5 + origin)

        start = (quad - origin + 0.5) / shrink - 0.5
        fit = fit_prints(seen, PROPORTIONAL, [marker], start[None], part[None], straightened)
        rays = fit.corners[0] / focal
        corners, _ = self._lens.project(np.column_stack((rays, np.ones(4))))
        if not np.isfinite(fit.covariance_px2[0]).all() or not np.isfinite(corners).all():
            return None
        covariance = _turned(fit.covariance_px2[0], self._lens.slopes(rays) / focal)
        return PrintFit(corners[None], covariance[None], shrink * fit.blur_px)


def _turned(covariance: FloatArray, slopes: FloatArray) -> FloatArray:
    """The covariance (8, 8) of four places in other axes, which move with theirs by slopes (4, 2, 2)."""
    both = np.zeros((4, 2, 4, 2))
    both[np.arange(4), :, np.arange(4)] = slopes
    turn = both.reshape(8, 8)
    return np.asarray(turn @ covariance @ turn.T)


def _largest(inside: NDArray[np.bool_]) -> FloatArray | None:
    """The largest rectangle of a grid (n, n) that is `inside`, not too narrow: (2, 2) in cells, or None."""
    if not inside.any():
        return None
    low, high = np.triu_indices(len(inside), 1)
    size = np.where(high - low >= LEAST_ACROSS_CELLS * STEPS, high - low, 0)
    # how many places are not inside, above and to the left of each
    outside = np.pad((~inside).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    rows = outside[high + 1] - outside[low]
    area = np.outer(size, size) * (rows[:, high + 1] == rows[:, low])
    best = np.unravel_index(int(area.argmax()), area.shape)
    if area[best] == 0:
        return None
    (top, bottom), (left, right) = ((int(low[k]), int(high[k])) for k in best)
    return np.array([(left, top), (right, bottom)]) / STEPS


def _quad(pixels: FloatArray, part: FloatArray) -> FloatArray:
    """Corners (4, 2) px of a part of a marker whose grid lies there (n, n, 2)."""
    (left, top), (right, bottom) = np.rint(STEPS * part).astype(int).tolist()
    return pixels[(top, top, bottom, bottom), (left, right, right, left)]


def _area(part: FloatArray) -> float:
    """Of a rectangle (2, 2) from its first to its last corner: cells squared."""
    return float(np.prod(part[1] - part[0]))


def _grid(marker: Marker) -> FloatArray:
    """Where whole and half cells of a marker meet on the pad (m): rows (down its code), columns, 3."""
    places = np.arange(STEPS * marker.cells + 1) / STEPS
    right, down = np.meshgrid(places, places)
    return _on_pad(marker, np.stack((right, down), axis=2))


def _corners_pad_m(marker: Marker, part: FloatArray) -> FloatArray:
    """Corners (4, 3) on the pad (m) of a part of a marker."""
    (left, top), (right, bottom) = part
    return _on_pad(marker, np.array([(left, top), (right, top), (right, bottom), (left, bottom)]))


def _on_pad(marker: Marker, places: FloatArray) -> FloatArray:
    """Places (..., 2) in cells, from the top-left corner to the right and down, on the pad (..., 3) (m)."""
    top_left, top_right, _, bottom_left = marker.corners_pad_m()
    axes = np.stack((top_right - top_left, bottom_left - top_left)) / marker.cells
    return np.asarray(top_left + places @ axes)
