"""Whether a pose that one marker alone gives is borne out by the rest of the pad's print.

Among enough squares one has the code of a marker by chance, and a single marker fits any pose. Where it lies
says where the other markers' cells have to be in the image, and how black or white: a pad shows at least one
of them, though it may be too blurred, dirty or dazzling to be read; clutter does not.

Pixels: u right, v down. Pad frame: metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import ERROR_CORRECTION_RATE, Marker, Pad, dictionary_named
from companion.sense.vision.aruco import SMALL_CELL_PX, Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import PoseFit
from companion.sense.vision.print_fit import white_cells

# correlation of brightness and print over a marker's cells
LIKENESS: Final = 0.5
# markers whose cells are smaller in the image cannot be distinguished
CELL_PX: Final = 2.0


class PrintCheck:
    """Knows the print of one pad, cell by cell."""

    def __init__(self, pad: Pad, lens: Lens) -> None:
        self._lens = lens
        self._prints = {marker: _cells(marker) for marker in pad.markers}
        self._bare = {marker: _bare(marker, pad) for marker in pad.markers}

    def bears_out(self, image: NDArray[np.uint8], pose: PoseFit, read: Sequence[Detection] = ()) -> bool:
        """Whether another marker is where the pose has it, or none is to be seen there.

        One that was `read` there is another, though its corners may be too near to the picture's edge.
        """
        used = {detection.marker for detection in pose.used}
        if any(self._is_about(pose, detection) for detection in read if detection.marker not in used):
            return True
        others = [marker for marker in self._prints if marker not in used]
        likenesses = [
            likeness for marker in others if (likeness := self._likeness(image, pose, marker)) is not None
        ]
        return not likenesses or max(likenesses) >= LIKENESS

    def _is_about(self, pose: PoseFit, seen: Detection) -> bool:
        """Whether a marker was seen nearer than half of its side to where the pose has it."""
        middle = seen.corners_pad_m.mean(axis=0, keepdims=True)
        there, _ = self._lens.project(middle @ pose.camera_from_pad.T + pose.position_camera_m)
        return bool(np.hypot(*(there[0] - seen.corners_px.mean(axis=0))) < 0.5 * seen.side_px)

    def likeness(
        self,
        image: NDArray[np.uint8],
        marker: Marker,
        corners_px: FloatArray,
        part: FloatArray | None = None,
    ) -> float:
        """Correlation of a marker's print with the image between its corners (4, 2) px.

        Of a `part` (2, 2) of it, from a first to a last corner in cells, the corners are the part's.
        """
        _, white = self._prints[marker]
        if part is None:
            middles = _middles(marker).reshape(-1, 2)
            return self._alike(image, _pixels_at(middles, corners_px, _whole(marker)), white)
        inside, grey = _seen(image, marker, corners_px, part)
        return _correlation(grey, white[inside]) if len(grey) else 0.0

    def wrong_cells(self, image: NDArray[np.uint8], found: Detection) -> int:
        """How many cells of a marker that was read are not of their colour; 0 where cells run together."""
        if found.side_px < SMALL_CELL_PX * found.marker.cells:
            return 0
        return len(self.covered(image, found.marker, found.corners_px, _whole(found.marker)))

    def covered(
        self, image: NDArray[np.uint8], marker: Marker, corners_px: FloatArray, part: FloatArray
    ) -> FloatArray:
        """Middles (k, 2), in cells, of those cells of a part that are not of their colour."""
        _, white = self._prints[marker]
        inside, grey = _seen(image, marker, corners_px, part)
        bare = self._bare[marker][inside]
        expected = white[inside] > 0.5
        if expected.all() or not expected.any():
            return np.empty((0, 2))
        between = 0.5 * (np.median(grey[expected]) + np.median(grey[~expected]))
        return np.asarray(_middles(marker)[inside][bare & ((grey > between) != expected)])

    def _likeness(self, image: NDArray[np.uint8], pose: PoseFit, marker: Marker) -> float | None:
        """The same where a pose has it; None where it is cut off or too small."""
        points, white = self._prints[marker]
        pixels, _ = self._lens.project(points @ pose.camera_from_pad.T + pose.position_camera_m)
        width, height = self._lens.size_px
        inside = (pixels > 0.0).all() and (pixels < (width - 1, height - 1)).all()
        if not inside or float(np.linalg.norm(pixels[1] - pixels[0])) < CELL_PX:
            return None
        return self._alike(image, pixels, white)

    def _alike(self, image: NDArray[np.uint8], pixels: FloatArray, white: FloatArray) -> float:
        grey = _grey(image, pixels).reshape(white.shape)
        # any marker's black frame is like another's: the code has to be like by itself, too
        return min(_correlation(grey, white), _correlation(grey[2:-2, 2:-2], white[2:-2, 2:-2]))


def correctable(marker: Marker) -> int:
    """How many wrong cells of its code a marker is read with."""
    return int(ERROR_CORRECTION_RATE * dictionary_named(marker.dictionary).maxCorrectionBits)


def _bare(marker: Marker, pad: Pad) -> NDArray[np.bool_]:
    """On which of a marker's cells, and of those about it, no smaller marker of the pad lies."""
    bare = np.ones((marker.cells + 2, marker.cells + 2), np.bool_)
    for other in pad.markers:
        if other.side_m < marker.side_m and (under := marker.cells_under(other)) is not None:
            bare[1:-1, 1:-1][under] = False
    return bare


