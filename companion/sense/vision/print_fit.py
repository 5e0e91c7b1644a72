"""A marker's corners by its whole print, where its cells are so small that their edges run together.

A side's place is found from black and white to either hand of it. Where blur reaches across a cell, the code
inside draws the side to where it is not. So all edges of the code are fitted at once: the blurred print is
laid on the pixels about the marker by least squares, in light. What is fitted, for each marker: how its four
corners move, black, white and the blur. A part of a marker fills the image, and a lens vignettes: there white
varies smoothly, or what is darker to one hand of a side would draw the side. Pixels that fit badly (a
shadow's edge, grass, glare) count for less, and white that is cut off for nothing. How the pixels scatter
where they show a corner says how certain it is.

Places on a marker are in cells, from its top-left corner: x along its top edge, y down its left one. Pixels:
u right, v down, whole numbers at pixel centres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import Marker, dictionary_named
from companion.sense.vision.edges import FULL_GREY, mean_side

FloatImage = NDArray[np.float32]

MOST_ROUNDS: Final = 6
PLAIN_ROUNDS: Final = 2
# corners that moved by less are where they would end up, and those that still move by more are nowhere
SETTLED_PX: Final = 0.03
UNSETTLED_PX: Final = 0.1
# of the white around so many cells are looked at, and no farther than so many sigmas of blur from its end
QUIET_CELLS: Final = 0.5
CLEAR_SIGMA: Final = 2.5
# residuals of so many times the usual count half (Cauchy)
ROBUST: Final = 2.5
# a sharp lens and square pixels, to begin with; and what blur can be
USUAL_BLUR_PX: Final = 0.5
LEAST_BLUR_PX, MOST_BLUR_CELLS = 0.3, 0.6
# a print is drawn so fine, with so much white about it, and blurred in steps of so much
TEXELS: Final = 12  # a cell
BORDER: Final = 2  # cells
BLUR_STEP: Final = 1.15
# of texels, and of what lies between two of them: cells
DRAWN_BLUR: Final = math.sqrt(1.0 / 12.0 + 1.0 / 6.0) / TEXELS
# a marker whose corners move by more is nowhere, and so is one that explains less of its pixels' variance
LOST_CELLS: Final = 1.0
LEAST_EXPLAINED: Final = 0.5
# of the information that is whole, what keeps a matrix from being singular
UNSEEN: Final = 1e-6
LEAST: Final = 1e-9
LEAST_FREE: Final = 0.2
CORNERS: Final = 8
BLUR, LEVELS = CORNERS, CORNERS + 1  # the unknowns after the corners
LIT: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # powers of x and y by which white varies
_SQUARE: Final = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


class PrintFit(NamedTuple):
    """Corners (m, 4, 2) px and their covariances (m, 8, 8) px2, u and v of each in turn; blur (m,) px.

    Where a print was not found, its corners are as they were and its covariance is infinite.
    """

    corners: FloatArray
    covariance_px2: FloatArray
    blur_px: FloatArray


class _Pixels(NamedTuple):
    """About each of m markers, n pixels at most: where they are (m, n, 2) px, and their light (m, n).

    Which of them are `shown` (m, n), and in which white is cut off.
    """

    at: FloatImage
    light: FloatImage
    shown: NDArray[np.bool_]
    full: NDArray[np.bool_]


class _Step(NamedTuple):
    """How the k unknowns change (m, k); the Jacobian (m, k, n), and what is left of the light (m, n)."""

    change: FloatArray
    jacobian: FloatImage
    left: FloatImage
    weight: FloatImage


# a print that is nowhere divides by nothing, and is lost; OpenBLAS on arm64 says so of sums that are finite
@np.errstate(all="ignore")
def fit_prints(
    image: NDArray[np.uint8],
    light: FloatImage,
    markers: Sequence[Marker],
    quads: FloatArray,
    parts: FloatArray | None = None,
    straightened: Callable[[FloatArray], FloatArray] | None = None,
) -> PrintFit:
    """Lay each marker's print on the image, from corners (m, 4, 2) px that are right to half a cell.

    Args:
        image: (height, width).
        light: (256,) light of each grey value.
        markers: whose prints.
        quads: where they are.
        parts: (m, 2, 2) the first and the last corner, in cells, of the rectangles that the quads are of, of
            which half a cell more is looked at; none: the whole markers.
        straightened: where pixels (n, 2) would be without the lens's distortion, which bends what is large in
            the image; what is returned is there, too.
    """
    corners, squares = np.array(quads, dtype=np.float64), _squares(markers, parts)
    across = (squares[:, 2] - squares[:, 0]).mean(axis=1)
    cell_px = mean_side(corners) / across
    blur = np.full(len(markers), USUAL_BLUR_PX) / cell_px
    quiet = np.array([marker.quiet_m / marker.cell_m for marker in markers])
    pixels = _pixels_about(image, light, corners, np.minimum(quiet, QUIET_CELLS) / across)
    if straightened is not None:
        straight = straightened(pixels.at.reshape(-1, 2).astype(np.float64)).astype(np.float32)
        pixels = pixels._replace(at=straight.reshape(pixels.at.shape))
        quads = straightened(corners.reshape(-1, 2)).reshape(corners.shape)
        corners = quads.copy()
    least, unlike = LEAST_BLUR_PX / cell_px, np.zeros_like(pixels.light)
    shown = pixels.shown & ~pixels.full
    # parts are begun with from farther off, and something may lie on them
    for number in range(MOST_ROUNDS if parts is None else 2 * MOST_ROUNDS):
        at, to_pixels = _on_markers(pixels.at, corners, squares)
        levels = np.rint(np.log(blur) / math.log(BLUR_STEP))
        blur = BLUR_STEP**levels
        about = np.clip(quiet - CLEAR_SIGMA * blur, 0.0, QUIET_CELLS)
        counts = (shown & _clear(at, squares, about)).astype(np.float32)
        # what fits badly is known when the rest fits well
        weight = counts / (1.0 + unlike) if number >= PLAIN_ROUNDS else counts
        prints = [_texture(*each) for each in zip(markers, levels.astype(int).tolist(), strict=True)]
        step = _step(at, pixels.light, prints, squares, weight, LIT if parts is not None else LIT[:1])
        blur = np.sqrt(np.clip(blur**2 + step.change[:, BLUR], least**2, MOST_BLUR_CELLS**2))
        moves = (to_pixels @ step.change[:, :CORNERS].reshape(-1, 4, 2, 1))[..., 0]
        corners, moved = corners - moves, np.abs(moves).max(axis=(1, 2))
        unlike = _unlike(step)
        # white that is cut off says that there is as much light, or more
        shown = np.where(pixels.full, pixels.light - step.left < light[FULL_GREY], pixels.shown)
        lost = ~(np.abs(corners - quads).max(axis=(1, 2)) < LOST_CELLS * cell_px)
        if number >= PLAIN_ROUNDS and (lost | (moved < SETTLED_PX)).all():
            break
    covariance = _covariance(step, unlike, counts, to_pixels)
    lost |= ~np.isfinite(covariance).all(axis=(1, 2)) | ~(moved < UNSETTLED_PX)
    lost |= ~(_explained(step, pixels.light) > LEAST_EXPLAINED)
    corners[lost], covariance[lost] = quads[lost], np.inf
    return PrintFit(corners, covariance, blur * cell_px)


def _squares(markers: Sequence[Marker], parts: FloatArray | None) -> FloatArray:
    """Corners (m, 4, 2) in cells of what is laid on the image: whole markers, or parts of them."""
    if parts is None:
        return np.asarray(_SQUARE * np.array([marker.cells for marker in markers])[:, None, None])
    return np.asarray(parts[:, :1] + _SQUARE * (parts[:, 1:] - parts[:, :1]))


def white_cells(marker: Marker) -> FloatArray:
    """A marker's code, a row of the white around it included: 0 black, 1 white, (cells + 2, cells + 2)."""
    dictionary = dictionary_named(marker.dictionary)
    code = cv2.aruco.generateImageMarker(dictionary, marker.id, marker.cells)
    return np.pad(code.astype(np.float64) / 255.0, 1, constant_values=1.0)


