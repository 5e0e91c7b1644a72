"""The pad's pose from all corners of a frame at once (the robust rule beside the paper's eq. 1).

A square seen square-on has two poses that fit it alike, and square-on is exactly the landing. So the
gravity direction, which the vehicle knows, takes part: the pad is level to a few degrees. It chooses the
starting point (levelled, the pose is a similarity, which has a single, linear solution) and stays in the
fit as a weak measurement. Without it the better of the two planar solutions (IPPE) starts the fit.

A rolling shutter exposes rows one after another, so that what moves through the image is sheared: by
25 px at 0.25 m and 1 m/s. The fit therefore has eight unknowns: position, rotation, and the drift of the
image over the readout, which a plausible speed and rate of turn bound. The position holds at the time of
the mean row of the corners.

The fit is Gauss-Newton (section 2's Levenberg-Marquardt; from this start it needs no damping) on the
reprojection error. Markers that do not agree with the rest are dropped. Camera axes are OpenCV's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from companion.config import VisionConfig
from companion.geometry import FloatArray, Vector3, matrix_from_quat, quat_from_rotation_vector, vector3
from companion.sense.aruco import Detection
from companion.sense.lens import NEAREST_M, Lens

ITERATIONS: Final = 6
CONVERGED: Final = 1e-5
NO_DRIFT: Final = 1e-6
# a blurred marker that is large in the image may miss by this share of its side
RELATIVE_ERROR: Final = 0.03
# what leans from the level by more than this many standard deviations is not our pad
MAXIMUM_LEAN_SIGMA: Final = 4.0


@dataclass(frozen=True, slots=True)
class PadPose:
    """The pad in camera axes; `covariance` is 6x6: position (m), small rotation about camera axes (rad).

    The pose holds when `row_px` is exposed.
    """

    position_camera_m: FloatArray
    camera_from_pad: FloatArray
    covariance: FloatArray
    row_px: float
    used: tuple[Detection, ...]
    reprojection_error_px: float


@dataclass(frozen=True, slots=True)
class _Problem:
    """What is fitted: rays of points, gravity in camera axes if known, and how certain each thing is.

    `turns` is each point's row relative to the mean row, as a share of the image's height.
    """

    points: FloatArray  # (n, 3)
    rays: FloatArray  # (n, 2)
    turns: FloatArray  # (n,)
    down: FloatArray | None  # (3,)
    ray_sigma: float
    level_sigma: float
    readout_s: float
    speed_sigma: float
    rate_sigma: float


@dataclass(frozen=True, slots=True)
class _Fit:
    """A pose with its covariance (6, 6), and each point's miss (n,) as a ray."""

    rotation: FloatArray
    position: FloatArray
    covariance: FloatArray
    misses: FloatArray


def estimate_pose(
    found: list[Detection], lens: Lens, config: VisionConfig, down_camera: Vector3 | None
) -> PadPose | None:
    """Fit one pose to all corners, dropping the worst marker while some disagree.

    Args:
        found: markers with corners in pixels.
        down_camera: gravity's direction (unit) in camera axes, or None when the attitude is unknown.

    Returns:
        None when no majority of the markers agrees on a level pad in front of the camera.
    """
    candidates = list(found)
    while 2 * len(candidates) > len(found):
        problem = _problem(candidates, lens, config, down_camera)
        fit = _fit(problem)
        if fit is None:
            return None
        errors_px = fit.misses.reshape(-1, 4) * lens.focal_px
        limits = [max(config.maximum_reprojection_error_px, RELATIVE_ERROR * d.side_px) for d in candidates]
        excess = np.sqrt((errors_px**2).mean(axis=1)) / limits
        if excess.max() <= 1.0:
            return None if _leans(problem, fit) else _accept(fit, candidates, errors_px, config)
        del candidates[int(np.argmax(excess))]
    return None


def _problem(
    detections: list[Detection], lens: Lens, config: VisionConfig, down_camera: Vector3 | None
) -> _Problem:
    pixels = np.concatenate([d.corners_px for d in detections])
    return _Problem(
        points=np.concatenate([d.corners_pad_m for d in detections]),
        rays=lens.undistort(pixels),
        turns=(pixels[:, 1] - pixels[:, 1].mean()) / lens.size_px[1],
        down=None if down_camera is None else np.array(down_camera),
        ray_sigma=config.corner_noise_px / lens.focal_px,
        level_sigma=math.radians(config.level_std_deg),
        readout_s=lens.readout_s,
        speed_sigma=config.relative_speed_std_m_s,
        rate_sigma=config.turn_rate_std_rad_s,
    )


def _accept(fit: _Fit, used: list[Detection], errors_px: FloatArray, config: VisionConfig) -> PadPose:
    """The pose with its covariance: corner noise, and the calibration's error along and across the ray.

    Corners whose misses are larger than the noise that was assumed make the pose less certain in
    proportion; smaller misses do not make it more certain (a single marker fits itself well).
    """
    rms_px = float(np.sqrt((errors_px**2).mean()))
    worse = max(1.0, rms_px / (math.sqrt(2.0) * config.corner_noise_px))
    covariance = fit.covariance * worse**2
    covariance[:3, :3] += np.eye(3) * (config.scale_error * float(np.linalg.norm(fit.position))) ** 2
    row_px = float(np.mean([d.corners_px[:, 1].mean() for d in used]))
    return PadPose(fit.position, fit.rotation, covariance, row_px, tuple(used), rms_px)


