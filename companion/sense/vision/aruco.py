"""Finds the pad's markers in an image: the one file that uses OpenCV's ArUco interface.

Shapes and names are those of OpenCV 5.0 (ids are (n,), corners a tuple of (1, 4, 2)). Dictionaries hold
no more than the codes that are looked for, and few bit errors are forgiven: that is faster (a square is
compared with one code after another, 6 us each), and a pattern on the ground is not taken for a marker.

Corners are pixels (u right, v down), whole numbers at pixel centres, in OpenCV's order: top-left,
top-right, bottom-right, bottom-left of the printed code.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import VisionConfig
from companion.pad import ERROR_CORRECTION_RATE, Marker, Pad, dictionary_named
from companion.sense.vision.corners import ENCODED, refine_quads
from companion.sense.vision.edges import normals, outwards
from companion.sense.vision.lens import Lens
from companion.sense.vision.print_fit import fit_prints

GROUPS: Final[tuple[MarkerGroup, ...]] = ("F", "M", "C")
THRESHOLD_WINDOW_PX: Final = 11
# a cell is told by its middle, where its neighbours' blur reaches least: of so many places across it by all
# but the outermost. Those are an odd number: a cell whose edges show its neighbours is never half white
CELL_SAMPLES: Final = 5
# an outline on the outermost pixels is cut off; OpenCV's usual 3 px of a shrunk image are up to 18 px in full
BORDER_PX: Final = 1
# a code's side less its outline's, which runs through the middles of its outermost pixels
OUTLINE_PX: Final = 1.0
# corners of a contour, where a marker's sides cannot be followed: pixels of the image that was searched
CONTOUR_STD_PX: Final = 0.7
# of the variance at a side's ends, when it is a straight line through places that err independently
STRAIGHT_SHARE: Final = 0.25
# of a dot, by which an edge is printed off: anything up to half of one
DOT_STD: Final = 1.0 / math.sqrt(12.0)
# cells of fewer pixels run together by a usual lens's blur: a marker of such is measured by its whole print
SMALL_CELL_PX: Final = 4.0
# so many markers are enough, if they lie apart: of fewer, one that errs is not shown by the others
ENOUGH: Final = 4


@dataclass(frozen=True, slots=True)
class SearchPass:
    """One look: which part of the image, shrunk or enlarged how many times, for which groups of markers."""

    left: int
    top: int
    right: int
    bottom: int
    shrink: int
    groups: tuple[MarkerGroup, ...]
    enlarge: int = 1


@dataclass(frozen=True, slots=True)
class Detection:
    """One marker that was read: corners (4, 3) on the pad (m), and (4, 2) in pixels of the whole image.

    `corner_std_px` is the standard deviation of each corner in each direction, as far as its sides show, and
    `offset_share` the share of its square by which a side errs as a whole, and not by being turned;
    `shrunk_std_px` those of how far its sides lie too far in, alike for all markers of a frame, by exposure,
    encoding and print. A marker that was measured by its whole print has the corners' covariance (8, 8) px2,
    u and v of each in turn, in place of these two. One whose sides could not be followed is not `refined`:
    its corners are its contour's.
    """

    marker: Marker
    corners_pad_m: FloatArray
    corners_px: FloatArray
    side_px: float
    corner_std_px: float = 0.0
    offset_share: float = STRAIGHT_SHARE
    shrunk_std_px: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    refined: bool = False
    covariance_px2: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Code:
    """A printed code: its place in the reader's list, and corners (4, 2) px."""

    number: int
    corners_px: FloatArray


