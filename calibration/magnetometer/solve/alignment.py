"""What gravity says of a calibrated magnetometer: the field's dip, and how the two sensors' axes stand.

The angle between the field and gravity is the same in all attitudes. An ellipsoid fit cannot see a rotation
of the magnetometer's axes against the accelerometer's; the constant angle can (Vasconcelos et al. 2011).
Specific force is +g upwards at rest, so that down is its opposite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.magnetometer.ellipsoid.coverage import BoolArray
from calibration.magnetometer.ellipsoid.fit import correlation_samples
from companion.base.geometry import FloatArray

_CALM_SHARE: Final = 0.1  # of the median: what is accelerated by more does not show down
LEAST_CALM: Final = 50
_PRIOR_RAD: Final = math.radians(5.0)
_TRIM_SIGMA: Final = 3.0
_ROUNDS: Final = 6


@dataclass(frozen=True, slots=True)
class Dip:
    """The field's angle below the horizontal as measured: median and spread (robust, 1 σ), degrees."""

    median_deg: float
    spread_deg: float
    samples: int


@dataclass(frozen=True, slots=True)
class AxisMisalignment:
    """`rotation` (3, 3) turns magnetometer axes into the accelerometer's; its size and uncertainty."""

    rotation: FloatArray
    angle_deg: float
    std_deg: float


def calm(force: FloatArray) -> BoolArray:
    """Mask (n,) of the specific forces (n, 3) that are about as large as gravity (the median)."""
    size = np.linalg.norm(force, axis=1)
    middle = np.nanmedian(size)
    mask: BoolArray = np.abs(size - middle) <= _CALM_SHARE * middle
    return mask


def dip_of(directions: FloatArray, force: FloatArray) -> Dip | None:
    """The dip by unit fields (n, 3) and specific forces (n, 3) beside them; None: too few are calm."""
    still = calm(force)
    if still.sum() < LEAST_CALM:
        return None
    angles = np.degrees(_dips(directions[still], force[still]))
    median = float(np.median(angles))
    return Dip(median, 1.4826 * float(np.median(np.abs(angles - median))), int(still.sum()))


def align(directions: FloatArray, force: FloatArray) -> AxisMisalignment | None:
    """The rotation that makes the dip constant over the calm samples; None: too few of them.

    Chips in one housing stand within degrees of one another: the fit knows that (`_PRIOR_RAD`), so that
    attitudes that say nothing of an axis leave it be. What is off by more than `_TRIM_SIGMA` was accelerated.
    """
    still = calm(force)
    if still.sum() < LEAST_CALM:
        return None
    fields, force = directions[still], force[still]
    x = np.array([0.0, 0.0, 0.0, float(np.median(_dips(fields, force)))])
    for _ in range(_ROUNDS):
        off = _off_dip(x, fields, force)
        sigma = max(1.4826 * float(np.median(np.abs(off))), 1e-4)
        near = np.abs(off) <= _TRIM_SIGMA * sigma
        weight = 1.0 / (sigma * math.sqrt(correlation_samples(off[near])))
        solved = least_squares(_weighted, x, args=(fields[near], force[near], weight), x_scale="jac")
        x = solved.x
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac)
    return AxisMisalignment(
        rotation=Rotation.from_rotvec(x[:3]).as_matrix(),
        angle_deg=math.degrees(float(np.linalg.norm(x[:3]))),
        std_deg=math.degrees(math.sqrt(float(np.diag(covariance)[:3].max()))),
    )


def _weighted(x: FloatArray, fields: FloatArray, force: FloatArray, weight: float) -> FloatArray:
    residuals: FloatArray = np.concatenate([weight * _off_dip(x, fields, force), x[:3] / _PRIOR_RAD])
    return residuals


def _off_dip(x: FloatArray, fields: FloatArray, force: FloatArray) -> FloatArray:
    """How far the dip (n,) of fields that are turned by x[:3] is off x[3], rad."""
    off: FloatArray = _dips(Rotation.from_rotvec(x[:3]).apply(fields), force) - x[3]
    return off


def _dips(directions: FloatArray, force: FloatArray) -> FloatArray:
    """The angle (n,) of unit fields below the horizontal, rad."""
    sines = -np.sum(directions * force, axis=1) / np.linalg.norm(force, axis=1)
    dips: FloatArray = np.arcsin(np.clip(sines, -1.0, 1.0))
    return dips
