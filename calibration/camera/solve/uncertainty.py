"""How sure a calibration is: of the camera's numbers, and of what is seen at each place of the image. Pure.

The usual standard deviations, σ² (JᵀJ)⁻¹ with σ from the residuals, hold when all corners err independently
and alike. They do not. Some views are sharper than others: that is in their `weights`. And a view that was
moved errs as a whole: so each view's pull on the camera's numbers is compared with what it should be, the
views' scores, corrected for how far each has bent the fit towards itself (Bell and McCaffrey's CR2 of
cluster-robust covariances, 2002). Where views disagree more than they should, all variances are stretched
by that ratio. One ratio, and not the whole cluster-robust matrix, because 25 views do not tell a matrix of
78 numbers. The board's bend is one of the unknowns (see `surface`): without it the focal length of a bowed
board is wrong by many of its own deviations.
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
    """Covariance of the camera's numbers (n, n), and what it was stretched by because views disagree."""

    covariance: FloatArray
    stretch: float  # of variances, >= 1

    @property
    def std(self) -> FloatArray:
        """Standard deviations of the camera's numbers."""
        return np.sqrt(np.diag(self.covariance))


def uncertainty(solution: CameraSolution) -> Uncertainty:
    """How sure the camera's numbers are.

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
            "the views leave some of the camera's numbers open; expected more, and tilted ones"
        )
    variance = solution.squares / freedom
    stretch = max(1.0, _disagreement(inverse, shares) / variance)
    return Uncertainty(stretch * variance * inverse[:of_camera, :of_camera], stretch)


def _disagreement(inverse: FloatArray, shares: list[tuple[FloatArray, FloatArray]]) -> float:
    """The variance (px²) of a coordinate that the views' pulls on the shared numbers speak of.

    Less what chance adds to it on average where, as here, what is below the usual variance counts as that.
    """
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
    """How far off (px, standard deviation) what is seen at each place of the image may be: `MAP_SHAPE`.

    On a mesh over the whole image. A turn of the camera as a whole is taken out: that is the mounting's to
    find, and a principal point that is off is mostly such a turn.
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