@lru_cache(maxsize=64)
def _texture(marker: Marker, level: int) -> FloatImage:
    """A print blurred by BLUR_STEP^level cells, its slopes by x and y, and half its Laplacian: (t, t, 4)."""
    sigma = math.sqrt(max(BLUR_STEP ** (2 * level) - DRAWN_BLUR**2, 1e-4)) * TEXELS
    drawn = cv2.GaussianBlur(_drawn(marker), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    along, down = (cv2.Sobel(drawn, -1, *d, ksize=1, scale=0.5 * TEXELS) for d in ((1, 0), (0, 1)))
    curved = cv2.Laplacian(drawn, -1, ksize=1, scale=0.5 * TEXELS**2)
    return np.asarray(cv2.merge((drawn, along, down, curved)), np.float32)


@lru_cache(maxsize=128)
def _drawn(marker: Marker) -> FloatImage:
    """A print with its white: (t, t) float32, which takes 50 to 70 kB."""
    cells = np.pad(white_cells(marker), BORDER - 1, constant_values=1.0).astype(np.float32)
    return np.asarray(cells.repeat(TEXELS, axis=0).repeat(TEXELS, axis=1))


def _pixels_about(
    image: NDArray[np.uint8], light: FloatImage, corners: FloatArray, about: FloatArray
) -> _Pixels:
    """Those that show a marker or the white about it, by so many shares (m,) of its side."""
    height, width = image.shape
    found = []
    middles = corners.mean(axis=1, keepdims=True)
    outlines = middles + (corners - middles) * (1.0 + 2.0 * about[:, None, None])
    for outline in outlines:
        left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0).tolist()
        right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, (width, height)).tolist()
        inside = np.zeros((max(bottom - top, 1), max(right - left, 1)), np.uint8)
        cv2.fillConvexPoly(inside, np.rint(outline - (left, top)).astype(np.int32), 1)
        v, u = np.nonzero(inside)
        found.append((u + left, v + top, image[v + top, u + left]))
    most = max(len(grey) for _, _, grey in found)
    at = np.zeros((len(found), most, 2), np.float32)
    seen, shown = np.zeros((len(found), most), np.uint8), np.zeros((len(found), most), np.bool_)
    for k, (u, v, grey) in enumerate(found):
        at[k, : len(u), 0], at[k, : len(u), 1], seen[k, : len(u)] = u, v, grey
        shown[k, : len(u)] = True
    return _Pixels(at, np.minimum(light[seen], light[FULL_GREY]), shown, shown & (seen >= FULL_GREY))


