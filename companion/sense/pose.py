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
reprojection error, each marker's corners weighted by what its sides say of them. Markers that do not agree with
the rest are dropped. Camera axes are OpenCV's.

What a pose errs by has two parts. One is new in each frame: the corners' noise, by the Jacobian. The other, the
calibration's error along and across the ray, is the same in all of them: averaging frames does not shrink it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from companion.config import VisionConfig
from companion.geometry import (
    FloatArray,
    Vector3,
    cross,
    matrix_from_quat,
    quat_from_rotation_vector,
    vector3,
)
from companion.sense.aruco import Detection
from companion.sense.lens import NEAREST_M, Lens

ITERATIONS: Final = 6
CONVERGED: Final = 1e-4
# the corners' stated noise is worth as much as this many observed misses
PRIOR_MISSES: Final = 20.0
NO_DRIFT: Final = 1e-6
# a blurred marker that is large in the image may miss by this share of its side
RELATIVE_ERROR: Final = 0.03
# what leans from the level by more than this many standard deviations is not our pad
MAXIMUM_LEAN_SIGMA: Final = 4.0


@dataclass(frozen=True, slots=True)
class PadPose:
    """The pad in camera axes; `covariance` is 6x6: position (m), small rotation about camera axes (rad).

    `common_variance_m2`, of each axis of the position, is the part of it that all frames share. The pose holds
    when `row_px` is exposed.
    """

    position_camera_m: FloatArray
    camera_from_pad: FloatArray
    covariance: FloatArray
    row_px: float
    used: tuple[Detection, ...]
    reprojection_error_px: float
    common_variance_m2: float = 0.0


@dataclass(frozen=True, slots=True)
class _Problem:
    """What is fitted: rays of points on the pad, gravity in camera axes if known, how certain each thing is.

    `turns` is each point's row relative to the mean row, as a share of the image's height.
    """

    points: FloatArray  # (n, 3)
    rays: FloatArray  # (n, 2)
    turns: FloatArray  # (n,)
    down: FloatArray | None  # (3,)
    ray_sigma: FloatArray  # (n,) in each direction
    level_sigma: float
    readout_s: float
    speed_sigma: float
    rate_sigma: float


@dataclass(frozen=True, slots=True)
class _Fit:
    """A pose with its covariance (6, 6), and each point's miss (2, n) as a ray."""

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
        errors_px = np.hypot(fit.misses[0], fit.misses[1]).reshape(-1, 4) * lens.focal_px
        limits = [max(config.maximum_reprojection_error_px, RELATIVE_ERROR * d.side_px) for d in candidates]
        excess = np.sqrt((errors_px**2).mean(axis=1)) / limits
        if excess.max() <= 1.0:
            return None if _leans(problem, fit) else _accept(problem, fit, candidates, errors_px, config)
        del candidates[int(np.argmax(excess))]
    return None


def _problem(
    detections: list[Detection], lens: Lens, config: VisionConfig, down_camera: Vector3 | None
) -> _Problem:
    pixels = np.concatenate([d.corners_px for d in detections])
    noise_px = [math.hypot(config.corner_noise_px, d.corner_std_px) for d in detections]
    return _Problem(
        points=np.concatenate([d.corners_pad_m for d in detections]),
        rays=lens.undistort(pixels),
        turns=(pixels[:, 1] - pixels[:, 1].mean()) / lens.size_px[1],
        down=None if down_camera is None else np.array(down_camera),
        ray_sigma=np.repeat(noise_px, 4) / lens.focal_px,
        level_sigma=math.radians(config.level_std_deg),
        readout_s=lens.readout_s,
        speed_sigma=config.relative_speed_std_m_s,
        rate_sigma=config.turn_rate_std_rad_s,
    )


