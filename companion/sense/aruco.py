"""Finds the pad's markers in an image: the one file that knows OpenCV's ArUco interface.

Shapes and names are those of OpenCV 5.0 (ids are (n,), corners a tuple of (1, 4, 2)). Dictionaries are
cut to the ids that are printed on the pad, and few bit errors are forgiven: that is faster, and a
pattern on the ground is not taken for a marker.

Corners are pixels (u right, v down), whole numbers at pixel centres, in OpenCV's order: top-left,
top-right, bottom-right, bottom-left of the printed code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.config import VisionConfig
from companion.geometry import FloatArray
from companion.messages import MarkerGroup
from companion.pad import DICTIONARIES, DictionaryName, Marker, Pad

GROUPS: Final[tuple[MarkerGroup, ...]] = ("F", "M", "C")
ERROR_CORRECTION_RATE: Final = 0.5
THRESHOLD_WINDOW_PX: Final = 11
# a marker smaller than this in a shrunk image gives corners too coarse to refine in the full one
SHRUNK_SIDE_PX: Final = 17.0
# corner refinement looks this far, in cells of the code, within these bounds in pixels
REFINE_CELLS: Final = 0.5
REFINE_PX: Final = (2, 10)
REFINE_CRITERIA: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.01)


@dataclass(frozen=True, slots=True)
class SearchPass:
    """One look: which part of the image, shrunk how many times, for which groups of markers."""

    left: int
    top: int
    right: int
    bottom: int
    shrink: int
    groups: tuple[MarkerGroup, ...]


@dataclass(frozen=True, slots=True)
class Detection:
    """One marker that was read: corners (4, 3) on the pad (m), and (4, 2) in pixels of the whole image."""

    marker: Marker
    corners_pad_m: FloatArray
    corners_px: FloatArray
    side_px: float


class PadDetector:
    """Reads the markers of one pad. It keeps no memory of earlier frames."""

    def __init__(self, pad: Pad, config: VisionConfig) -> None:
        self._pad = pad
        self._config = config
        self._readers: dict[tuple[MarkerGroup, ...], _Reader] = {}

    def detect(self, image: NDArray[np.uint8], where: SearchPass) -> list[Detection]:
        """Read the markers in one part of an image.

        Of more than `maximum_markers` those that lie farthest apart are kept. Returned in the order of
        the pad's markers.
        """
        reader = self._readers.get(where.groups)
        if reader is None:
            reader = self._readers[where.groups] = _Reader(self._pad, where.groups)
        part = image[where.top : where.bottom, where.left : where.right]
        s = where.shrink
        if s > 1:
            size = (part.shape[1] // s, part.shape[0] // s)
            part = part[: size[1] * s, : size[0] * s]
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        smallest_px = max(self._config.minimum_side_px, SHRUNK_SIDE_PX if s > 1 else 0.0)
        origin = np.array([where.left, where.top], dtype=np.float64)
        found = [
            Detection(marker, on_pad, (corners + 0.5) * s - 0.5 + origin, _side_px(corners) * s)
            for marker, on_pad, corners in reader.read(part, smallest_px)
        ]
        return refine_corners(image, farthest_apart(found, self._config.maximum_markers))


class _Reader:
    """OpenCV's detector for some groups of the pad's markers."""

    def __init__(self, pad: Pad, groups: tuple[MarkerGroup, ...]) -> None:
        self._markers = [(m, m.corners_pad_m()) for m in pad.markers if m.group in groups]
        names = sorted({m.dictionary for m, _ in self._markers})
        self._order = {(names.index(m.dictionary), m.id): k for k, (m, _) in enumerate(self._markers)}
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.adaptiveThreshWinSizeMin = THRESHOLD_WINDOW_PX
        self._parameters.adaptiveThreshWinSizeMax = THRESHOLD_WINDOW_PX
        self._parameters.errorCorrectionRate = ERROR_CORRECTION_RATE
        last = {name: max(m.id for m, _ in self._markers if m.dictionary == name) for name in names}
        dictionaries = [_cut_dictionary(name, last[name]) for name in names]
        self._detector = cv2.aruco.ArucoDetector(dictionaries, self._parameters) if dictionaries else None

    def read(
        self, image: NDArray[np.uint8], minimum_side_px: float
    ) -> list[tuple[Marker, FloatArray, FloatArray]]:
        """Markers, each at most once, in the pad's order, with their corners on the pad and in the image."""
        if self._detector is None or min(image.shape) < minimum_side_px:
            return []
        # OpenCV counts an outline's pixels: a square that stands on its corner has sqrt(2) times fewer
        self._parameters.minMarkerPerimeterRate = 2.0 * math.sqrt(2.0) * minimum_side_px / max(image.shape)
        self._detector.setDetectorParameters(self._parameters)
        quads, ids, _, which = self._detector.detectMarkersMultiDict(image)
        found: dict[int, FloatArray] = {}
        twice: set[int] = set()
        for quad, identity, dictionary in zip(quads, _flat(ids), _flat(which), strict=True):
            order = self._order.get((dictionary, identity))
            corners = np.asarray(quad, dtype=np.float64).reshape(4, 2)
            if order is None or _side_px(corners) < minimum_side_px:
                continue
            if order in found:
                twice.add(order)
            found[order] = corners
        # a code seen at two places is a reflection or a forgery: neither is believed
        return [(*self._markers[k], found[k]) for k in sorted(found) if k not in twice]


