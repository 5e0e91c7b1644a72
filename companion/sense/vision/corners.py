"""A marker's corners where its four sides meet.

The usual refinement looks at a corner's own neighbourhood, and blur rounds a corner off: it is drawn inwards
by a third of the blur's sigma, and the marker seems farther away than it is. A side is not moved by a blur
that is the same to both hands, and it is long. So the brightness is sampled along many normals of each side,
the place where it changes is found on each, and a curve is laid through these places: a straight line with
the bow that the lens gives it, or, without a lens, one that may bow as much as a lens bends it. How far the
places lie from the curve says how certain the corners are.

Pixels: u right, v down, whole numbers at pixel centres. Corners go round clockwise in the image, four a
marker, and side k runs from corner k to the next.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.sense.vision.edges import (
    BEFORE,
    NEXT,
    NORMALS,
    PLACES,
    PROPORTIONAL,
    ComplexArray,
    Places,
    Sides,
    complex_from_pixels,
    decoded,
    mean_side,
    median,
    outwards,
    pixels_from_complex,
    places_along,
)

MOST_ROUNDS: Final = 5
# corners that moved by less are within a few hundredths of a pixel of where they would end up
SETTLED_PX: Final = 0.2
# unless they were looked at with so many times the reach that they need
COARSE: Final = 2.0
# and those that still move by more are nowhere
UNSETTLED_PX: Final = 0.3
# how far a normal reaches to either hand at first: in cells of the code, and within these bounds in pixels
REACH_CELLS: Final = 0.45
REACH_PX: Final = (2.5, 14.0)
LEAST_REACH_PX: Final = 1.6
# then in terms of how wide the edge is blurred
REACH_BLURS: Final = 3.0
# and of how far the corners still moved: of a move a tenth is left, rarely (one in twenty) a third
REACH_MOVES: Final = 0.5
# near a corner a normal would see the other side: left out, as a share of the side and at least in pixels
END_SHARE: Final = 0.1
END_PX: Final = 1.5
MOST_END_SHARE: Final = 0.25
# the lens's bow of a side, at its ends: a standard deviation in pixels, times the image's width over length^2
BOW: Final = 0.03
# and what is left of it when the lens is known, times the length^2: a rolling shutter bends what moves
BOW_LEFT_PER_PX: Final = 2e-7
PLACE_STD_PX: Final = 0.1
# a normal with less than this share of its marker's contrast shows nothing: glare, dirt, something in the way
LEAST_CONTRAST: Final = 0.4
OUTLIER_SIGMA: Final = 3.0
REFITS: Final = 1
LEAST_SPREAD_PX: Final = 0.02
LEAST_USED: Final = 0.5
LEAST_USED_OF_A_SIDE: Final = 0.25
# pixels share light with their neighbours: places nearer to one another than this do not err independently
CORRELATED_PX: Final = 1.5
# white that is cut off eats into the black: exposed rightly, an edge lies where it should; twice too long, by
# its blur too far in. Mean and deviation of what lies between
EATEN_MEAN: Final = 0.45
EATEN_STD: Final = 0.4
# by how much of its blur an edge moves for an exponent of the encoding that is off by 1: a Gaussian's middle,
# black at 4 % of white
ENCODED: Final = 0.7
# more than two parameters a side is what the fit takes from the places' scatter
PARAMETERS: Final = 10

# blurred by more than this share of a cell, an edge is drawn to its neighbours' in the code and beside it, to
# either hand: by this share of what is more (cells of 2.5 to 5 px of a 4x4 code, a dark ground beside it)
CROWDED_CELL: Final = 0.15
CROWDED_SHARE: Final = 0.6
# orthonormal polynomials over the places (12, 3), and what they are at any u: (u^0, u^1, u^2) times this
# (3, 3)
_BASIS, _TRIANGLE = np.linalg.qr(np.stack((np.ones(NORMALS), PLACES, PLACES**2), axis=1))
_POLYNOMIALS: Final = np.linalg.inv(_TRIANGLE)
_PLACES2: Final = PLACES**2


class _Curves(NamedTuple):
    """Curves through places: coefficients (m, 3, 4), where places (m, NORMALS, 4) lie, and which count.

    `shrink` (m, 4) is by how much the bow's coefficient is drawn to what is expected of it: 0 wholly, 1 not
    at all; `bow_std` (m, 4) how far from that it may be.
    """

    coefficients: FloatArray
    offset: FloatArray
    kept: NDArray[np.bool_]
    shrink: FloatArray
    bow_std: FloatArray

    def used(self) -> tuple[FloatArray, FloatArray]:
        """The share (m,) of the places that count, and that of the side with the fewest."""
        share = self.kept.sum(axis=1) / NORMALS
        return share.mean(axis=1), share.min(axis=1)

    def scatter_px(self) -> FloatArray:
        """Standard deviation (m,) of the places that count."""
        away = np.where(self.kept, self.offset - _BASIS @ self.coefficients, 0.0)
        count = self.kept.sum(axis=(1, 2))
        return np.asarray(np.sqrt((away**2).sum(axis=(1, 2)) / np.maximum(count - PARAMETERS, 1)))


class Refined(NamedTuple):
    """Corners (m, 4, 2) px, and how sides err (m,) px: as wholes, and at their ends by being turned.

    A marker whose sides cannot be followed keeps its corners, and its deviations are infinite. `shrunk_px`
    (m, 4): by how much all sides together may lie too far in or out, by shares of how much each is blurred:
    where the white is too bright, where cells are as small, and as the encoding may be another. `crowded_px`
    (m,): by how much each side for itself may be drawn to what lies beside it.
    """

    corners: FloatArray
    offset_std_px: FloatArray
    turn_std_px: FloatArray
    shrunk_px: FloatArray
    crowded_px: FloatArray

    @property
    def corner_std_px(self) -> FloatArray:
        """Of each corner across each of its sides (m,)."""
        return np.hypot(self.offset_std_px, self.turn_std_px)


def refine_quads(
    image: NDArray[np.uint8],
    quads: FloatArray,
    cells: FloatArray,
    bow_px: FloatArray | None = None,
    light: NDArray[np.float32] = PROPORTIONAL,
    encoding_error: float = 0.0,
) -> Refined:
    """Move the corners of markers to where their sides meet.

    Args:
        image: (height, width).
        quads: (m, 4, 2) px, within half a cell of the true ones.
        cells: (m,) across each marker, the black border included.
        bow_px: (m, 4) how far outwards the middle of each side lies from between its corners, by the lens;
            without it sides bow as lenses bend them.
        light: (256,) light of each grey value, 255 at most.
        encoding_error: by which share the light's exponent may be off, one standard deviation.
    """
    corners = np.array(quads, dtype=np.float64)
    farthest = np.minimum(np.maximum(REACH_CELLS * mean_side(corners) / cells, REACH_PX[0]), REACH_PX[1])
    # beyond the picture there is nothing to see: a side by its edge is looked at no farther than that
    room = _room(corners, image.shape)
    farthest = np.minimum(np.maximum(room, LEAST_REACH_PX), farthest)
    patches = decoded(image, corners, 2.5 * farthest, light)
    reach = farthest
    for _ in range(MOST_ROUNDS):
        sides = _sides(complex_from_pixels(corners), image.shape[1], bow_px)
        places = places_along(patches, sides, reach)
        curves = _curves(places, sides)
        moves = pixels_from_complex(_meeting(sides, curves))
        corners = corners + moves
        moved = _farthest(moves)
        # a side that is still on its way must not leave the edge behind
        looked, wanted = reach, np.maximum(REACH_BLURS * median(places.blur_px), REACH_MOVES * moved)
        reach = np.minimum(np.maximum(wanted, LEAST_REACH_PX), farthest)
        lost = _farthest(corners - quads) > 1.5 * farthest
        # nor is one at rest that was last looked at with taps far apart
        if (lost | ((moved < SETTLED_PX) & (looked < COARSE * reach))).all():
            break
    used, least_used = curves.used()
    offset_std, turn_std = _side_std(sides, curves, used)
    lost |= ~np.isfinite(offset_std + turn_std) | (moved > UNSETTLED_PX)
    lost |= (used < LEAST_USED) | (least_used < LEAST_USED_OF_A_SIDE)
    # a rise that the picture's edge cuts off seems to be where it is not
    lost |= room < REACH_BLURS * places.blur_px.max(axis=1)
    corners[lost], offset_std[lost], turn_std[lost] = quads[lost], np.inf, np.inf
    blur = places.blur_px
    crowded = CROWDED_SHARE * np.maximum(blur - CROWDED_CELL * (mean_side(corners) / cells)[:, None], 0.0)
    eaten = np.where(places.full[:, None], blur, 0.0)
    if places.full.any():
        corners[~lost] += outwards(sides.normal, EATEN_MEAN * eaten)[~lost]
    shrunk = np.sqrt((EATEN_STD * eaten) ** 2 + crowded**2 + (ENCODED * encoding_error * blur) ** 2)
    return Refined(corners, offset_std, turn_std, shrunk, crowded.mean(axis=1))


def _farthest(moves: FloatArray) -> FloatArray:
    """Of moves (m, 4, 2) px, each marker's longest (m,) along an axis."""
    return np.asarray(np.abs(moves).reshape(-1, 8).max(axis=1))


