"""A marker's corners where its four sides meet.

The usual refinement looks at a corner's own neighbourhood, and blur rounds a corner off: it is drawn inwards
by a third of the blur's sigma, and the marker seems farther away than it is. A side is not moved by a blur
that is the same to both hands, and it is long. So the brightness is sampled along many normals of each side,
the place where it changes is found on each, and a curve is laid through these places: a straight line that
may bow as much as a lens bends it. How far the places lie from the curve says how certain the corners are.

Pixels: u right, v down, whole numbers at pixel centres. Corners go round clockwise in the image, four a
marker, and side k runs from corner k to the next.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.geometry import FloatArray

Float32Array = NDArray[np.float32]

NORMALS: Final = 12  # along each side
TAPS: Final = 13  # along each normal
MOST_ROUNDS: Final = 5
# corners that moved by less are within a few hundredths of a pixel of where they would end up
SETTLED_PX: Final = 0.2
# and those that still move by more are nowhere
UNSETTLED_PX: Final = 0.3
# how far a normal reaches to either hand at first: in cells of the code, and within these bounds in pixels
REACH_CELLS: Final = 0.45
REACH_PX: Final = (2.5, 14.0)
# then in terms of how wide the edge is blurred
REACH_BLURS: Final = 3.0
# and of how far the corners still moved
REACH_MOVES: Final = 2.0
# near a corner a normal would see the other side: left out, as a share of the side and at least in pixels
END_SHARE: Final = 0.1
END_PX: Final = 1.5
MOST_END_SHARE: Final = 0.25
# the lens's bow of a side, at its ends: a standard deviation in pixels, times the image's width over length^2
BOW: Final = 0.03
PLACE_STD_PX: Final = 0.1
# a normal with less than this share of its marker's contrast tells nothing: glare, dirt, something in the way
LEAST_CONTRAST: Final = 0.4
OUTLIER_SIGMA: Final = 3.0
REFITS: Final = 1
LEAST_SPREAD_PX: Final = 0.02
LEAST_USED: Final = 0.5
LEAST_USED_OF_A_SIDE: Final = 0.25
# pixels share light with their neighbours: places nearer to one another than this do not err independently
CORRELATED_PX: Final = 1.5
# white that is brighter is cut off, and then eats into the black
FULL_GREY: Final = 250.0
# more than two parameters a side is what the fit takes from the places' scatter
PARAMETERS: Final = 10

_TAPS: Final = np.linspace(-1.0, 1.0, TAPS, dtype=np.float32)
_BETWEEN: Final = 0.5 * (_TAPS[1:] + _TAPS[:-1])
_WINDOW: Final = 1.0 - _BETWEEN**2
# what a normal's differences are summed with: their weight, mean and mean square (12, 3)
_MOMENTS: Final = np.stack((_WINDOW, _WINDOW * _BETWEEN, _WINDOW * _BETWEEN**2), axis=1)
_PLACES: Final = np.linspace(-1.0, 1.0, NORMALS)
# orthonormal polynomials over the places (12, 3), and what they are at any u: (u^0, u^1, u^2) times this
# (3, 3)
_BASIS, _TRIANGLE = np.linalg.qr(np.stack((np.ones(NORMALS), _PLACES, _PLACES**2), axis=1))
_POLYNOMIALS: Final = np.linalg.inv(_TRIANGLE)


class _Sides(NamedTuple):
    """Straight sides (m, 4) of markers, their directions and outward normals (m, 4, 2)."""

    start: FloatArray
    along: FloatArray
    normal: FloatArray
    length: FloatArray
    span: FloatArray  # (m,) half the share of the side's length that is looked at, twice


class _Places(NamedTuple):
    """Where the sides cross normals (m, 4, NORMALS), px outwards, contrasts alike, blur of each marker."""

    offset: FloatArray
    contrast: FloatArray
    blur_px: FloatArray
    full: NDArray[np.bool_]  # (m,) whether the white is cut off


class _Curves(NamedTuple):
    """Curves through places: coefficients (m, 4, 3), scatter (m,) px, share of the places used (m,).

    Then that of the side (m,) with the fewest.
    """

    coefficients: FloatArray
    scatter_px: FloatArray
    used: FloatArray
    least_used: FloatArray


def refine_quads(
    image: NDArray[np.uint8], quads: FloatArray, cells: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move the corners of markers to where their sides meet.

    Args:
        image: (height, width).
        quads: (m, 4, 2) px, within half a cell of the true ones.
        cells: (m,) across each marker, the black border included.

    Returns:
        Corners (m, 4, 2) px, and their standard deviations (m,) px in each direction. A marker whose sides
        cannot be followed keeps its corners, and its deviation is infinite. Then by how much (m,) px all
        sides together may lie too far in, because the white is too bright: as much as they are blurred, or
        nothing.
    """
    corners = np.array(quads, dtype=np.float64)
    farthest = np.clip(REACH_CELLS * _lengths(corners) / cells, *REACH_PX)
    reach = farthest
    for _ in range(MOST_ROUNDS):
        sides = _sides(corners)
        places = _places(image, sides, reach)
        curves = _curves(places, sides, image.shape[1])
        moves = _meeting(sides, curves)
        corners = corners + moves
        moved = np.abs(moves).max(axis=(1, 2))
        # a side that is still on its way must not leave the edge behind
        reach = np.clip(np.maximum(REACH_BLURS * places.blur_px, REACH_MOVES * moved), REACH_PX[0], farthest)
        if moved.max(initial=0.0) < SETTLED_PX:
            break
    std = _corner_std(sides, curves)
    lost = np.abs(corners - quads).max(axis=(1, 2)) > 1.5 * farthest
    lost |= ~np.isfinite(std) | (moved > UNSETTLED_PX)
    lost |= (curves.used < LEAST_USED) | (curves.least_used < LEAST_USED_OF_A_SIDE)
    corners[lost], std[lost] = quads[lost], np.inf
    return corners, std, np.where(places.full, places.blur_px, 0.0)