def _accept(
    problem: _Problem, fit: _Fit, used: list[Detection], errors_px: FloatArray, config: VisionConfig
) -> PadPose:
    """The pose with its covariance: the corners' noise as observed, and the calibration's error.

    The stated noise and the misses are weighed against each other: a single marker fits itself well, and many
    that miss by more or less than was stated say how large the noise is.
    """
    squares = float(((fit.misses / problem.ray_sigma) ** 2).sum())
    freedom = max(2 * len(problem.points) - 6, 0)
    scale = (PRIOR_MISSES + squares) / (PRIOR_MISSES + freedom)
    common = (config.scale_error * float(np.linalg.norm(fit.position))) ** 2
    covariance = fit.covariance * scale
    covariance[:3, :3] += np.eye(3) * common
    row_px = float(np.mean([d.corners_px[:, 1].mean() for d in used]))
    rms_px = float(np.sqrt((errors_px**2).mean()))
    return PadPose(fit.position, fit.rotation, covariance, row_px, tuple(used), rms_px, common)


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
        jacobian, misses = _linearised(problem, rotation, position, drift)
        information, gradient = _normal_equations(problem, jacobian, misses, rotation, position, drift)
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
    misses = misses - (jacobian @ step).reshape(2, -1)
    covariance = np.linalg.inv(information)[:6, :6]
    return _Fit(rotation, position, 0.5 * (covariance + covariance.T), misses)


def _linearised(
    problem: _Problem, rotation: FloatArray, position: FloatArray, drift: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Jacobian (2n, 8) and misses (2, n) of the rays. Unknowns: position, rotation (on the left), drift."""
    turned = rotation @ problem.points.T
    inverse = 1.0 / np.maximum(turned[2] + position[2], NEAREST_M)
    u, v = (turned[0] + position[0]) * inverse, (turned[1] + position[1]) * inverse
    n = len(u)
    a, b, c = turned * inverse
    jacobian = np.zeros((2, n, 8))
    along_u, along_v = jacobian
    # a small turn moves a point by turn x point, so a row's rotation part is point x (its position part)
    along_u[:, 0], along_u[:, 2] = inverse, -u * inverse
    along_u[:, 3], along_u[:, 4], along_u[:, 5] = -u * b, c + u * a, -b
    along_v[:, 1], along_v[:, 2] = inverse, -v * inverse
    along_v[:, 3], along_v[:, 4], along_v[:, 5] = -c - v * b, v * a, a
    along_u[:, 6] = along_v[:, 7] = problem.turns
    misses = problem.rays.T - np.stack((u, v)) - drift[:, None] * problem.turns
    return jacobian.reshape(2 * n, 8), misses


def _normal_equations(
    problem: _Problem,
    jacobian: FloatArray,
    misses: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    drift: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Information (8, 8) and gradient (8,): the corners, gravity, and how far a plausible motion drifts."""
    weighted = jacobian * np.tile(problem.ray_sigma**-2, 2)[:, None]
    information = weighted.T @ jacobian
    gradient = weighted.T @ misses.reshape(-1)
    if problem.down is not None:
        axis, level = rotation[:, 2], problem.level_sigma**-2
        information[3:6, 3:6] += level * (np.eye(3) - np.outer(axis, axis))
        gradient[3:6] += level * np.array(cross(vector3(axis), vector3(problem.down)))
    rate = math.hypot(problem.speed_sigma / max(float(position[2]), NEAREST_M), problem.rate_sigma)
    still = max(problem.readout_s * rate, NO_DRIFT) ** -2
    information[6, 6] += still
    information[7, 7] += still
    gradient[6:] -= still * drift
    return information, gradient


def _level_start(problem: _Problem, down: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The pose of an exactly level pad: in levelled axes the image of the pad is a similarity.

    With the rays turned so that z is down, pad point (X, Y) at depth t_z obeys
    z u = t_x + c X - s Y, z v = t_y + s X + c Y: as complex numbers w = t + k p, with p = X + iY, all over
    t_z, and k by least squares about the means.
    """
    level_from_camera = _shortest_turn(down)
    levelled = problem.rays @ level_from_camera[:, :2].T + level_from_camera[:, 2]
    if levelled[:, 2].min() < 0.05:
        return None
    seen = (levelled[:, 0] + 1j * levelled[:, 1]) / levelled[:, 2]
    printed = problem.points[:, 0] + 1j * problem.points[:, 1]
    mean_seen, mean_printed = complex(seen.mean()), complex(printed.mean())
    about = printed - mean_printed
    k = complex(np.vdot(about, seen - mean_seen) / np.vdot(about, about).real)
    scale = abs(k)
    if scale < 1e-6:
        return None
    t = mean_seen - k * mean_printed
    c, s = k.real / scale, k.imag / scale
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    position = np.array([t.real, t.imag, 1.0]) / scale
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
