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

PROPORTIONAL: Final = np.arange(256, dtype=np.float32)

PLACES: Final = np.linspace(-1.0, 1.0, NORMALS)
_TAPS: Final = np.linspace(-1.0, 1.0, TAPS, dtype=np.float32)
# where a side's samples are, from its middle: in terms of 1, the half of it that is looked at, and the reach
_SAMPLES: Final[FloatArray] = np.stack(
    (np.ones(NORMALS * TAPS), np.repeat(PLACES, TAPS), np.tile(_TAPS, NORMALS)), axis=1
)
_BETWEEN: Final = 0.5 * (_TAPS[1:] + _TAPS[:-1])
_WINDOW: Final = 1.0 - _BETWEEN**4
# what a normal's differences are summed with: their weight, mean and mean square (12, 3)
_MOMENTS: Final = np.stack((_WINDOW, _WINDOW * _BETWEEN, _WINDOW * _BETWEEN**2), axis=1)


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
        weight, mean, square = (np.diff(below, axis=1) @ _MOMENTS).T
        widths.append(math.sqrt(float(np.mean(square / weight - (mean / weight) ** 2))))
        gains.append(float(mean[1] / weight[1]) / step)
    return np.array(widths), np.array(gains)


_WIDTHS, _GAINS = _gains()


class Sides(NamedTuple):
    """Straight sides (m, 4) of markers, their directions and outward normals (m, 4, 2)."""

    start: FloatArray
    along: FloatArray
    normal: FloatArray
    length: FloatArray
    span: FloatArray  # (m,) half the share of the side's length that is looked at, twice
    bow: FloatArray  # (m, 4) how far outwards the lens moves their middles, px
    bow_std: FloatArray  # (m, 4) of what is not known of it


class Places(NamedTuple):
    """Where sides cross their normals (m, 4, NORMALS), px outwards; contrasts alike; their blur (m, 4)."""

    offset: FloatArray
    contrast: FloatArray
    blur_px: FloatArray
    full: NDArray[np.bool_]  # (m,) whether the white is cut off


class Patches(NamedTuple):
    """The light about each of m markers, one patch below the other in one image.

    `shift` (m, 2) px is from the whole image, of that size, to there; `full` is the light of cut-off white,
    and `whole` are patches of which the picture's edge cuts nothing off.
    """

    light: NDArray[np.float32]
    shift: FloatArray
    size_px: tuple[int, int]
    full: float
    whole: bool


def decoded(
    image: NDArray[np.uint8], quads: FloatArray, margin: FloatArray, light: NDArray[np.float32]
) -> Patches:
    """Decode what lies within so many pixels (m,) of markers: most of an image is none of theirs."""
    rows, columns = image.shape
    least = (quads.min(axis=1) - margin[:, None]).astype(int)
    most = (quads.max(axis=1) + margin[:, None]).astype(int) + 2
    whole = bool((least >= 0).all() and (most <= (columns, rows)).all())
    low = np.minimum(np.maximum(least, 0), (columns - 2, rows - 2))
    high = np.minimum(np.maximum(most, low + 2), (columns, rows))
    width, height = (high - low).T
    top = np.cumsum(height) - height
    seen = np.zeros((int(height.sum()), int(width.max())), np.float32)
    for (left, above), (right, below), y in zip(low.tolist(), high.tolist(), top.tolist(), strict=True):
        seen[y : y + below - above, : right - left] = cv2.LUT(image[above:below, left:right], light)
    shift = np.stack((-low[:, 0], top - low[:, 1]), axis=1).astype(np.float64)
    return Patches(seen, shift, (columns, rows), float(light[FULL_GREY]), whole)


def places_along(patches: Patches, sides: Sides, reach: FloatArray) -> Places:
    """Where each normal goes from black to white: the centre of its rise, more weight near its middle."""
    m = len(reach)
    half = 0.5 * sides.length[..., None] * sides.along
    ways = np.empty((m, 4, 3, 2))
    ways[:, :, 0] = sides.start + half + patches.shift[:, None]
    ways[:, :, 1] = sides.span[:, None, None] * half
    ways[:, :, 2] = reach[:, None, None] * sides.normal
    at = (_SAMPLES @ ways.reshape(m * 4, 3, 2)).astype(np.float32)
    # one map has both u and v
    none = cast(FloatArray, None)
    seen = cv2.remap(patches.light, at, none, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    brightness = np.asarray(seen, np.float32).reshape(-1, TAPS)
    # blurred white between two edges is nowhere as bright as it is in the middle
    black = median(brightness[:, 0].astype(np.float64).reshape(m, -1))
    white = median(brightness.max(axis=1).astype(np.float64).reshape(m, -1))
    # what falls is another edge, of the code inside or of what lies beside the marker; noise that falls stays
    # in, for without it the noise that rises moves edges to where there is more of it, into the white
    floor = (-NOISE_SHARE * np.maximum(white - black, 0.0)).astype(np.float32)
    rise = (brightness[:, 1:] - brightness[:, :-1]).reshape(m, -1)
    rise *= rise >= floor[:, None]
    moments = (rise.reshape(-1, TAPS - 1) @ _MOMENTS).reshape(m, 4, NORMALS, 3)
    contrast = moments[..., 0]
    if not patches.whole:
        contrast = np.where(_within(at, patches), contrast, 0.0)
    sure = np.maximum(contrast, 1.0)
    mean = moments[..., 1] / sure
    width = np.sqrt(np.maximum(moments[..., 2] / sure - mean**2, 0.0))
    # what moves is blurred along its way, and so are the sides across it
    blur = median(width)
    gain = np.maximum(np.interp(blur, _WIDTHS, _GAINS), LEAST_GAIN)
    offset = np.maximum(np.minimum(mean / gain[..., None], 1.0), -1.0) * reach[:, None, None]
    full = white >= patches.full
    return Places(offset, contrast, blur * reach[:, None], full)


def _within(at: NDArray[np.float32], patches: Patches) -> NDArray[np.bool_]:
    """Which normals, samples (4m, NORMALS * TAPS, 2) along them, end in the image (m, 4, NORMALS).

    Beyond, its last pixels are repeated: a rise is cut.
    """
    ends = at.reshape(len(patches.shift), 4, NORMALS, TAPS, 2)[..., :: TAPS - 1, :]
    first = patches.shift.astype(np.float32)[:, None, None, None]
    last = first + np.float32(np.array(patches.size_px) - 1)
    return np.asarray(((ends >= first) & (ends <= last)).all(axis=(3, 4)))


def median(values: FloatArray) -> FloatArray:
    """Along the last axis, the upper one of two: a fraction of what numpy's own costs for so few."""
    half = values.shape[-1] // 2
    return np.asarray(np.partition(values, half, axis=-1)[..., half])


def mean_side(quads: FloatArray) -> FloatArray:
    """Mean length (m,) of the sides of quads (m, 4, 2)."""
    across = quads[:, (1, 2, 3, 0)] - quads
    return np.asarray(0.25 * np.sqrt((across**2).sum(axis=2)).sum(axis=1))
