"""Where a marker's sides cross their normals: brightness along many of them, in light.

Along each normal the brightness goes from black to white, and the centre of its rise is the side's place. A
blur that is the same to both hands does not move it, in light; in grey values, which are not proportional to
light, it would lie 0.2 to 0.3 px too far in the white.

Pixels: u right, v down, whole numbers at pixel centres. Side k of a marker runs from corner k to the next.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray

NORMALS: Final = 12  # along each side
TAPS: Final = 13  # along each normal
# what falls by less from tap to tap, as a share of its marker's contrast, is noise
NOISE_SHARE: Final = 0.05
# white that is brighter is cut off
FULL_GREY: Final = 250
# the least share of an edge's way that is trusted to be seen through the window
LEAST_GAIN: Final = 0.4

ComplexArray = NDArray[np.complex128]

PROPORTIONAL: Final = np.arange(256, dtype=np.float32)

PLACES: Final = np.linspace(-1.0, 1.0, NORMALS)
_TAPS: Final = np.linspace(-1.0, 1.0, TAPS, dtype=np.float32)
# where a side's samples are, tap by tap, from its middle: in terms of 1, the half of it that is looked at,
# and the reach
_SAMPLES: Final[FloatArray] = np.stack(
    (np.ones(TAPS * NORMALS), np.tile(PLACES, TAPS), np.repeat(_TAPS, NORMALS)), axis=1
)
_BETWEEN: Final = 0.5 * (_TAPS[1:] + _TAPS[:-1])
_WINDOW: Final = 1.0 - _BETWEEN**4
# what a normal's differences are summed with: their weight, mean and mean square (3, 12)
_MOMENTS: Final = np.stack((_WINDOW, _WINDOW * _BETWEEN, _WINDOW * _BETWEEN**2))
# of four corners or sides the one after each, and the one before
NEXT: Final = np.array((1, 2, 3, 0))
BEFORE: Final = np.array((3, 0, 1, 2))
# where a rectangle's left, top, right and bottom edge go when it grows
_OUTWARDS: Final = np.array((-1.0, -1.0, 1.0, 1.0))


def _gains() -> tuple[FloatArray, FloatArray]:
    """How wide an edge near the window's middle seems, and by which share of its way a moved one does.

    The window draws the centre of a rise towards its own middle, the more the wider the rise is. By Gaussian
    rises of each width, in terms of the reach, half a tap's distance to either hand of the middle: the mean
    over a tap's distance is 1 for a step, wherever between two taps it is.
    """
    step = 1.0 / (TAPS - 1)
    widths, gains = [], []
    for sigma in np.linspace(0.01, 1.5, 150):
        below = np.array(
            [[math.erf((tap - at) / sigma / math.sqrt(2.0)) for tap in _TAPS] for at in (0.0, step)]
        )
        weight, mean, square = _MOMENTS @ np.diff(below, axis=1).T
        widths.append(math.sqrt(float(np.mean(square / weight - (mean / weight) ** 2))))
        gains.append(float(mean[1] / weight[1]) / step)
    return np.array(widths), np.array(gains)


_WIDTHS, _GAINS = _gains()


class Sides(NamedTuple):
    """Straight sides (m, 4) of markers; places, directions and outward normals are u + iv."""

    start: ComplexArray
    along: ComplexArray
    normal: ComplexArray
    length: FloatArray
    span: FloatArray  # (m, 1) half the share of the side's length that is looked at, twice
    bow: FloatArray  # how far outwards the lens moves their middles, px
    bow_std: FloatArray  # of what is not known of it


class Places(NamedTuple):
    """Where sides cross their normals (m, NORMALS, 4), px outwards; contrasts alike; their blur (m, 4)."""

    offset: FloatArray
    contrast: FloatArray
    blur_px: FloatArray
    full: NDArray[np.bool_]  # (m,) whether the white is cut off


class Patches(NamedTuple):
    """The light about each of m markers, one patch below the other in one image.

    `shift` (m, 1), u + iv, is from the whole image, of that size, to there; `full` is the light of cut-off
    white, and `whole` are patches of which the picture's edge cuts nothing off.
    """

    light: NDArray[np.float32]
    shift: ComplexArray
    size_px: tuple[int, int]
    full: float
    whole: bool


def decoded(
    image: NDArray[np.uint8], quads: FloatArray, margin: FloatArray, light: NDArray[np.float32]
) -> Patches:
    """Decode what lies within so many pixels (m,) of markers: most of an image is none of theirs."""
    rows, columns = image.shape
    bounds = np.concatenate((quads.min(axis=1), quads.max(axis=1)), axis=1)
    bounds += margin[:, None] * _OUTWARDS
    parts, shift, height, width, whole = [], [], 0, 0, True
    for u, v, last_u, last_v in bounds.astype(int).tolist():
        whole &= u >= 0 and v >= 0 and last_u + 2 <= columns and last_v + 2 <= rows
        left, top = min(max(u, 0), columns - 2), min(max(v, 0), rows - 2)
        right, bottom = min(max(last_u, left) + 2, columns), min(max(last_v, top) + 2, rows)
        parts.append((image[top:bottom, left:right], height))
        shift.append(complex(-left, height - top))
        height, width = height + bottom - top, max(width, right - left)
    grey = np.zeros((height, width), np.uint8)
    for part, top in parts:
        grey[top : top + part.shape[0], : part.shape[1]] = part
    # all at once: each call of OpenCV's lets another thread have the interpreter
    seen = np.asarray(cv2.LUT(grey, light), np.float32)
    return Patches(seen, np.array(shift)[:, None], (columns, rows), float(light[FULL_GREY]), whole)


def places_along(patches: Patches, sides: Sides, reach: FloatArray) -> Places:
    """Where each normal goes from black to white: the centre of its rise, more weight near its middle."""
    m = len(reach)
    half = 0.5 * sides.length * sides.along
    ways = np.empty((m, 3, 4), np.complex128)
    np.add(sides.start + half, patches.shift, out=ways[:, 0])
    np.multiply(sides.span, half, out=ways[:, 1])
    np.multiply(reach[:, None], sides.normal, out=ways[:, 2])
    at = (_SAMPLES @ ways.view(np.float64)).astype(np.float32).reshape(-1, 4, 2)
    # one map has both u and v
    none = cast(FloatArray, None)
    seen = cv2.remap(patches.light, at, none, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    brightness = np.asarray(seen, np.float32).reshape(m, TAPS, NORMALS * 4)
    # blurred white between two edges is nowhere as bright as it is in the middle
    black, white = median(brightness[:, 0]), median(brightness.max(axis=1))
    # what falls is another edge, of the code inside or of what lies beside the marker; noise that falls stays
    # in, for without it the noise that rises moves edges to where there is more of it, into the white
    floor = -NOISE_SHARE * np.maximum(white - black, 0.0)
    rise = brightness[:, 1:] - brightness[:, :-1]
    rise *= rise >= floor[:, None, None]
    moments = (_MOMENTS @ rise).reshape(m, 3, NORMALS, 4)
    contrast = moments[:, 0]
    if not patches.whole:
        contrast = np.where(_within(at, patches), contrast, 0.0)
    mean, square = moments[:, 1:].swapaxes(0, 1) / np.maximum(contrast, 1.0)
    square -= mean * mean
    width = np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    # what moves is blurred along its way, and so are the sides across it
    blur = median(width.swapaxes(1, 2))
    gain = np.maximum(np.interp(blur, _WIDTHS, _GAINS), LEAST_GAIN)
    offset = np.maximum(np.minimum(mean / gain[:, None], 1.0), -1.0) * reach[:, None, None]
    return Places(offset, contrast, blur * reach[:, None], white >= patches.full)


def _within(at: NDArray[np.float32], patches: Patches) -> NDArray[np.bool_]:
    """Which normals, samples (m * TAPS * NORMALS, 4, 2) along them, end in the image (m, NORMALS, 4).

    Beyond, its last pixels are repeated: a rise is cut.
    """
    first = patches.shift.view(np.float64).astype(np.float32)[:, None, None, None]
    last = first + np.float32(np.array(patches.size_px) - 1)
    ends = at.reshape(len(first), TAPS, NORMALS, 4, 2)[:, :: TAPS - 1]
    return np.asarray(((ends >= first) & (ends <= last)).all(axis=(1, 4)))


def median(values: NDArray[np.floating]) -> FloatArray:
    """Along the last axis, the upper one of two: a fraction of what numpy's own costs for so few."""
    half = values.shape[-1] // 2
    return np.asarray(np.partition(values, half, axis=-1)[..., half], np.float64)


