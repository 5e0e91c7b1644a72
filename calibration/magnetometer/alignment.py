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

from calibration.magnetometer.coverage import BoolArray
from companion.geometry import FloatArray

_CALM_SHARE: Final = 0.1  # of the median: what is accelerated by more does not show down
LEAST_CALM: Final = 50


@dataclass(frozen=True, slots=True)
class Dip:
    """The field's angle below the horizontal as measured: median and spread (robust, 1 σ), degrees."""

    median_deg: float
    spread_deg: float
    samples: int


@dataclass(frozen=True, slots=True)
class Alignment:
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
    angles = np.degrees(np.arcsin(np.clip(_sines(directions[still], force[still]), -1.0, 1.0)))
    median = float(np.median(angles))
    return Dip(median, 1.4826 * float(np.median(np.abs(angles - median))), int(still.sum()))


def align(directions: FloatArray, force: FloatArray) -> Alignment | None:
    """The rotation that makes the dip constant over the calm samples; None: too few of them."""
    still = calm(force)
    if still.sum() < LEAST_CALM:
        return None
    fields, up = directions[still], force[still] / np.linalg.norm(force[still], axis=1)[:, None]

    def residuals(x: FloatArray) -> FloatArray:
        off: FloatArray = _sines(Rotation.from_rotvec(x[:3]).apply(fields), up) - x[3]
        return off

    start = np.array([0.0, 0.0, 0.0, float(np.median(_sines(fields, up)))])
    spread = max(float(np.median(np.abs(residuals(start)))), 1e-3)
    solved = least_squares(residuals, start, loss="soft_l1", f_scale=spread)
    variance = float(np.mean(residuals(solved.x) ** 2))
    covariance = variance * np.linalg.pinv(solved.jac.T @ solved.jac)
    return Alignment(
        rotation=Rotation.from_rotvec(solved.x[:3]).as_matrix(),
        angle_deg=math.degrees(float(np.linalg.norm(solved.x[:3]))),
        std_deg=math.degrees(math.sqrt(float(np.diag(covariance)[:3].max()))),
    )


def _sines(directions: FloatArray, force: FloatArray) -> FloatArray:
    """Sine of the dip (n,): the field's share along down."""
    sines: FloatArray = -np.sum(directions * force, axis=1) / np.linalg.norm(force, axis=1)
    return sines
