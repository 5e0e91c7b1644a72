"""From views of the board to the intrinsics, with outlier rejection and cross-validation. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from calibration.camera import Model
from calibration.camera.board import Surface
from calibration.camera.views import FEWEST_POINTS, BoardView, on_a_plane
from companion.base.geometry import FloatArray
from companion.sense.vision.lens import FISHEYE

FEWEST_VIEWS: Final = 2
# with fewer, the board's shape and the camera are not separable
FEWEST_VIEWS_FOR_SHAPE: Final = 6
CRITERIA: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
# the median of a Rayleigh distribution over its σ: from a typical distance to the noise of a coordinate
RAYLEIGH_MEDIAN: Final = 1.1774
# of pure noise, one corner in 25,000 is farther off than this many σ
CORNER_SIGMAS: Final = 4.5
VIEW_RATIO: Final = 3.0
# a fisheye's image from its middle to its corners, where the fit begins
HALF_ANGLES_DEG: Final = (50.0, 65.0, 80.0, 95.0)
FISHEYE_ROUNDS: Final = 4
POSE_STEPS: Final = 5

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
    read = []
    for view in views:
        fits = on_a_plane(view.points_m, view.corners_px, size_px)
        if np.count_nonzero(fits) >= FEWEST_POINTS:  # what fits no plane was misread
            read.append(view.only(fits))
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
    """Least squares over all corners: OpenCV's with a flat board, then with the board's shape."""
    fewest = FEWEST_VIEWS_FOR_SHAPE if model == "fisheye" else FEWEST_VIEWS
    if len(views) < fewest:
        raise UnsolvableError(f"{len(views)} usable views of the board; expected {fewest} or more")
    if model == "fisheye":
        return _fit_fisheye(views, size_px, board, guess)
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


def _fit_fisheye(
    views: Sequence[BoardView], size_px: tuple[int, int], board: Surface, guess: Intrinsics | None
) -> CameraSolution:
    """Least squares from a camera without distortion, of whatever angle the poses fit best.

    OpenCV's own (cv2.fisheye.calibrate) knows no bent board, and ends in an assertion where a view is poor.
    """
    width, height = size_px
    half_px = 0.5 * float(np.hypot(width, height))
    middle = (0.5 * width, 0.5 * height)
    focal = [half_px / angle for angle in np.radians(HALF_ANGLES_DEG)]
    plain = [Intrinsics(np.array((f, f, *middle, *(0.0,) * FISHEYE)), size_px) for f in focal]
    starts = []
    for camera in plain if guess is None else [guess]:
        try:
            seen = tuple(place(camera, board.flat(), view) for view in views)
        except cv2.error:
            continue  # corners that this camera does not see
        starts.append(CameraSolution(camera, board.flat(), seen))
    if not starts:
        raise UnsolvableError("the views fit no fisheye; expected another --model")
    solution = min(starts, key=lambda start: start.squares)
    for _ in range(FISHEYE_ROUNDS):
        before, solution = solution.squares, refine(solution)
        if solution.squares > (1.0 - SMALLEST_STEP) * before:
            break
    if not np.isfinite(solution.camera.numbers).all():
        raise UnsolvableError("the views do not determine the camera: its numbers are not finite")
    return solution


def place(camera: Intrinsics, surface: Surface, view: BoardView) -> PosedView:
    """Estimate the board's pose in a view, with a known camera and board."""
    if camera.model == "fisheye":
        return _place_in_fisheye(camera, surface, view)
    corners = view.corners_px.reshape(-1, 1, 2)
    _, turn, position = cv2.solvePnP(
        view.points_m, corners, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    points = surface.of(view.points_m)
    turn, position = cv2.solvePnPRefineLM(points, corners, camera.matrix, camera.distortion, turn, position)
    return seen_at(camera, surface, view, np.ravel(turn), np.ravel(position))


def _place_in_fisheye(camera: Intrinsics, surface: Surface, view: BoardView) -> PosedView:
    """The pose by rays, which a fisheye's corners weigh wrongly, then by Gauss-Newton in the image."""
    rays = camera.rays(view.corners_px).reshape(-1, 1, 2)
    eye, straight = np.eye(3), np.zeros(5)
    _, turn, position = cv2.solvePnP(view.points_m, rays, eye, straight, flags=cv2.SOLVEPNP_IPPE)
    points = surface.of(view.points_m)
    turn, position = cv2.solvePnPRefineLM(points, rays, eye, straight, turn, position)
    seen = seen_at(camera, surface, view, np.ravel(turn), np.ravel(position))
    for _ in range(POSE_STEPS):
        _, jacobian = camera.project(points, seen.turn, seen.position_m)
        step = np.linalg.lstsq(jacobian[:, :6], seen.errors_px.reshape(-1), rcond=None)[0]
        nearer = seen_at(camera, surface, view, seen.turn + step[:3], seen.position_m + step[3:])
        if nearer.rms_px >= seen.rms_px:
            break
        seen = nearer
    return seen


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


# ---------------------------------------------------------------- adjustment
# The model is eqs. 2 and 3: pixel = K distort(x/z, y/z), with distortion k1 k2 p1 p2 k3, or with the rational
# model's k4 k5 k6 after them (radial factor (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)). The
# vector of a camera's parameters is fx fy cx cy, then the distortion; a fisheye's is k1 k2 k3 k4 (`lens`).

STEPS: Final = 12
SMALLEST_STEP: Final = 1e-7  # as a share of a parameter's own uncertainty
HALVINGS: Final = 6
# eight distortion coefficients are nearly degenerate; beyond this, double precision fails
LARGEST_CONDITION: Final = 1e15
MODELS: Final[dict[int, Model]] = {5: "brown", 8: "rational", FISHEYE: "fisheye"}


class UnsolvableError(ValueError):
    """The views do not determine a camera; the text says why."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A camera's parameters: fx fy cx cy (px) and the distortion (5, 8 or 4), for images of one size."""

    numbers: FloatArray
    size_px: tuple[int, int]

    @property
    def matrix(self) -> FloatArray:
        fx, fy, cx, cy = self.numbers[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """(5,) or (8,), of a fisheye (4,)."""
        return self.numbers[4:]

    @property
    def model(self) -> Model:
        return MODELS[len(self.distortion)]

    def project(
        self, points_m: FloatArray, turn: FloatArray, position_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), and their Jacobian (2n, 6 + c): turn, position, the numbers."""
        if self.model == "fisheye":
            points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 1, 3)
            pixels, given = cv2.fisheye.projectPoints(
                points, np.array(turn), np.array(position_m), self.matrix, self.distortion
            )
            # OpenCV's order: numbers, turn, position, skew
            count = len(self.numbers)
            jacobian = np.hstack((given[:, count : count + 6], given[:, :count]))
        else:
            pixels, jacobian = cv2.projectPoints(points_m, turn, position_m, self.matrix, self.distortion)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), np.asarray(jacobian)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Ideal image coordinates (n, 2) of pixels (n, 2)."""
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        undo = cv2.fisheye.undistortPoints if self.model == "fisheye" else cv2.undistortPoints
        return np.asarray(undo(points, self.matrix, self.distortion), dtype=np.float64).reshape(-1, 2)


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
    pixels, _ = camera.project(points, turn, position_m)
    return PosedView(view, turn, position_m, view.corners_px - pixels, weight)


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
    _, jacobian = camera.project(points, seen.turn, seen.position_m)
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
    """Gauss-Newton from a good initial guess to convergence; each step is halved until the cost falls."""
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


# ---------------------------------------------------------------- weights
# A view that is near, in focus and at rest has more precise corners, and determines most of the camera. With
# equal weights the result is less precise than it could be, and its stated uncertainty is too large. So the
# weight of a view is the inverse variance of its own errors. Few corners estimate a variance poorly, so it is
# shrunk towards the common variance: more if there are fewer corners or the views are more alike (Smyth's
# empirical Bayes variances, 2004).
#
# Outliers are removed before. Weights have a lower bound, because a wrong model shows in some views more than
# in others, and those must keep their say.

WEIGHT_ROUNDS: Final = 4
SMALLEST_CHANGE: Final = 0.01  # of a weight
# a view that is farther off than this is not less sharp: the model does not fit it, which is to be seen
SMALLEST_WEIGHT: Final = 0.25
# views as like as if their common variance were known from so many errors are taken as alike
MOST_FREEDOM: Final = 1e4
FEWEST_FREEDOM: Final = 1.0
LEAST_FREEDOM: Final = 1e-3


def weighted(solution: CameraSolution) -> CameraSolution:
    """Refit with each view weighted by its own error variance."""
    for _ in range(WEIGHT_ROUNDS):
        weights = view_weights(solution)
        before = np.array([seen.weight for seen in solution.seen])
        pairs = zip(solution.seen, weights.tolist(), strict=True)
        seen = tuple(replace(view, weight=weight) for view, weight in pairs)
        solution = refine(replace(solution, seen=seen))
        if float(np.abs(weights / before - 1.0).max()) < SMALLEST_CHANGE:
            break
    return solution


def view_weights(solution: CameraSolution) -> FloatArray:
    """The weight of each view; 1 at the common variance."""
    information = [normal_equations(solution.camera, solution.surface, s).information for s in solution.seen]
    total = np.sum(information, axis=0)
    inverse = solve_scaled(total, np.eye(len(total)))
    # numbers that a view has fitted to its own errors: its pose, and its share of those that are common
    fitted = 6.0 + np.array([np.sum(inverse * share) for share in information])
    freedom = np.maximum(np.array([s.errors_px.size for s in solution.seen]) - fitted, FEWEST_FREEDOM)
    squares = np.array([np.sum(s.errors_px**2) for s in solution.seen])
    # corners without any error at all are no reason to divide by nought
    variances = np.maximum(squares / freedom, 1e-6 * np.sum(squares) / np.sum(freedom) + 1e-18)
    usual, of_usual = empirical_bayes_variance(variances, freedom)
    weights = usual * (freedom + of_usual) / (freedom * variances + of_usual * usual)
    return np.asarray(np.maximum(weights, SMALLEST_WEIGHT))


def empirical_bayes_variance(variances: FloatArray, freedom: FloatArray) -> tuple[float, float]:
    """The usual one of variances, each with so many degrees of freedom, and how many it is worth itself.

    If true variances are usual · n / χ²(n), then logarithms of those found scatter by ψ'(n/2) more than by
    the ψ'(freedom/2) of chance.
    """
    logs = np.log(variances) - digamma(0.5 * freedom) + np.log(0.5 * freedom)
    excess = float(np.var(logs, ddof=1) - np.mean(polygamma(1, 0.5 * freedom)))
    worth = MOST_FREEDOM
    if excess > float(polygamma(1, 0.5 * MOST_FREEDOM)):
        worth = brentq(lambda n: float(polygamma(1, 0.5 * n)) - excess, LEAST_FREEDOM, MOST_FREEDOM)
    return float(np.exp(np.mean(logs) + digamma(0.5 * worth) - np.log(0.5 * worth))), worth


# ---------------------------------------------------------------- uncertainty
# The usual standard deviations, σ² (JᵀJ)⁻¹ with σ from the residuals, hold when all corners err independently
# and alike. They do not. Some views are sharper than others: `weights` accounts for that. And the errors
# within a view are correlated. So the scores of the views, corrected for leverage, are compared with their
# expected variance (Bell and McCaffrey's CR2 of cluster-robust covariances, 2002). If the views disagree more
# than expected, all variances are inflated by that ratio. It is one ratio and not the whole cluster-robust
# matrix, because 25 views do not determine a matrix of 78 numbers. The bend of the board is one of the
# unknowns (see `surface`): without it, a bowed board biases the focal length by many standard deviations.

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
    rays = camera.rays(np.stack(grid, axis=-1).reshape(-1, 2))
    points = np.column_stack((rays, np.ones(len(rays))))
    _, jacobian = camera.project(points, np.zeros(3), np.zeros(3))
    basis, _ = np.linalg.qr(jacobian[:, :3])
    of_camera = jacobian[:, 6 : 6 + len(camera.numbers)]
    free = of_camera - basis @ (basis.T @ of_camera)
    variances = np.einsum("ij,jk,ik->i", free, covariance, free).reshape(-1, 2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)).reshape(MAP_SHAPE))