def _whole(marker: Marker) -> FloatArray:
    """The first and the last corner (2, 2), in cells, of all of a marker."""
    return np.array([(0.0, 0.0), (marker.cells, marker.cells)])


def _middles(marker: Marker) -> FloatArray:
    """Of a marker's cells, a row of the white around it included: rows, columns, and right and down."""
    middles = np.arange(-1, marker.cells + 1) + 0.5
    down, right = np.meshgrid(middles, middles, indexing="ij")
    return np.stack((right, down), axis=-1)


def _seen(
    image: NDArray[np.uint8], marker: Marker, corners_px: FloatArray, part: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which cells' middles lie in a part, of rows and columns, and how bright they (n,) are."""
    middles = _middles(marker)
    inside = ((middles > part[0]) & (middles < part[1])).all(axis=2)
    if not inside.any():
        return inside, np.empty(0)
    return inside, _grey(image, _pixels_at(middles[inside], corners_px, part))


def _pixels_at(places: FloatArray, corners_px: FloatArray, part: FloatArray) -> FloatArray:
    """Where places (n, 2), in cells, are in the image (n, 2), by a part's corners (4, 2) px."""
    (left, top), (right, bottom) = part.tolist()
    square = np.array([(left, top), (right, top), (right, bottom), (left, bottom)], np.float32)
    across = cv2.getPerspectiveTransform(square, corners_px.astype(np.float32))
    return np.asarray(cv2.perspectiveTransform(places[None], across)[0])


def _grey(image: NDArray[np.uint8], pixels: FloatArray) -> FloatArray:
    """Brightness (n,) at places (n, 2) px."""
    u, v = pixels.astype(np.float32).T
    seen = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float64).reshape(-1)


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Of two pictures of the same size: -1..1."""
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9))


def _cells(marker: Marker) -> tuple[FloatArray, FloatArray]:
    """Middles of a marker's cells on the pad (k * k, 3), a row of the white around it included; and how white
    they are (k, k).
    """
    count = marker.cells
    white = white_cells(marker)
    top_left, top_right, _, bottom_left = marker.corners_pad_m()
    share = (np.arange(-1, count + 1) + 0.5) / count
    down, right = np.meshgrid(share, share, indexing="ij")
    middles = (
        top_left
        + right.reshape(-1, 1) * (top_right - top_left)
        + down.reshape(-1, 1) * (bottom_left - top_left)
    )
    return middles, white
