"""The ellipsoid that a magnetometer's raw readings lie on, algebraically: where every fit starts from.

A constant field of strength F, turned about in a sensor with hard iron o and soft iron, gives raw readings m
on an ellipsoid. As in eq. 12, `matrix @ (m - centre)` lies on the sphere of radius 1; `matrix` is symmetric
and positive definite, so that no rotation comes in that the samples know nothing of.

Li and Griffiths, "Least squares ellipsoid specific fitting", Geometric Modeling and Processing 2004: the
quadric of least algebraic distance that is an ellipsoid for sure. It is biased by noise: a start, no result.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray
from scipy.optimize import least_squares

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
        return (raw - self.centre) @ self.matrix.T

    def deviation(self, raw: FloatArray) -> FloatArray:
        """How far each reading (n,) is off the sphere, as a share of its radius."""
        return np.asarray(np.linalg.norm(self.apply(raw), axis=1) - 1.0)

    def rough_distance(self, raw: FloatArray) -> FloatArray:
        """Distance (n,) of each reading from the ellipsoid in raw units, to first order (Sampson 1982)."""
        sphere = self.apply(raw)
        length = np.maximum(np.linalg.norm(sphere, axis=1), 1e-9)
        slope = np.linalg.norm(sphere @ self.matrix, axis=1) / length
        return np.asarray(np.abs(length - 1.0) / slope)

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
    return np.concatenate([leading, -rest @ leading])


def _from_quadric(quadric: FloatArray) -> Ellipsoid:
    xx, yy, zz, yz, xz, xy, *linear, constant = quadric.tolist()
    shape = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    centre = -np.linalg.solve(shape, np.array(linear))
    values, vectors = np.linalg.eigh(shape / (centre @ shape @ centre - constant))
    if not values[0] > 1e-9 * values[-1]:
        raise NoEllipsoidError("the readings lie in a plane or on a line")
    return Ellipsoid((vectors * np.sqrt(values)) @ vectors.T, centre)


# ---------------------------------------------------------------- distance
# How far readings are from an ellipsoid, and how that changes with the ellipsoid.
#
# The ellipsoid is a vector x of nine: the symmetric matrix's (C11, C22, C33, C12, C13, C23), and the centre
# o; its points p have |C (p - o)| = 1. A reading's foot is the point nearest to it. The distance's derivative
# is how fast the surface moves along its normal at the foot, whatever the distance (the envelope theorem), so
# that it does not go with a reading's noise along the normal: that is what makes least squares of the
# distance unbiased but for the surface's curvature.

UNKNOWNS: Final = 9
_ROWS: Final = np.array([0, 1, 2, 0, 0, 1])
_COLUMNS: Final = np.array([0, 1, 2, 1, 2, 2])
_NEWTON_STEPS: Final = 6
_NEAREST_POLE: Final = 0.95  # of the way to where a reading deep inside has no one foot


def pack(ellipsoid: Ellipsoid) -> FloatArray:
    return np.concatenate([ellipsoid.matrix[_ROWS, _COLUMNS], ellipsoid.centre])


def unpack(x: FloatArray) -> Ellipsoid:
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
        return np.concatenate([product / self.slope[:, None], -self.normal], axis=1)


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


# ---------------------------------------------------------------- fit
# The ellipsoid fit: robust start, refinement, outliers, and how sure one can be of the result.
#
# Two objectives. `likelihood`: each raw reading has the same noise in all axes, so what counts is its
# distance from the ellipsoid in raw units (`distance`), less what noise adds to it on average, for the
# ellipsoid curves away. With half a sphere and 2 % noise this errs by what the noise must cost; plain least
# squares of |B| - 1, B = C (m - o), shrink the matrix where the noise is, and err by 7 % of the field there.
# `residual`: the plain least squares all the same, which by definition leave the least residual. When the
# whole sphere is covered they do little harm, and when the residuals are correlated in time they are not the
# sensor's noise (the field is not the same everywhere, the vehicle's parts move), so that the likelihood's
# weights rest on nothing. `auto` takes them in that case alone, and adds the difference of the two to what is
# stated as uncertainty.

Objective = Literal["likelihood", "residual"]
Asked = Objective | Literal["auto"]

MOST_SAMPLES: Final = 30_000  # more say no more: evenly thinned
_ROUNDS: Final = 12
_LAGS: Final = 10
_CORRELATED_SIGMA: Final = 5.0  # of the mean autocorrelation over those lags, were there none
_LONGEST_CORRELATION: Final = 2000  # samples


@dataclass(frozen=True, slots=True)
class EllipsoidFit:
    """A fit to readings (n, 3).

    Attributes:
        ellipsoid: onto the unit sphere.
        objective: what was minimised.
        covariance: (9, 9) of (C11, C22, C33, C12, C13, C23, o1, o2, o3) where C is in units of its own mean
            scale and o in units of the field: shares, all of them.
        radius: the field in raw units: 1 / det(matrix)^(1/3).
        kept: mask (n,) of what is no outlier.
        noise: standard deviation of one axis as a share of the field.
        condition: of the normal equations, their diagonal scaled to 1.
        correlation_samples: how many samples in a row tell what one independent sample would.
    """

    ellipsoid: Ellipsoid
    objective: Objective
    covariance: FloatArray
    radius: float
    kept: BoolArray
    noise: float
    condition: float
    correlation_samples: float

    @property
    def centre_std(self) -> FloatArray:
        """Standard deviations (3,) of the hard iron, as shares of the field."""
        return np.sqrt(np.diag(self.covariance)[6:])

    @property
    def matrix_std(self) -> float:
        """The largest standard deviation of a soft-iron element."""
        return float(np.sqrt(np.diag(self.covariance)[:6].max()))


def fit_ellipsoid(raw: FloatArray, rng: np.random.Generator, objective: Asked = "auto") -> EllipsoidFit:
    """Fit readings (n, 3), in the order in which they were taken, in any unit.

    Raises:
        NoEllipsoidError: they determine no ellipsoid.
    """
    thinned = raw[:: math.ceil(len(raw) / MOST_SAMPLES)]
    start = robust_start(thinned, rng)
    x, kept, sigma = _refine(thinned, start)
    # from here on in units of the field, about the centre: all shares of the field
    refined = unpack(x)
    middle, size = refined.centre, 1.0 / _mean_scale(refined.matrix)
    scaled, sigma = (thinned - middle) / size, sigma / size
    x = pack(Ellipsoid(refined.matrix * size, np.zeros(3)))
    jacobian = distance(x, scaled[kept]).jacobian()
    normal = jacobian.T @ jacobian / sigma**2
    correlation = correlation_samples(_residuals(x, scaled[kept], sigma))
    covariance = np.asarray(correlation * np.linalg.pinv(normal), dtype=float)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    chosen: Objective = "likelihood" if objective == "auto" else objective
    if objective == "residual" or (objective == "auto" and _is_better_plain(x, scaled[kept])):
        chosen = "residual"
        plain = _fit_plain(x, scaled[kept])
        covariance = covariance + np.outer(plain - x, plain - x)
        x = plain
    return EllipsoidFit(
        ellipsoid=unpack(x).rescaled(middle, 1.0 / size),
        objective=chosen,
        covariance=covariance,
        radius=size / _mean_scale(unpack(x).matrix),
        kept=np.abs(_residuals(x, (raw - middle) / size, sigma)) <= _outlier_limit(len(scaled)) * sigma,
        noise=sigma,
        condition=float(np.linalg.cond(normal / np.outer(scale, scale))),
        correlation_samples=correlation,
    )


def whiteness_sigma(residuals: FloatArray) -> float:
    """How many standard deviations the mean autocorrelation at the first lags is from that of white noise."""
    r = residuals - residuals.mean()
    n, power = len(r), float(r @ r)
    if n <= 10 * _LAGS or power <= 0.0:
        return 0.0
    mean = float(np.mean([r[lag:] @ r[:-lag] / power for lag in range(1, _LAGS + 1)]))
    return mean * math.sqrt(_LAGS * n)


# ---------------------------------------------------------------- objectives


def _fit_plain(x: FloatArray, raw: FloatArray) -> FloatArray:
    return np.asarray(least_squares(lambda at: unpack(at).deviation(raw), x, x_scale="jac").x)


def _fit_likelihood(x: FloatArray, raw: FloatArray, sigma: float) -> FloatArray:
    """One solution with the bias as it is at `x`."""
    bias = sigma**2 * distance(x, raw).curvature
    solved: FloatArray = least_squares(
        lambda at: distance(at, raw).signed - bias,
        x,
        jac=lambda at: distance(at, raw).jacobian(),
        x_scale="jac",
    ).x
    return solved


def _residuals(x: FloatArray, raw: FloatArray, sigma: float) -> FloatArray:
    found = distance(x, raw)
    return found.signed - sigma**2 * found.curvature


def _refine(raw: FloatArray, start: Ellipsoid) -> tuple[FloatArray, BoolArray, float]:
    """The likelihood's optimum, the mask of what it was taken over, and the noise of one axis.

    Least squares over what lies near enough, with the spread of all readings for a measure of "near" until
    what is kept has settled, then with the spread of what is kept.
    """
    # in units of the start's size, so that no unknown is large
    size, middle = 1.0 / _mean_scale(start.matrix), start.centre
    scaled, x = (raw - middle) / size, pack(Ellipsoid(start.matrix * size, np.zeros(3)))
    sigma, limit = _spread(_residuals(x, scaled, 0.0)), _outlier_limit(len(scaled))
    kept = np.abs(_residuals(x, scaled, sigma)) <= limit * sigma
    settled = False
    for _ in range(_ROUNDS):
        x = _fit_likelihood(x, scaled[kept], sigma)
        residuals = _residuals(x, scaled, sigma)
        near = residuals[kept]
        deviation = math.sqrt(float(near @ near) / max(len(near) - UNKNOWNS, 1))
        sigma = max(deviation if settled else min(_spread(residuals), deviation), 1e-9)
        before, kept = kept, np.abs(residuals) <= limit * sigma
        if kept.sum() <= UNKNOWNS:
            raise NoEllipsoidError("the readings are on none")
        if np.array_equal(kept, before):
            if settled:
                break
            settled = True
    return pack(unpack(x).rescaled(middle, 1.0 / size)), kept, sigma * size


def _spread(residuals: FloatArray) -> float:
    """Standard deviation by the median absolute deviation from 0."""
    return max(1.4826 * float(np.median(np.abs(residuals))), 1e-6)


def _outlier_limit(count: int) -> float:
    """So many σ that among `count` normal ones the largest is rarely beyond."""
    return math.sqrt(2.0 * math.log(max(count, 2))) + 0.7


def _is_better_plain(x: FloatArray, raw: FloatArray) -> bool:
    sphere = unpack(x).apply(raw)
    length = np.linalg.norm(sphere, axis=1)
    whole = covered_share(sphere / length[:, None]) >= WHOLE
    return whole and whiteness_sigma(length) > _CORRELATED_SIGMA


def correlation_samples(residuals: FloatArray) -> float:
    """Integrated autocorrelation of residuals in order: 1 for white noise (Sokal's window, at five times it).

    n correlated samples tell as much as n / this independent ones.
    """
    r = residuals - residuals.mean()
    if whiteness_sigma(residuals) <= _CORRELATED_SIGMA:
        return 1.0
    size = 2 ** math.ceil(math.log2(2 * len(r)))
    spectrum = np.abs(np.fft.rfft(r, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: min(len(r) // 4, _LONGEST_CORRELATION)]
    times = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    within = np.flatnonzero(np.arange(len(times)) >= 5.0 * times)
    return max(1.0, float(times[within[0]] if within.size else times.max()))


def _mean_scale(matrix: FloatArray) -> float:
    return float(np.cbrt(np.linalg.det(matrix)))


# ---------------------------------------------------------------- coverage
# Which directions of the field the samples cover, which are missing, and how to turn the vehicle there.
#
# The sphere is cut into cells of equal area about the points of a Fibonacci lattice; a cell is covered when a
# sample lies in it. Directions are those of the calibrated field in the sensor's axes.

BoolArray = NDArray[np.bool_]

CELLS: Final = 100
WHOLE: Final = 0.80  # of the cells: no hole is left that is worth a turn


def lattice(count: int) -> FloatArray:
    """Unit vectors (count, 3), spread evenly (the golden angle from one to the next)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    longitude = math.pi * (1.0 + math.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(longitude), radius * np.sin(longitude), z], axis=1)


CENTRES: Final = lattice(CELLS)


def cells_of(directions: FloatArray) -> NDArray[np.intp]:
    return np.asarray(np.argmax(directions @ CENTRES.T, axis=1))


def covered_cells(directions: FloatArray) -> BoolArray:
    """Mask (CELLS,) of the cells that unit vectors (n, 3) lie in."""
    covered = np.zeros(CELLS, dtype=bool)
    covered[cells_of(directions)] = True
    return covered


def covered_share(directions: FloatArray) -> float:
    """Share of the sphere that unit vectors (n, 3) cover, 0 to 1."""
    return float(covered_cells(directions).mean()) if len(directions) else 0.0