class PadDetector:
    """Reads the markers of one pad. It keeps no memory of earlier frames."""

    def __init__(self, pad: Pad, config: VisionConfig, lens: Lens) -> None:
        self._pad = pad
        self._config = config
        self._lens = lens
        self._readers: dict[tuple[MarkerGroup, ...], _Reader] = {}

    def detect(self, image: NDArray[np.uint8], where: SearchPass) -> list[Detection]:
        """The markers in one part of an image, their corners refined where they can be."""
        return self.refine(image, self.read(image, where))

    def refine(self, image: NDArray[np.uint8], found: list[Detection]) -> list[Detection]:
        """Markers that were read in an image, with better corners; see `refine_corners`."""
        return refine_corners(image, found, self._lens, self._pad.sheet.dot_m)

    def read(self, image: NDArray[np.uint8], where: SearchPass) -> list[Detection]:
        """Read the markers in one part of an image; their corners are their contours'.

        Of more than `maximum_markers` those that lie farthest apart are kept. Returned in the order of
        the pad's markers.
        """
        markers, corners_m, reader = self._reader(where.groups)
        part = image[where.top : where.bottom, where.left : where.right]
        s = where.shrink
        if s > 1:
            size = (part.shape[1] // s, part.shape[0] // s)
            part = part[: size[1] * s, : size[0] * s]
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        part = np.asarray(cv2.LUT(part, self._lens.legible), dtype=np.uint8)
        if where.enlarge > 1:
            size = (part.shape[1] * where.enlarge, part.shape[0] * where.enlarge)
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        scale = s / where.enlarge
        smallest_px = self._config.minimum_side_px / min(scale, 1.0)
        origin = np.array([where.left, where.top], dtype=np.float64)
        codes = _printed_once(reader.read(part, smallest_px))
        if not codes:
            return []
        outlines = np.array([code.corners_px for code in codes])
        quads = (_outlined(outlines) + 0.5) * scale - 0.5 + origin
        found = [
            Detection(markers[code.number], corners_m[code.number], quad, side, CONTOUR_STD_PX * scale)
            for code, quad, side in zip(codes, quads, sides_px(quads).tolist(), strict=True)
        ]
        return farthest_apart(found, self._config.maximum_markers)

    def _reader(self, groups: tuple[MarkerGroup, ...]) -> _Reader:
        made = self._readers.get(groups)
        if made is None:
            markers = tuple(m for m in self._pad.markers if m.group in groups)
            names = sorted({m.dictionary for m in markers})
            dictionaries = [dictionary_named(name) for name in names]
            reader = CodeReader(dictionaries, [(names.index(m.dictionary), m.id) for m in markers])
            corners_m = np.array([m.corners_pad_m() for m in markers])
            made = self._readers[groups] = (markers, corners_m, reader)
        return made


# markers, their corners (n, 4, 3) on the pad (m), and what reads them
_Reader = tuple[tuple[Marker, ...], FloatArray, "CodeReader"]


class CodeReader:
    """Reads a list of codes, of any dictionaries, wherever they are in an image.

    `codes` are pairs: which of the dictionaries, and the id in it.
    """

    def __init__(
        self, dictionaries: Sequence[cv2.aruco.Dictionary], codes: Sequence[tuple[int, int]]
    ) -> None:
        self._order = {code: number for number, code in enumerate(codes)}
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.adaptiveThreshWinSizeMin = THRESHOLD_WINDOW_PX
        self._parameters.adaptiveThreshWinSizeMax = THRESHOLD_WINDOW_PX
        self._parameters.errorCorrectionRate = ERROR_CORRECTION_RATE
        self._parameters.perspectiveRemovePixelPerCell = CELL_SAMPLES
        self._parameters.perspectiveRemoveIgnoredMarginPerCell = 1.0 / CELL_SAMPLES
        self._parameters.minDistanceToBorder = BORDER_PX
        # of each dictionary the ids of the list, in rows that OpenCV counts anew
        self._ids = [sorted({i for which, i in codes if which == k}) for k in range(len(dictionaries))]
        cut = [
            cv2.aruco.Dictionary(full.bytesList[ids], full.markerSize, full.maxCorrectionBits)
            for full, ids in zip(dictionaries, self._ids, strict=True)
        ]
        self._detector = cv2.aruco.ArucoDetector(cut, self._parameters) if codes else None

    def read(self, image: NDArray[np.uint8], minimum_side_px: float) -> list[Code]:
        """All sightings of codes, in the list's order, with the corners of their contours.

        `minimum_side_px` is a code's; its outline, through the middles of its outermost pixels, is one less.
        """
        if self._detector is None or min(image.shape) < minimum_side_px:
            return []
        outline_px = minimum_side_px - OUTLINE_PX
        # OpenCV counts an outline's pixels: a square that stands on its corner has sqrt(2) times fewer
        self._parameters.minMarkerPerimeterRate = 2.0 * math.sqrt(2.0) * outline_px / max(image.shape)
        self._detector.setDetectorParameters(self._parameters)
        quads, ids, _, which = self._detector.detectMarkersMultiDict(image)
        if not quads:
            return []
        outlines = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)
        rows = zip(_flat(which), _flat(ids), strict=True)
        numbers = [self._order[k, self._ids[k][row]] for k, row in rows]
        large = (sides_px(outlines) >= outline_px).tolist()
        found = [
            Code(number, corners)
            for number, corners, enough in zip(numbers, outlines, large, strict=True)
            if enough
        ]
        return sorted(found, key=lambda code: code.number)


def _printed_once(codes: list[Code]) -> list[Code]:
    """As a pad has them: of a code at two places one is a reflection or a forgery, and neither is trusted."""
    seen = Counter(code.number for code in codes)
    return [code for code in codes if seen[code.number] == 1]


def refine_corners(
    image: NDArray[np.uint8], found: list[Detection], lens: Lens, dot_m: float
) -> list[Detection]:
    """The detections with their corners where each marker's sides meet; those alone, where there are any.

    Markers of small cells by their whole print, as far as others are not enough. `dot_m`: a dot of the print.
    Each edge is printed up to half a dot off, and ink runs about as far.
    """
    small = [d for d in found if d.side_px < SMALL_CELL_PX * d.marker.cells]
    large = [d for d in found if d.side_px >= SMALL_CELL_PX * d.marker.cells]
    made = _by_sides(image, large, lens, dot_m) if large else {}
    more = ENOUGH - len(made)
    small = farthest_apart(small, more, list(made.values())) if more > 0 else []
    prints = _by_prints(image, small, lens, dot_m) if small else {}
    unfit = [d for d in small if d.marker not in prints]
    made |= prints | (_by_sides(image, unfit, lens, dot_m) if unfit else {})
    return [made[d.marker] for d in found if d.marker in made] or found


