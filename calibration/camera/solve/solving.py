"""From views of the board to the intrinsics, with outlier rejection and cross-validation. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np

from calibration.camera.board.surface import Surface
from calibration.camera.kinds import Model
from calibration.camera.solve.adjustment import (
    CameraSolution,
    Intrinsics,
    PosedView,
    UnsolvableError,
    refine,
    rms,
    seen_at,
)
from calibration.camera.solve.weights import weighted
from calibration.camera.views.detection import FEWEST_POINTS, BoardView, on_a_plane
from companion.base.geometry import FloatArray

FEWEST_VIEWS: Final = 2
# with fewer, the board's shape and the camera are not separable
FEWEST_VIEWS_FOR_SHAPE: Final = 6
CRITERIA: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
# the median of a Rayleigh distribution over its σ: from a typical distance to the noise of a coordinate
RAYLEIGH_MEDIAN: Final = 1.1774
# of pure noise, one corner in 25,000 is farther off than this many σ
CORNER_SIGMAS: Final = 4.5
VIEW_RATIO: Final = 3.0
ROUNDS: Final = 8
FOLDS: Final = 5


def solve(
    views: Sequence[BoardView], size_px: tuple[int, int], board: Surface, model: Model = "brown"
) -> CameraSolution:
    """Calibrate, leaving out corners and whole views that do not fit the rest.

    Args:
        views: the board in several images, each of another name.
        size_px: width and height of the images.
        board: as specified.
        model: of the distortion.

    Raises:
        UnsolvableError: too few views, or views that do not determine the camera.
    """
    read = [v for v in (_without_misread(view, size_px) for view in views) if v is not None]
    kept = read
    solution = fit(kept, size_px, board, model)
    for _ in range(ROUNDS):
        before, kept = kept, _without_outliers(solution, read)
        if _same(before, kept):
            break
        solution = fit(kept, size_px, board, model, solution.camera)
    # not before: what does not fit would count for less, fit even less, and in the end be left out
    if len(kept) >= FEWEST_VIEWS_FOR_SHAPE:
        solution = weighted(solution)
    names = {s.view.name for s in solution.seen}
    corners = sum(len(v.ids) for v in views if v.name in names) - len(solution.errors_px)
    dropped = tuple(v.name for v in views if v.name not in names)
    return replace(solution, dropped_views=dropped, dropped_corners=corners)


def fit(
    views: Sequence[BoardView],
    size_px: tuple[int, int],
    board: Surface,
    model: Model,
    guess: Intrinsics | None = None,
) -> CameraSolution:
    """Least squares over all corners: OpenCV's with a flat board, then with the board's shape.

    Raises:
        UnsolvableError: as `solve`.
    """
    if len(views) < FEWEST_VIEWS:
        raise UnsolvableError(f"{len(views)} usable views of the board; expected {FEWEST_VIEWS} or more")
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational" else 0
    matrix: Any = np.eye(3)
    distortion: Any = np.zeros(8 if model == "rational" else 5)
    if guess is not None:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        matrix, distortion = guess.matrix, guess.distortion.copy()
    points = [v.points_m.astype(np.float32) for v in views]
    corners = [v.corners_px.astype(np.float32).reshape(-1, 1, 2) for v in views]
    try:
        _, matrix, distortion, turns, positions = cv2.calibrateCamera(
            points, corners, size_px, matrix, distortion, flags=flags, criteria=CRITERIA
        )
    except cv2.error as error:
        raise UnsolvableError(
            "the views do not determine the camera; expected the board tilted to several sides"
        ) from error
    count = 8 if model == "rational" else 5
    numbers = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:count]])
    if not np.isfinite(numbers).all() or not (numbers[:2] > 0.0).all():
        raise UnsolvableError(
            "the views do not determine the camera: the focal length is not a positive number"
        )
    camera, surface = Intrinsics(numbers, size_px), board.flat()
    posed = zip(views, turns, positions, strict=True)
    seen = tuple(seen_at(camera, surface, v, np.ravel(t), np.ravel(p)) for v, t, p in posed)
    flat = CameraSolution(camera, surface, seen)
    return refine(flat) if len(views) >= FEWEST_VIEWS_FOR_SHAPE else flat


def place(camera: Intrinsics, surface: Surface, view: BoardView) -> PosedView:
    """Estimate the board's pose in a view, with a known camera and board."""
    corners = view.corners_px.reshape(-1, 1, 2)
    _, turn, position = cv2.solvePnP(
        view.points_m, corners, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    points = surface.of(view.points_m)
    turn, position = cv2.solvePnPRefineLM(points, corners, camera.matrix, camera.distortion, turn, position)
    return seen_at(camera, surface, view, np.ravel(turn), np.ravel(position))


def rms_of_all(solution: CameraSolution, views: Sequence[BoardView]) -> float:
    """Reprojection error of all detected corners, outliers included (px)."""
    return rms(np.concatenate([seen.errors_px for seen in _posed(solution, views)]))


def held_out_rms_px(solution: CameraSolution) -> float | None:
    """Reprojection error by five-fold cross-validation; None with too few views.

    Only the board's pose is fitted to a held-out view.
    """
    views = [s.view for s in solution.seen]
    camera = solution.camera
    if len(views) < FOLDS:
        return None
    errors: list[FloatArray] = []
    for k in range(FOLDS):
        rest = [v for i, v in enumerate(views) if i % FOLDS != k]
        try:
            other = fit(rest, camera.size_px, solution.surface, camera.model, camera)
            other = weighted(other) if len(rest) >= FEWEST_VIEWS_FOR_SHAPE else other
        except UnsolvableError:
            return None
        errors += [place(other.camera, other.surface, v).errors_px for v in views[k::FOLDS]]
    return rms(np.concatenate(errors))


# ---------------------------------------------------------------- outliers


def _without_misread(view: BoardView, size_px: tuple[int, int]) -> BoardView | None:
    """The view without corners that fit no plane."""
    fits = on_a_plane(view.points_m, view.corners_px, size_px)
    return view.only(fits) if np.count_nonzero(fits) >= FEWEST_POINTS else None


def _posed(solution: CameraSolution, views: Sequence[BoardView]) -> Iterator[PosedView]:
    """Whole views at the solution's poses; a view that is not part of it gets its pose with its camera."""
    poses = {s.view.name: s for s in solution.seen}
    for view in views:
        known = poses.get(view.name) or place(solution.camera, solution.surface, view)
        yield seen_at(solution.camera, solution.surface, view, known.turn, known.position_m)


def _without_outliers(solution: CameraSolution, views: Sequence[BoardView]) -> list[BoardView]:
    """The views without outlier views and outlier corners.

    All are judged again each time: an outlier of the first, rough camera may fit a better one.
    """
    usual = float(np.median([s.rms_px for s in solution.seen]))
    kept = []
    for seen in _posed(solution, views):
        lengths = np.linalg.norm(seen.errors_px, axis=1)
        # the view's own noise counts where it is larger: a blurred view has no outliers by that alone
        noise = float(max(np.median(lengths), 0.5 * usual)) / RAYLEIGH_MEDIAN
        fits = lengths < CORNER_SIGMAS * noise
        if np.count_nonzero(fits) >= FEWEST_POINTS and rms(seen.errors_px[fits]) <= VIEW_RATIO * usual:
            kept.append(seen.view.only(fits))
    return kept


def _same(some: Sequence[BoardView], others: Sequence[BoardView]) -> bool:
    """Whether two selections of the same views have the same corners."""
    return [(v.name, v.ids.tolist()) for v in some] == [(v.name, v.ids.tolist()) for v in others]