def _lengths(corners: FloatArray) -> FloatArray:
    """Mean length (m,) of the sides."""
    across = np.roll(corners, -1, axis=1) - corners
    return np.asarray(np.sqrt((across**2).sum(axis=2)).mean(axis=1))


def _sides(corners: FloatArray) -> _Sides:
    across = corners[:, (1, 2, 3, 0)] - corners
    length = np.maximum(np.sqrt((across**2).sum(axis=2)), 1.0)
    along = across / length[..., None]
    normal = np.stack((along[..., 1], -along[..., 0]), axis=2)
    end = np.maximum(END_SHARE, END_PX / length.mean(axis=1))
    return _Sides(corners, along, normal, length, 1.0 - 2.0 * np.minimum(end, MOST_END_SHARE))


def _places(image: NDArray[np.uint8], sides: _Sides, reach: FloatArray) -> _Places:
    """Where each normal goes from black to white: the centre of its rise, more weight near its middle."""
    m = len(reach)
    half = 0.5 * sides.length[..., None]
    # (m, 4, NORMALS) along the side, then (m, TAPS) across it
    share = half * (1.0 + sides.span[:, None, None] * _PLACES)
    across = reach[:, None] * _TAPS
    maps = [
        (
            (sides.start[..., axis, None] + share * sides.along[..., axis, None])[..., None]
            + (sides.normal[..., axis, None] * across[:, None, :])[:, :, None, :]
        )
        .astype(np.float32)
        .reshape(m * 4, NORMALS * TAPS)
        for axis in (0, 1)
    ]
    grey = cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    brightness = grey.reshape(-1, TAPS).astype(np.float32)
    # what falls is another edge: of the code inside, or of what lies beside the marker
    rise = np.maximum(brightness[:, 1:] - brightness[:, :-1], 0.0)
    moments = (rise @ _MOMENTS).astype(np.float64).reshape(m, 4, NORMALS, 3)
    contrast = moments[..., 0]
    sure = np.maximum(contrast, 1.0)
    mean = moments[..., 1] / sure
    width = np.sqrt(np.maximum(moments[..., 2] / sure - mean**2, 0.0))
    blur_px = _median(width.reshape(m, -1)) * reach
    full = _median(brightness[:, -1].astype(np.float64).reshape(m, -1)) >= FULL_GREY
    return _Places(mean * reach[:, None, None], contrast, blur_px, full)


