"""How far readings are from an ellipsoid, and how that changes with the ellipsoid.

The ellipsoid is a vector x of nine: the symmetric matrix's (C11, C22, C33, C12, C13, C23), and the centre o;
its points p have |C (p - o)| = 1. A reading's foot is the point nearest to it. The distance's derivative is
how fast the surface moves along its normal at the foot, whatever the distance (the envelope theorem), so
that it does not go with a reading's noise along the normal: that is what makes least squares of the distance
unbiased but for the surface's curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.magnetometer.ellipsoid.ellipsoid import Ellipsoid
from companion.base.geometry import FloatArray

UNKNOWNS: Final = 9
_ROWS: Final = np.array([0, 1, 2, 0, 0, 1])
_COLUMNS: Final = np.array([0, 1, 2, 1, 2, 2])
_NEWTON_STEPS: Final = 6
_NEAREST_POLE: Final = 0.95  # of the way to where a reading deep inside has no one foot


def pack(ellipsoid: Ellipsoid) -> FloatArray:
    """The vector x (9,) of an ellipsoid."""
    x: FloatArray = np.concatenate([ellipsoid.matrix[_ROWS, _COLUMNS], ellipsoid.centre])
    return x


def unpack(x: FloatArray) -> Ellipsoid:
    """The ellipsoid of a vector x (9,)."""
    matrix = np.empty((3, 3))
    matrix[_ROWS, _COLUMNS] = matrix[_COLUMNS, _ROWS] = x[:6]
    return Ellipsoid(matrix, x[6:])


@dataclass(frozen=True, slots=True)
class Distance:
    """Of readings (n, 3), in raw units.

    Attributes:
        signed: (n,), positive outside.
        foot: (n, 3) from the centre.
        sphere: (n, 3), the foot on the unit sphere.
        normal: (n, 3), outward, of length 1.
        slope: (n,), how fast |C (p - o)| grows along the normal.
        curvature: (n,), the mean of the two principal ones, per raw unit: noise of variance v in each axis
            moves a reading outwards by v times this on average.
    """

    signed: FloatArray
    foot: FloatArray
    sphere: FloatArray
    normal: FloatArray
    slope: FloatArray
    curvature: FloatArray

    def jacobian(self) -> FloatArray:
        """Of `signed` with respect to x, (n, 9)."""
        product = self.sphere[:, _ROWS] * self.foot[:, _COLUMNS]
        product[:, 3:] += self.sphere[:, _COLUMNS[3:]] * self.foot[:, _ROWS[3:]]
        rows: FloatArray = np.concatenate([product / self.slope[:, None], -self.normal], axis=1)
        return rows


def distance(x: FloatArray, raw: FloatArray) -> Distance:
    """Of readings (n, 3) from the ellipsoid x.

    The foot is y / (1 + t c²) along each axis of the ellipsoid, c being the matrix's eigenvalue there and t
    the root of |C foot| = 1 (Eberly, "Distance from a point to an ellipsoid"), by Newton's method. What lies
    so deep inside that several points are as near gets a distance that is large, if not the least.
    """
    ellipsoid = unpack(x)
    values, axes = np.linalg.eigh(ellipsoid.matrix)
    squares = values**2
    y = (raw - ellipsoid.centre) @ axes
    t = np.zeros(len(raw))
    lowest = -_NEAREST_POLE / float(squares.max())
    for _ in range(_NEWTON_STEPS):
        stretch = 1.0 / (1.0 + t[:, None] * squares)
        terms = squares * (y * stretch) ** 2
        excess, slope = terms.sum(axis=1) - 1.0, -2.0 * (terms * squares * stretch).sum(axis=1)
        t = np.maximum(t - excess / np.minimum(slope, -1e-12), lowest)
    foot = y / (1.0 + t[:, None] * squares)
    gradient = squares * foot
    steepness = np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
    normal = gradient / steepness[:, None]
    return Distance(
        signed=np.sum((y - foot) * normal, axis=1),
        foot=foot @ axes.T,
        sphere=(foot * values) @ axes.T,
        normal=normal @ axes.T,
        slope=steepness,
        curvature=0.5 * (squares.sum() - (normal**2) @ squares) / steepness,
    )