def _on_markers(at: FloatImage, corners: FloatArray, square: FloatArray) -> tuple[FloatImage, FloatArray]:
    """Places (m, n, 2) of pixels on markers; and at each corner a cell's way in pixels (m, 4, 2, 2)."""
    squares, seen_at = square.astype(np.float32), corners.astype(np.float32)
    across = np.array([cv2.getPerspectiveTransform(*each) for each in zip(squares, seen_at, strict=True)])
    back = np.linalg.inv(across).astype(np.float32)
    seen = at @ back[:, :, :2].transpose(0, 2, 1) + back[:, None, :, 2]
    depth = (square @ across[:, 2, :2, None])[..., 0] + across[:, 2, 2, None]
    ways = across[:, None, :2, :2] - corners[..., None] * across[:, None, 2:, :2]
    return seen[..., :2] / seen[..., 2:], ways / depth[..., None, None]


def _clear(at: FloatImage, squares: FloatArray, about: FloatArray) -> NDArray[np.bool_]:
    """Which places (m, n) lie on what is looked at or so many cells (m,) about it."""
    low = squares[:, None, 0] - about[:, None, None]
    high = squares[:, None, 2] + about[:, None, None]
    return np.asarray(((at > low) & (at < high)).all(axis=2))


def _step(
    at: FloatImage,
    seen_light: FloatImage,
    prints: list[FloatImage],
    squares: FloatArray,
    weight: FloatImage,
    lit: Sequence[tuple[int, int]],
) -> _Step:
    """One step of weighted least squares, black and white first: the rest is in terms of their contrast."""
    texels = (at + np.float32(BORDER)) * np.float32(TEXELS) - np.float32(0.5)
    first, last = squares[:, None, 0].astype(np.float32), squares[:, None, 2].astype(np.float32)
    x, y = np.ascontiguousarray(np.moveaxis((at - first) / (last - first), 2, 0))
    shine = np.stack([(2.0 * x - 1.0) ** i * (2.0 * y - 1.0) ** j for i, j in lit], axis=1)
    jacobian = np.empty((len(at), LEVELS + 1 + len(lit), at.shape[1]), np.float32)
    white = jacobian[:, LEVELS + 1 :]
    for row, print_, place in zip(jacobian, prints, texels, strict=True):
        seen = cv2.remap(print_, *_split(place), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        row[LEVELS + 1], row[0], row[1], row[BLUR] = np.asarray(seen, np.float32).T
    white[:] = white[:, :1] * shine
    jacobian[:, LEVELS] = 1.0
    levels, left = _solved(jacobian[:, LEVELS:], seen_light, weight)
    jacobian[:, (0, 1, BLUR)] *= (levels[:, None, 1:] @ shine).astype(np.float32)
    slopes = jacobian[:, None, :2]
    both = x * y
    shares = np.stack((1.0 - x - y + both, x - both, both, y - both), axis=1)
    jacobian[:, :CORNERS] = (shares[:, :, None] * slopes).reshape(len(at), CORNERS, -1)
    change, left = _solved(jacobian, left, weight)
    return _Step(change.astype(np.float64), jacobian, left, weight)


def _split(places: FloatImage) -> tuple[FloatImage, FloatImage]:
    """x and y (1, n) of places (n, 2)."""
    return np.ascontiguousarray(places[None, :, 0]), np.ascontiguousarray(places[None, :, 1])


def _solved(rows: FloatImage, values: FloatImage, weight: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Weighted least squares: the unknowns (m, k), and what they leave of the values (m, n)."""
    weighted = rows * weight[:, None]
    information = weighted @ rows.transpose(0, 2, 1)
    unknown = np.linalg.solve(_regular(information), weighted @ values[..., None]).astype(np.float32)
    return unknown[..., 0], values - (unknown.transpose(0, 2, 1) @ rows)[:, 0]


def _regular(information: NDArray[np.floating]) -> FloatArray:
    """Symmetric matrices (m, k, k) that can be inverted: what pixels do not show is as good as unknown."""
    known = information.astype(np.float64)
    diagonal = np.einsum("mkk->mk", known)
    diagonal += UNSEEN * diagonal + LEAST
    return known


def _unlike(step: _Step) -> FloatImage:
    """How much less than others each pixel (m, n) should count: squares of misfits in terms of the usual."""
    weight = step.weight
    usual = (weight * step.left**2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)
    return np.asarray(step.left**2 / np.maximum(ROBUST**2 * usual, 1e-6)[:, None])


def _covariance(step: _Step, unlike: FloatImage, counts: FloatImage, to_pixels: FloatArray) -> FloatArray:
    """Of the corners (m, 8, 8) px2: by the misfits where they matter, which is at edges (Huber, White).

    A pixel that the fit follows misses by less than its noise: by the share that it does not decide itself.
    """
    weighted = step.jacobian * step.weight[:, None]
    inverse = np.linalg.inv(_regular(weighted @ step.jacobian.transpose(0, 2, 1)))
    own = ((inverse.astype(np.float32) @ weighted) * step.jacobian).sum(axis=1)
    pulls = weighted * (step.left / np.maximum(1.0 - own, LEAST_FREE))[:, None]
    covariance = inverse @ (pulls @ pulls.transpose(0, 2, 1)) @ inverse
    # what is far off pulls less than its weight says, the farther the less
    pull = (counts * (1.0 - unlike) / (1.0 + unlike) ** 2).sum(axis=1)
    more = (step.weight.sum(axis=1) / np.maximum(pull, 1.0)) ** 2
    turned = np.zeros((len(pull), CORNERS, CORNERS))
    for k in range(4):
        turned[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = to_pixels[:, k]
    covariance = covariance[:, :CORNERS, :CORNERS] * more[:, None, None]
    return np.asarray(turned @ covariance @ turned.transpose(0, 2, 1))


def _explained(step: _Step, light: FloatImage) -> FloatImage:
    """Share (m,) of the pixels' variance that the print explains."""
    weight = step.weight / np.maximum(step.weight.sum(axis=1), 1.0)[:, None]
    mean = (weight * light).sum(axis=1)
    variance = (weight * (light - mean[:, None]) ** 2).sum(axis=1)
    return np.asarray(1.0 - (weight * step.left**2).sum(axis=1) / np.maximum(variance, 1e-6))