def _curves(places: _Places, sides: _Sides, image_width_px: int) -> _Curves:
    """Least squares with a prior on the bow; places without contrast or far from the curve are left out.

    A place that is left out is put on the curve and the fit repeated: with few of them that is as good as to
    weigh them with nothing, and one small product does for all sides.
    """
    offset = places.offset
    m = len(offset)
    usual = _median(places.contrast.reshape(m, -1))
    keep = places.contrast > LEAST_CONTRAST * usual[:, None, None]
    # the third orthonormal polynomial's coefficient for a bow of one pixel at the ends
    bow = BOW * sides.length**2 / image_width_px * _TRIANGLE[2, 2]
    shrink = bow**2 / (bow**2 + PLACE_STD_PX**2)
    gain = np.stack((np.ones_like(shrink), np.ones_like(shrink), shrink), axis=2)
    filled = offset if keep.all() else np.where(keep, offset, _median(offset)[..., None])
    for _ in range(REFITS):
        fitted = ((filled @ _BASIS) * gain) @ _BASIS.T
        away = np.abs(offset - fitted)
        spread = 1.48 * _median(away.reshape(m, -1))
        keep &= away < OUTLIER_SIGMA * np.maximum(spread, LEAST_SPREAD_PX)[:, None, None]
        filled = np.where(keep, offset, fitted)
    coefficients = (filled @ _BASIS) * gain
    away = np.where(keep, offset - coefficients @ _BASIS.T, 0.0)
    of_a_side = keep.sum(axis=2)
    count = of_a_side.sum(axis=1)
    variance = np.einsum("ijk,ijk->i", away, away) / np.maximum(count - PARAMETERS, 1)
    used, least_used = count / (4 * NORMALS), of_a_side.min(axis=1) / NORMALS
    return _Curves(coefficients, np.sqrt(variance), used, least_used)


def _median(values: FloatArray) -> FloatArray:
    """Along the last axis, the upper one of two: a fraction of what numpy's own costs for so few."""
    half = values.shape[-1] // 2
    return np.asarray(np.partition(values, half, axis=-1)[..., half])


def _meeting(sides: _Sides, curves: _Curves) -> FloatArray:
    """How far (m, 4, 2) px the corners are from where each side's curve meets that of the side before."""
    plain = curves.coefficients @ _POLYNOMIALS.T  # of u^0, u^1, u^2
    u = (1.0 / sides.span)[:, None]
    slope = 2.0 * u / sides.length
    c0, c1, c2 = plain[..., 0], plain[..., 1], plain[..., 2]
    ahead, behind = c0 + u * (c1 + u * c2), c0 - u * (c1 - u * c2)
    # tangents at a side's start and, of the side before, at its end: lines a . x = offset
    a = sides.normal - ((c1 - 2.0 * u * c2) * slope)[..., None] * sides.along
    b = (sides.normal - ((c1 + 2.0 * u * c2) * slope)[..., None] * sides.along)[:, (3, 0, 1, 2)]
    ahead = ahead[:, (3, 0, 1, 2)]
    determinant = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    determinant = np.where(np.abs(determinant) < 0.05, np.inf, determinant)
    x = (behind * b[..., 1] - ahead * a[..., 1]) / determinant
    y = (ahead * a[..., 0] - behind * b[..., 0]) / determinant
    return np.stack((x, y), axis=2)


def _corner_std(sides: _Sides, curves: _Curves) -> FloatArray:
    """Standard deviation (m,) px of the corners across each side, from the scatter of the places."""
    u = 1.0 / sides.span
    ends = np.stack((np.ones_like(u), u, u**2), axis=1) @ _POLYNOMIALS
    length = sides.length.mean(axis=1)
    spacing = length * sides.span / (NORMALS - 1)
    alike = np.maximum(CORRELATED_PX / spacing, 1.0)
    share = (ends**2).sum(axis=1) / np.maximum(curves.used, 0.1)
    return np.asarray(curves.scatter_px * np.sqrt(share * alike))