def _room(corners: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """How far (m,) px the corner that is nearest to the picture's edge is from it."""
    far = np.array(shape[::-1]) - 1.0 - corners
    return np.asarray(np.minimum(corners, far).reshape(-1, 8).min(axis=1))


def _sides(corners: ComplexArray, image_width_px: int, bow_px: FloatArray | None) -> Sides:
    across = corners.take(NEXT, axis=1) - corners
    length = np.maximum(np.abs(across), 1.0)
    along = across / length
    end = np.maximum(END_SHARE, END_PX / (0.25 * length.sum(axis=1, keepdims=True)))
    span = 1.0 - 2.0 * np.minimum(end, MOST_END_SHARE)
    if bow_px is None:
        bow_px, bow_std = np.zeros_like(length), BOW / image_width_px * length**2
    else:
        bow_std = BOW_LEFT_PER_PX * (length * length)
    return Sides(corners, along, -1j * along, length, span, bow_px, bow_std)


def _curves(places: Places, sides: Sides) -> _Curves:
    """Least squares with a prior on the bow; places without contrast or far from the curve are left out.

    They are of what is left when the lens's bow is taken out.

    A place that is left out is put on the curve and the fit repeated: with few of them that is as good as to
    weigh them with nothing, and one small product does for all sides.
    """
    m = len(places.offset)
    bend = 1.0 - sides.span * sides.span * _PLACES2
    offset = places.offset - sides.bow[:, None] * bend[..., None]
    usual = median(places.contrast.reshape(m, -1))
    keep = places.contrast > (LEAST_CONTRAST * usual)[:, None, None]
    bow_std = sides.bow_std * _TRIANGLE[2, 2]
    variance = bow_std * bow_std
    shrink = variance / (variance + PLACE_STD_PX**2)
    filled = offset if keep.all() else np.where(keep, offset, median(offset.swapaxes(1, 2))[:, None])
    for _ in range(REFITS):
        fitted = _BASIS @ _coefficients(filled, shrink)
        away = np.abs(offset - fitted)
        most = np.maximum(1.48 * median(away.reshape(m, -1)), LEAST_SPREAD_PX) * OUTLIER_SIGMA
        keep &= away < most[:, None, None]
        filled = np.where(keep, offset, fitted)
    return _Curves(_coefficients(filled, shrink), offset, keep, shrink, bow_std)


def _coefficients(offset: FloatArray, shrink: FloatArray) -> FloatArray:
    """Of the curves (m, 3, 4) through places (m, NORMALS, 4), the bow's shrunk by (m, 4)."""
    coefficients = _BASIS.T @ offset
    coefficients[:, 2] *= shrink
    return coefficients


def _meeting(sides: Sides, curves: _Curves) -> ComplexArray:
    """How far (m, 4) px the corners are from where each side's curve meets that of the side before."""
    u = 1.0 / sides.span
    plain = _POLYNOMIALS @ curves.coefficients  # of u^0, u^1, u^2
    tilt, bent = u * plain[:, 1], u * u * plain[:, 2]
    middle = plain[:, 0] + bent
    # the lens's bow belongs to the curve, and vanishes at the corners
    bent = 2.0 * (bent - sides.bow)
    # tangents at a side's start and, of the side before, at its end: lines a . x = offset
    slope = 2.0 / sides.length * sides.along
    a = sides.normal - (tilt - bent) * slope
    b = (sides.normal - (tilt + bent) * slope).take(BEFORE, axis=1)
    ahead, behind = (middle + tilt).take(BEFORE, axis=1), middle - tilt
    determinant = (a.conj() * b).imag
    determinant[np.abs(determinant) < 0.05] = np.inf
    return np.asarray(1j * (ahead * a - behind * b) / determinant)


def _side_std(sides: Sides, curves: _Curves, used: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (m,) px of a side's ends from the scatter of the places.

    What both ends have in common, by the curve's height and what is not known of its bow, and what they have
    with opposite signs, by its turn: that is how a straight line's ends err independently of each other.
    """
    u = 1.0 / sides.span[:, 0]
    powers = np.ones((len(u), 3))
    powers[:, 1], powers[:, 2] = u, u * u
    ends = powers @ _POLYNOMIALS
    length = 0.25 * sides.length.sum(axis=1)
    spacing = length * sides.span[:, 0] / (NORMALS - 1)
    alike = np.maximum(CORRELATED_PX / spacing, 1.0)
    place = curves.scatter_px() ** 2 * alike / np.maximum(used, 0.1)
    shrink = curves.shrink
    bow = 0.25 * (shrink * shrink).sum(axis=1) * place
    bow += 0.25 * (((1.0 - shrink) * curves.bow_std) ** 2).sum(axis=1)
    offset = ends[:, 0] ** 2 * place + ends[:, 2] ** 2 * bow
    return np.sqrt(offset), np.sqrt(ends[:, 1] ** 2 * place)
