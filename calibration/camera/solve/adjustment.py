"""Bundle adjustment of the intrinsics, the board's poses, and the board's shape. Pure.

The model is eqs. 2 and 3: pixel = K distort(x/z, y/z), with distortion k1 k2 p1 p2 k3, or with the rational
model's k4 k5 k6 after them (radial factor (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)). The
vector of a camera's parameters is fx fy cx cy, then the distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calibration.camera.board.surface import Surface
from calibration.camera.kinds import Model
from calibration.camera.views.detection import BoardView
from companion.base.geometry import FloatArray

STEPS: Final = 12
SMALLEST_STEP: Final = 1e-7  # as a share of a parameter's own uncertainty
HALVINGS: Final = 6
# eight distortion coefficients are nearly degenerate; beyond this, double precision fails
LARGEST_CONDITION: Final = 1e15


class UnsolvableError(ValueError):
    """The views do not determine a camera; the text says why."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A camera's parameters: fx fy cx cy (px) and the distortion (5 or 8), for images of one size."""

    numbers: FloatArray
    size_px: tuple[int, int]

    @property
    def matrix(self) -> FloatArray:
        """K (3, 3)."""
        fx, fy, cx, cy = self.numbers[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """(5,) or (8,)."""
        return self.numbers[4:]

    @property
    def model(self) -> Model:
        """The distortion model."""
        return "brown" if len(self.distortion) == 5 else "rational"


@dataclass(frozen=True, slots=True)
class PosedView:
    """A view with the board's pose: rotation vector (3,), and position in camera axes (3,) in m."""

    view: BoardView
    turn: FloatArray
    position_m: FloatArray
    errors_px: FloatArray  # (n, 2), measured minus projected
    weight: float = 1.0  # of its squared errors relative to other views

    @property
    def rms_px(self) -> float:
        """Root mean square of the errors' lengths."""
        return rms(self.errors_px)


@dataclass(frozen=True, slots=True)
class CameraSolution:
    """A calibrated camera, the board's estimated shape, the views used, and what was left out."""

    camera: Intrinsics
    surface: Surface
    seen: tuple[PosedView, ...]
    dropped_views: tuple[str, ...] = ()
    dropped_corners: int = 0

    @property
    def errors_px(self) -> FloatArray:
        """Reprojection errors of all corners used (n, 2)."""
        return np.concatenate([s.errors_px for s in self.seen])

    @property
    def squares(self) -> float:
        """The cost: the squared errors, weighted by view (px²)."""
        return sum(s.weight * float(np.sum(s.errors_px**2)) for s in self.seen)


def rms(errors: FloatArray) -> float:
    """Root mean square length of vectors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def seen_at(
    camera: Intrinsics,
    surface: Surface,
    view: BoardView,
    turn: FloatArray,
    position_m: FloatArray,
    weight: float = 1.0,
) -> PosedView:
    """A view with its reprojection errors at a pose."""
    points = surface.of(view.points_m)
    pixels, _ = cv2.projectPoints(points, turn, position_m, camera.matrix, camera.distortion)
    return PosedView(view, turn, position_m, view.corners_px - np.asarray(pixels).reshape(-1, 2), weight)


@dataclass(frozen=True, slots=True)
class ViewEquations:
    """A view's normal equations in the shared parameters (camera, then surface), its pose eliminated.

    `information` (n, n) and `score` (n,) are its part of the normal equations; `pose_step` (6,) and
    `pose_change` (6, n) give the step of its pose for a step of the shared parameters.
    """

    information: FloatArray
    score: FloatArray
    pose_step: FloatArray
    pose_change: FloatArray


def normal_equations(camera: Intrinsics, surface: Surface, seen: PosedView) -> ViewEquations:
    """A view's part of the normal equations, its pose eliminated."""
    points = surface.of(seen.view.points_m)
    _, jacobian = cv2.projectPoints(points, seen.turn, seen.position_m, camera.matrix, camera.distortion)
    of_pose, of_camera = jacobian[:, :6], jacobian[:, 6 : 6 + len(camera.numbers)]
    # a point's motion on the board, rotated into camera axes
    rotation, _ = cv2.Rodrigues(seen.turn)
    of_point = (jacobian[:, 3:6] @ rotation).reshape(-1, 2, 3)
    of_surface = (of_point @ surface.shapes(seen.view.points_m)).reshape(-1, surface.count)
    shared = np.hstack((of_camera, of_surface))
    errors = seen.errors_px.reshape(-1)
    basis, triangle = np.linalg.qr(of_pose)
    free = shared - basis @ (basis.T @ shared)
    back = np.linalg.pinv(triangle)
    information, score = seen.weight * (free.T @ free), seen.weight * (free.T @ errors)
    return ViewEquations(information, score, back @ (basis.T @ errors), back @ (basis.T @ shared))


def refine(solution: CameraSolution) -> CameraSolution:
    """Gauss-Newton from a good initial guess to convergence; each step is halved until the cost falls.

    Raises:
        UnsolvableError: the views leave some of the parameters undetermined.
    """
    for _ in range(STEPS):
        parts = [normal_equations(solution.camera, solution.surface, seen) for seen in solution.seen]
        information = np.sum([part.information for part in parts], axis=0)
        score = np.sum([part.score for part in parts], axis=0)
        step = solve_scaled(information, score)
        solution, moved = _stepped(solution, parts, step)
        if not moved or float(step @ information @ step) < SMALLEST_STEP * solution.squares:
            break
    return solution


def solve_scaled(information: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a normal matrix whose parameters have different units.

    Raises:
        UnsolvableError: it is singular.
    """
    scale = np.sqrt(np.diag(information))
    scaled = information / np.outer(scale, scale) if (scale > 0.0).all() else None
    if scaled is None or not np.isfinite(scaled).all() or np.linalg.cond(scaled) > LARGEST_CONDITION:
        raise UnsolvableError(
            "the views leave some parameters undetermined; expected more views, and tilted ones"
        )
    solved = np.linalg.solve(scaled, (right.T / scale).T)
    return np.asarray((solved.T / scale).T)


def _stepped(
    solution: CameraSolution, parts: list[ViewEquations], step: FloatArray
) -> tuple[CameraSolution, bool]:
    """The solution after a step, or unchanged if no share of the step lowers the cost."""
    count = len(solution.camera.numbers)
    before = solution.squares
    for halving in range(HALVINGS):
        share = 0.5**halving
        camera = Intrinsics(solution.camera.numbers + share * step[:count], solution.camera.size_px)
        surface = solution.surface.stepped(share * step[count:])
        seen = []
        for old, part in zip(solution.seen, parts, strict=True):
            pose = share * (part.pose_step - part.pose_change @ step)
            turn, position = old.turn + pose[:3], old.position_m + pose[3:]
            seen.append(seen_at(camera, surface, old.view, turn, position, old.weight))
        new = CameraSolution(camera, surface, tuple(seen))
        if new.squares <= before:
            return new, True
    return solution, False
