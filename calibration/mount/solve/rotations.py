"""Rotations by the thousand: exponential and logarithm of rotation vectors, as arrays.

`companion.base.geometry` decides order and sign; these are the same functions over a leading axis.
"""

from __future__ import annotations

import numpy as np

from companion.base.geometry import FloatArray

SMALL_RAD = 1e-6


def skew(v: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) with skew(v) u = v x u, of vectors (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def exp(v: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    safe = np.maximum(angle, SMALL_RAD)
    near = angle < SMALL_RAD
    first = np.where(near, 1.0, np.sin(safe) / safe)
    second = np.where(near, 0.5, (1.0 - np.cos(safe)) / safe**2)
    k = skew(v)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def log(matrices: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), the shortest way, of rotation matrices (..., 3, 3).

    By the antisymmetric part: exact to a thousandth of a degree of half a turn, where the axis is lost.
    """
    across = 0.5 * np.stack(
        (
            matrices[..., 2, 1] - matrices[..., 1, 2],
            matrices[..., 0, 2] - matrices[..., 2, 0],
            matrices[..., 1, 0] - matrices[..., 0, 1],
        ),
        axis=-1,
    )
    sine = np.linalg.norm(across, axis=-1)
    cosine = 0.5 * (np.trace(matrices, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > SMALL_RAD, angle / np.maximum(sine, SMALL_RAD), 1.0)
    return np.asarray(across * factor[..., None])


def transposed(matrices: FloatArray) -> FloatArray:
    """The inverses of rotation matrices (..., 3, 3)."""
    return np.swapaxes(matrices, -1, -2)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation (3, 3) that maximises trace(R' matrix) (Kabsch; Umeyama's sign)."""
    u, _, vt = np.linalg.svd(matrix)
    turn = np.diag((1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))))
    return np.asarray(u @ turn @ vt)
