"""The ellipsoid fit: robust start, refinement, outliers, and how sure one can be of the result.

Two objectives. `likelihood`: each raw reading has the same noise in all axes, so what counts is its distance
from the ellipsoid in raw units (`distance`), less what noise adds to it on average, for the ellipsoid curves
away. With half a sphere and 2 % noise this errs by what the noise must cost; plain least squares of |B| - 1,
B = C (m - o), shrink the matrix where the noise is, and err by 7 % of the field there.
`residual`: the plain least squares all the same, which by definition leave the least residual.
When the whole sphere is covered they do little harm, and when the residuals are correlated in time they are
not the sensor's noise (the field is not the same everywhere, the vehicle's parts move), so that the
likelihood's weights rest on nothing. `auto` takes them in that case alone, and adds the difference of the
two to what is stated as uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares

from calibration.magnetometer.ellipsoid.coverage import WHOLE, BoolArray, covered_share
from calibration.magnetometer.ellipsoid.distance import UNKNOWNS, distance, pack, unpack
from calibration.magnetometer.ellipsoid.ellipsoid import Ellipsoid, NoEllipsoidError, robust_start
from companion.base.geometry import FloatArray

Objective = Literal["likelihood", "residual"]

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
        std: FloatArray = np.sqrt(np.diag(self.covariance)[6:])
        return std

    @property
    def matrix_std(self) -> float:
        """The largest standard deviation of a soft-iron element."""
        return float(np.sqrt(np.diag(self.covariance)[:6].max()))


def fit_ellipsoid(
    raw: FloatArray, rng: np.random.Generator, objective: Objective | Literal["auto"] = "auto"
) -> EllipsoidFit:
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
    normal, correlation = _information(x, scaled[kept], sigma)
    covariance = np.asarray(correlation * np.linalg.pinv(normal), dtype=float)
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
        condition=_condition(normal),
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


def _plain(x: FloatArray, raw: FloatArray) -> FloatArray:
    return unpack(x).deviation(raw)


def _fit_plain(x: FloatArray, raw: FloatArray) -> FloatArray:
    solved: FloatArray = least_squares(_plain, x, args=(raw,), x_scale="jac").x
    return solved


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
    residuals: FloatArray = found.signed - sigma**2 * found.curvature
    return residuals


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


# ---------------------------------------------------------------- uncertainty


def _information(x: FloatArray, raw: FloatArray, sigma: float) -> tuple[FloatArray, float]:
    """J^T J / σ² of the likelihood (9, 9), and the residuals' correlation in samples."""
    jacobian = distance(x, raw).jacobian()
    normal: FloatArray = jacobian.T @ jacobian / sigma**2
    return normal, correlation_samples(_residuals(x, raw, sigma))


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


def _condition(normal: FloatArray) -> float:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return float(np.linalg.cond(normal / np.outer(scale, scale)))


def _mean_scale(matrix: FloatArray) -> float:
    return float(np.cbrt(np.linalg.det(matrix)))