def _by_prints(
    image: NDArray[np.uint8], found: list[Detection], lens: Lens, dot_m: float
) -> dict[Marker, Detection]:
    """Those of the detections whose print was found, by markers."""
    quads = np.array([d.corners_px for d in found])
    fits = fit_prints(image, lens.light, [d.marker for d in found], quads)
    made = {}
    for d, quad, shown, blur_px in zip(found, *fits, strict=True):
        if not math.isfinite(shown[0, 0]):
            continue
        made[d.marker] = by_print(d, quad, shown, float(blur_px), lens.encoding_error, dot_m)
    return made


def by_print(
    d: Detection, quad: FloatArray, shown: FloatArray, blur_px: float, encoding_error: float, dot_m: float
) -> Detection:
    """A detection with corners (4, 2) that its print has shown, and their covariance by that (8, 8) px2."""
    off_px = DOT_STD * dot_m * d.side_px / d.marker.side_m
    sides = sides_to_corners(quad)
    covariance = shown + off_px**2 * (sides @ sides.T)
    return replace(
        d,
        corners_px=quad,
        corner_std_px=math.sqrt(np.trace(covariance) / len(covariance)),
        shrunk_std_px=(math.hypot(ENCODED * encoding_error * blur_px, off_px),) * 4,
        refined=True,
        covariance_px2=covariance,
    )


def _by_sides(
    image: NDArray[np.uint8], found: list[Detection], lens: Lens, dot_m: float
) -> dict[Marker, Detection]:
    """Those of the detections whose sides could be followed, by markers."""
    quads, cells = np.array([d.corners_px for d in found]), np.array([d.marker.cells for d in found])
    refined = refine_quads(image, quads, cells, lens.bows(quads), lens.light, lens.encoding_error)
    made = {}
    parts = (part.tolist() for part in refined[1:])
    for d, quad, offset, turn, shrunk, crowded in zip(found, refined.corners, *parts, strict=True):
        if not math.isfinite(offset):
            continue
        off_px = DOT_STD * dot_m * d.side_px / d.marker.side_m
        off = math.hypot(offset, crowded, off_px)
        std = math.hypot(off, turn)
        share, shrunk_px = (off / max(std, 1e-6)) ** 2, tuple([math.hypot(by, off_px) for by in shrunk])
        made[d.marker] = Detection(d.marker, d.corners_pad_m, quad, d.side_px, std, share, shrunk_px, True)
    return made


def farthest_apart(found: list[Detection], maximum: int, beside: Sequence[Detection] = ()) -> list[Detection]:
    """At most `maximum` of the detections, spread over the image beside others; the order is kept."""
    if len(found) <= maximum:
        return found
    centres = np.array([d.corners_px for d in found]).sum(axis=1)
    apart = ((centres[:, None] - centres) ** 2).sum(axis=2)
    if beside:
        others = np.array([d.corners_px for d in beside]).sum(axis=1)
        distance = ((centres[:, None] - others) ** 2).sum(axis=2).min(axis=1)
    else:
        distance = apart.sum(axis=1)
    chosen: list[int] = []
    for _ in range(maximum):
        chosen.append(int(distance.argmax()))
        nearest = apart[chosen[-1]]
        distance = np.minimum(distance, nearest) if beside or len(chosen) > 1 else nearest
    return [found[k] for k in sorted(chosen)]


def sides_px(quads: FloatArray) -> FloatArray:
    """Mean length (n,) of the two diagonals of quads (n, 4, 2), over sqrt(2)."""
    across = quads[:, 2:] - quads[:, :2]
    return np.asarray(math.sqrt(0.5) * (0.5 * np.hypot(across[..., 0], across[..., 1]).sum(axis=1)))


def _outlined(quads: FloatArray) -> FloatArray:
    """Corners (n, 4, 2) of squares by their outlines', which run through the middles of their outermost
    pixels.
    """
    return quads + outwards(normals(quads), 0.5 * OUTLINE_PX)


def sides_to_corners(corners: FloatArray) -> FloatArray:
    """How corners (4, 2) move, u and v of each in turn, when each side moves outwards by one: (8, 4)."""
    moves = outwards(np.repeat(normals(corners[None]), 4, axis=0), np.eye(4))
    return moves.reshape(4, 8).T


def _flat(values: Any) -> list[int]:
    """Whole numbers from (n,), (n, 1) or nothing: OpenCV has returned each of them."""
    return [] if values is None else [int(v) for v in np.asarray(values).reshape(-1)]