def mean_side(quads: FloatArray) -> FloatArray:
    """Mean length (m,) of the sides of quads (m, 4, 2)."""
    corners = complex_from_pixels(quads)
    return np.asarray(0.25 * np.abs(corners.take(NEXT, axis=1) - corners).sum(axis=1))


def normals(quads: FloatArray) -> ComplexArray:
    """Outward unit normals u + iv (m, 4) of the sides of quads (m, 4, 2)."""
    corners = complex_from_pixels(quads)
    along = corners.take(NEXT, axis=1) - corners
    return -1j * (along / np.abs(along))


def outwards(normal: ComplexArray, by: FloatArray | float) -> FloatArray:
    """How corners (m, 4, 2) move when sides with these normals (m, 4) move outwards by so many (m, 4)."""
    moved = by * normal
    return pixels_from_complex(moved + moved.take(BEFORE, axis=1))


def complex_from_pixels(pixels: FloatArray) -> ComplexArray:
    """Places u + iv (m, 4) of pixels (m, 4, 2)."""
    return pixels.view(np.complex128)[..., 0]


def pixels_from_complex(places: ComplexArray) -> FloatArray:
    """Pixels (m, 4, 2) of places u + iv (m, 4)."""
    return places.view(np.float64).reshape(-1, 4, 2)
