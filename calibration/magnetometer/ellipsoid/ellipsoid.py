"""The ellipsoid that a magnetometer's raw readings lie on, algebraically: where every fit starts from.

A constant field of strength F, turned about in a sensor with hard iron o and soft iron, gives raw readings m
on an ellipsoid. As in eq. 12, `matrix @ (m - centre)` lies on the sphere of radius 1; `matrix` is symmetric
and positive definite, so that no rotation comes in that the samples know nothing of.

Li and Griffiths, "Least squares ellipsoid specific fitting", Geometric Modeling and Processing 2004: the
quadric of least algebraic distance that is an ellipsoid for sure. It is biased by noise: a start, no result.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.linalg import LinAlgError

from companion.base.geometry import FloatArray

LEAST_SAMPLES: Final = 10  # the quadric has nine unknowns
_SUBSET: Final = 10
_SUBSETS: Final = 400
_SCORED: Final = 600
_PROMISING: Final = 8
_CONCENTRATIONS: Final = 4
_CORE_SHARE: Final = 0.6

# of (x², y², z², yz, xz, xy): 4 J - I² of the quadric is to be positive
_CONSTRAINT: Final = np.block(
    [
        [np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]]), np.zeros((3, 3))],
        [np.zeros((3, 3)), -4.0 * np.eye(3)],
    ]
)


class NoEllipsoidError(Exception):
    """The samples are on no ellipsoid: too few, or in a plane, or all in one place."""


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """`matrix` (3, 3), symmetric, per raw unit; `centre` (3,) in raw units."""

    matrix: FloatArray
    centre: FloatArray

    def apply(self, raw: FloatArray) -> FloatArray:
        """Raw readings (n, 3) to the unit sphere (n, 3)."""
        sphere: FloatArray = (raw - self.centre) @ self.matrix.T
        return sphere

    def deviation(self, raw: FloatArray) -> FloatArray:
        """How far each reading (n,) is off the sphere, as a share of its radius."""
        off: FloatArray = np.linalg.norm(self.apply(raw), axis=1) - 1.0
        return off

    def rough_distance(self, raw: FloatArray) -> FloatArray:
        """Distance (n,) of each reading from the ellipsoid in raw units, to first order (Sampson 1982)."""
        sphere = self.apply(raw)
        length = np.maximum(np.linalg.norm(sphere, axis=1), 1e-9)
        slope = np.linalg.norm(sphere @ self.matrix, axis=1) / length
        distance: FloatArray = np.abs(length - 1.0) / slope
        return distance

    def rescaled(self, centre: FloatArray, factor: float) -> Ellipsoid:
        """The same in raw units that are (old / factor + centre)."""
        return Ellipsoid(self.matrix * factor, self.centre / factor + centre)


def algebraic_fit(raw: FloatArray) -> Ellipsoid:
    """Li and Griffiths' ellipsoid of readings (n, 3).

    Raises:
        NoEllipsoidError: they determine none.
    """
    if len(raw) < LEAST_SAMPLES:
        raise NoEllipsoidError(f"{len(raw)} samples; expected {LEAST_SAMPLES} or more")
    middle = raw.mean(axis=0)
    size = float(np.sqrt(np.mean((raw - middle) ** 2)))
    if not size > 0.0:
        raise NoEllipsoidError("all readings are the same")
    try:
        quadric = _quadric((raw - middle) / size)
        ellipsoid = _from_quadric(quadric)
    except LinAlgError as error:
        raise NoEllipsoidError("the readings lie in a plane or on a line") from error
    return ellipsoid.rescaled(middle, 1.0 / size)


def robust_start(raw: FloatArray, rng: np.random.Generator) -> Ellipsoid:
    """An ellipsoid that a third of wild readings among (n, 3) does not carry away.

    The least median of squares over fits to random subsets (Rousseeuw 1984), the most promising ones first
    concentrated by fits to what lies nearest to them (Rousseeuw and Van Driessen 2006).

    Raises:
        NoEllipsoidError: they determine none.
    """
    scored = raw[rng.permutation(len(raw))[:_SCORED]]
    candidates, problem = [], None
    try:
        candidates.append(algebraic_fit(raw))
    except NoEllipsoidError as error:
        # a wild reading may be all there is to see in them
        problem = error
    for _ in range(_SUBSETS if len(raw) > 2 * _SUBSET else 0):
        with contextlib.suppress(NoEllipsoidError):
            candidates.append(algebraic_fit(scored[rng.choice(len(scored), _SUBSET, replace=False)]))
    if problem is not None and not candidates:
        raise problem
    candidates.sort(key=lambda each: _median_distance(each, scored))
    promising = candidates[:_PROMISING]
    concentrated = [_concentrated(each, scored) for each in promising]
    return min(promising + concentrated, key=lambda each: _median_distance(each, scored))


def _concentrated(ellipsoid: Ellipsoid, raw: FloatArray) -> Ellipsoid:
    """Fitted again and again to what lies nearest to it."""
    for _ in range(_CONCENTRATIONS):
        nearest = np.argsort(ellipsoid.rough_distance(raw))[: int(_CORE_SHARE * len(raw))]
        try:
            ellipsoid = algebraic_fit(raw[nearest])
        except NoEllipsoidError:
            break
    return ellipsoid


def _median_distance(ellipsoid: Ellipsoid, raw: FloatArray) -> float:
    return float(np.median(ellipsoid.rough_distance(raw)))


def _quadric(points: FloatArray) -> FloatArray:
    """Coefficients (10,) of x², y², z², 2yz, 2xz, 2xy, 2x, 2y, 2z, 1; the generalised eigenvalue problem."""
    x, y, z = points.T
    design = np.stack(
        [x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, np.ones_like(x)], axis=1
    )
    scatter = design.T @ design
    upper, cross, lower = scatter[:6, :6], scatter[:6, 6:], scatter[6:, 6:]
    rest = np.linalg.solve(lower, cross.T)
    values, vectors = np.linalg.eig(np.linalg.solve(_CONSTRAINT, upper - cross @ rest))
    leading = vectors[:, int(np.argmax(values.real))].real
    leading = leading * np.sign(leading[:3].sum())
    coefficients: FloatArray = np.concatenate([leading, -rest @ leading])
    return coefficients


def _from_quadric(quadric: FloatArray) -> Ellipsoid:
    xx, yy, zz, yz, xz, xy, *linear, constant = quadric.tolist()
    shape = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    centre = -np.linalg.solve(shape, np.array(linear))
    values, vectors = np.linalg.eigh(shape / (centre @ shape @ centre - constant))
    if not values[0] > 1e-9 * values[-1]:
        raise NoEllipsoidError("the readings lie in a plane or on a line")
    return Ellipsoid((vectors * np.sqrt(values)) @ vectors.T, centre)