def refine_corners(image: NDArray[np.uint8], found: list[Detection]) -> list[Detection]:
    """Move the corners to sub-pixel places, in a window that suits the size of each marker's cells."""
    refined = list(found)
    windows = [round(REFINE_CELLS * d.side_px / cells_across(d.marker)) for d in found]
    windows = [min(max(w, REFINE_PX[0]), REFINE_PX[1]) for w in windows]
    for window in sorted(set(windows)):
        which = [k for k, w in enumerate(windows) if w == window]
        corners = np.concatenate([found[k].corners_px for k in which]).astype(np.float32).reshape(-1, 1, 2)
        cv2.cornerSubPix(image, corners, (window, window), (-1, -1), REFINE_CRITERIA)
        for k, quad in zip(which, corners.astype(np.float64).reshape(-1, 4, 2), strict=True):
            refined[k] = replace(found[k], corners_px=quad)
    return refined


def farthest_apart(found: list[Detection], maximum: int) -> list[Detection]:
    """At most `maximum` of the detections, spread over the image; the order is kept."""
    if len(found) <= maximum:
        return found
    centres = np.array([d.corners_px.mean(axis=0) for d in found])
    chosen = [int(np.argmax(np.sum((centres - centres.mean(axis=0)) ** 2, axis=1)))]
    distance = np.sum((centres - centres[chosen[0]]) ** 2, axis=1)
    while len(chosen) < maximum:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.sum((centres - centres[chosen[-1]]) ** 2, axis=1))
    return [found[k] for k in sorted(chosen)]


def cells_across(marker: Marker) -> int:
    """Cells along a marker's side, the black border included."""
    return int(marker.dictionary[0]) + 2


def _side_px(corners: FloatArray) -> float:
    """Mean length of the two diagonals over sqrt(2)."""
    (a, b), (c, d), (e, f), (g, h) = corners.tolist()
    return 0.5 * math.sqrt(0.5) * (math.hypot(e - a, f - b) + math.hypot(g - c, h - d))


def _cut_dictionary(name: DictionaryName, last_id: int) -> cv2.aruco.Dictionary:
    full = cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])
    return cv2.aruco.Dictionary(full.bytesList[: last_id + 1], full.markerSize, full.maxCorrectionBits)


def _flat(values: Any) -> list[int]:
    """Whole numbers from (n,), (n, 1) or nothing: OpenCV has returned each of them."""
    return [] if values is None else [int(v) for v in np.asarray(values).reshape(-1)]