def _leans(problem: _Problem, fit: _Fit) -> bool:
    if problem.down is None:
        return False
    lean = math.acos(min(1.0, max(-1.0, float(fit.rotation[:, 2] @ problem.down))))
    return lean > MAXIMUM_LEAN_SIGMA * problem.level_sigma


def _fit(problem: _Problem) -> _Fit | None:
    """Gauss-Newton from the levelled or the planar start; None when there is no pad in front."""
    start = _planar_start(problem) if problem.down is None else _level_start(problem, problem.down)
    if start is None:
        return None
    rotation, position = start
    drift = np.zeros(2)
    for _ in range(ITERATIONS):
        information, gradient, _ = _normal_equations(problem, rotation, position, drift)
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        position, drift = position + step[:3], drift + step[6:]
        turn = quat_from_rotation_vector(vector3(step[3:6].tolist()))
        rotation = matrix_from_quat(turn) @ rotation
        if not np.isfinite(step).all() or position[2] <= 0.0:
            return None
        if np.abs(step).max() < CONVERGED:
            break
    information, _, misses = _normal_equations(problem, rotation, position, drift)
    covariance = np.linalg.inv(information)[:6, :6]
    return _Fit(rotation, position, 0.5 * (covariance + covariance.T), misses)


def _normal_equations(
    problem: _Problem, rotation: FloatArray, position: FloatArray, drift: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information (8, 8), gradient (8,), misses (n,). Unknowns: position, rotation (on the left), drift."""
    turned = problem.points @ rotation.T
    x, y, z = (turned + position).T
    inverse = 1.0 / np.maximum(z, NEAREST_M)
    u, v = x * inverse, y * inverse
    n = len(u)
    jacobian = np.zeros((2, n, 8))
    jacobian[0, :, 0] = jacobian[1, :, 1] = inverse
    jacobian[0, :, 2] = -u * inverse
    jacobian[1, :, 2] = -v * inverse
    # a small turn moves a point by turn x point, so a row's rotation part is point x (its position part)
    a, b, c = turned.T
    for row in jacobian:
        p, q, r = row[:, 0], row[:, 1], row[:, 2]
        row[:, 3], row[:, 4], row[:, 5] = b * r - c * q, c * p - a * r, a * q - b * p
    jacobian[0, :, 6] = jacobian[1, :, 7] = problem.turns
    misses = problem.rays.T - np.stack((u, v)) - drift[:, None] * problem.turns
    stacked, weight = jacobian.reshape(2 * n, 8), problem.ray_sigma**-2
    information = weight * (stacked.T @ stacked)
    gradient = weight * (stacked.T @ misses.reshape(2 * n))
    if problem.down is not None:
        axis, level = rotation[:, 2], problem.level_sigma**-2
        information[3:6, 3:6] += level * (np.eye(3) - np.outer(axis, axis))
        gradient[3:6] += level * np.cross(axis, problem.down)
    rate = math.hypot(problem.speed_sigma / max(position[2], NEAREST_M), problem.rate_sigma)
    still = max(problem.readout_s * rate, NO_DRIFT) ** -2
    information[6, 6] += still
    information[7, 7] += still
    gradient[6:] -= still * drift
    return information, gradient, np.hypot(misses[0], misses[1])


def _level_start(problem: _Problem, down: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The pose of an exactly level pad: in levelled axes the image of the pad is a similarity.

    With the rays turned so that z is down, pad point (X, Y) at depth t_z obeys
    z u = t_x + c X - s Y, z v = t_y + s X + c Y: linear in (c, s, t_x, t_y) / t_z.
    """
    level_from_camera = _shortest_turn(down)
    levelled = np.column_stack((problem.rays, np.ones(len(problem.rays)))) @ level_from_camera.T
    if levelled[:, 2].min() < 0.05:
        return None
    u, v = levelled[:, 0] / levelled[:, 2], levelled[:, 1] / levelled[:, 2]
    x, y = problem.points[:, 0], problem.points[:, 1]
    one, zero = np.ones_like(x), np.zeros_like(x)
    equations = np.concatenate((np.column_stack((x, -y, one, zero)), np.column_stack((y, x, zero, one))))
    c, s, tx, ty = np.linalg.lstsq(equations, np.concatenate((u, v)), rcond=None)[0]
    scale = math.hypot(c, s)
    if scale < 1e-6:
        return None
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, scale]]) / scale
    position = np.array([tx, ty, 1.0]) / scale
    return level_from_camera.T @ turn, level_from_camera.T @ position


def _shortest_turn(down: FloatArray) -> FloatArray:
    """The rotation (3, 3) that takes `down` (unit, not straight up) to the z axis."""
    x, y, z = (float(value) for value in down)
    k = 1.0 / (1.0 + max(z, -0.999))
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]])


def _planar_start(problem: _Problem) -> tuple[FloatArray, FloatArray] | None:
    """The better of the two planar solutions (IPPE)."""
    solved, rotations, positions, _ = cv2.solvePnPGeneric(
        problem.points, problem.rays, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    if not solved:
        return None
    rotation, _ = cv2.Rodrigues(rotations[0])
    return np.asarray(rotation, dtype=np.float64), np.asarray(positions[0], dtype=np.float64).reshape(3)
