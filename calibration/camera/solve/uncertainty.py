"""The uncertainty of a calibration: of the intrinsics, and of the projection over the image. Pure.

The usual standard deviations, σ² (JᵀJ)⁻¹ with σ from the residuals, hold when all corners err independently
and alike. They do not. Some views are sharper than others: `weights` accounts for that. And the errors within
a view are correlated. So the scores of the views, corrected for leverage, are compared with their expected
variance (Bell and McCaffrey's CR2 of cluster-robust covariances, 2002). If the views disagree more than
expected, all variances are inflated by that ratio. It is one ratio and not the whole cluster-robust matrix,
because 25 views do not determine a matrix of 78 numbers. The bend of the board is one of the unknowns (see
`surface`): without it, a bowed board biases the focal length by many standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calibration.camera.solve.adjustment import (
    CameraSolution,
    Intrinsics,
    UnsolvableError,
    normal_equations,
    solve_scaled,
)
from calibration.camera.solve.solving import FEWEST_VIEWS_FOR_SHAPE
from companion.base.geometry import FloatArray

# the mesh on which the projection's uncertainty is worked out: rows, columns
MAP_SHAPE: Final = (13, 21)
# the mean of a standard normal number where what is below nought counts as nought
MEAN_EXCESS: Final = 0.399


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Covariance of the camera's parameters (n, n), and its inflation because views disagree."""

    covariance: FloatArray
    stretch: float  # of variances, >= 1

    @property
    def std(self) -> FloatArray:
        """Standard deviations of the camera's parameters."""
        return np.sqrt(np.diag(self.covariance))


def uncertainty(solution: CameraSolution) -> Uncertainty:
    """The uncertainty of the camera's parameters.

    Raises:
        UnsolvableError: the views leave one of them open.
    """
    of_camera = len(solution.camera.numbers)
    count = of_camera + (solution.surface.count if len(solution.seen) >= FEWEST_VIEWS_FOR_SHAPE else 0)
    parts = [normal_equations(solution.camera, solution.surface, seen) for seen in solution.seen]
    shares = [(part.information[:count, :count], part.score[:count]) for part in parts]
    inverse = solve_scaled(np.sum([share for share, _ in shares], axis=0), np.eye(count))
    inverse = 0.5 * (inverse + inverse.T)
    errors = solution.errors_px
    freedom = errors.size - 6 * len(parts) - count
    if freedom <= 0 or not (np.diag(inverse) > 0.0).all():
        raise UnsolvableError(
            "the views leave some parameters undetermined; expected more views, and tilted ones"
        )
    variance = solution.squares / freedom
    stretch = max(1.0, _disagreement(inverse, shares) / variance)
    return Uncertainty(stretch * variance * inverse[:of_camera, :of_camera], stretch)


def _disagreement(inverse: FloatArray, shares: list[tuple[FloatArray, FloatArray]]) -> float:
    """The variance (px²) of a coordinate by the views' scores, less its mean excess by chance."""
    scale = np.sqrt(np.diag(inverse))
    root = np.linalg.cholesky(inverse / np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    pulls = []
    for information, score in shares:
        whitened = root.T @ (information * np.outer(scale, scale)) @ root
        share, axes = np.linalg.eigh(whitened)
        along = axes.T @ (root.T @ (score * scale))
        # a view that has a number to itself has no score in it
        pulls.append(float(np.sum(along**2 / np.maximum(1.0 - share, 1e-3))))
    chance = float(np.std(pulls, ddof=1) * np.sqrt(len(pulls)))
    return (float(np.sum(pulls)) - MEAN_EXCESS * chance) / len(scale)


def projection_std_px(camera: Intrinsics, covariance: FloatArray) -> FloatArray:
    """Standard deviation (px) of the projection on a mesh (`MAP_SHAPE`) over the whole image.

    A rotation of the whole camera is projected out: the mount calibration finds it, and an error of the
    principal point is mostly such a rotation.
    """
    width, height = camera.size_px
    rows, columns = MAP_SHAPE
    grid = np.meshgrid(np.linspace(0.0, width - 1.0, columns), np.linspace(0.0, height - 1.0, rows))
    pixels = np.stack(grid, axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, camera.matrix, camera.distortion).reshape(-1, 2)
    points = np.column_stack((rays, np.ones(len(rays))))
    _, jacobian = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    basis, _ = np.linalg.qr(jacobian[:, :3])
    of_camera = jacobian[:, 6 : 6 + len(camera.numbers)]
    free = of_camera - basis @ (basis.T @ of_camera)
    variances = np.einsum("ij,jk,ik->i", free, covariance, free).reshape(-1, 2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)).reshape(MAP_SHAPE))
