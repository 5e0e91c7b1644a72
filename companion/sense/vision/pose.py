"""The pad's pose from all corners of a frame at once (the robust rule beside the paper's eq. 1).

A square seen square-on has two poses that fit it alike, and square-on is exactly the landing. So the
gravity direction, which the vehicle knows, takes part: the pad is level to a few degrees. It chooses the
starting point (levelled, the pose is a similarity, which has a single, linear solution) and stays in the
fit as a weak measurement. Without it the better of the two planar solutions (IPPE) starts the fit.

A rolling shutter exposes rows one after another, so that what moves through the image is bent: sideways
motion shears it by 25 px at 0.25 m and 1 m/s, and a climb of 0.1 m/s at 0.15 m looks like a tilt of half a
degree. The fit therefore has twelve unknowns: position, rotation, and velocity and rate of turn during the
readout, which what is known of the motion bounds: a camera that turns at 0.5 rad/s sees what is 8 m off pass
at 4 m/s, and its gyroscope shows how it turns. The position holds at the time of the mean row of the
corners. The rotors' vibration is quicker than that: it moves the corners of the same rows alike, however many
they are. It is fitted too, as a shift of the image that goes to and fro at the rotors' frequencies.

The fit is Gauss-Newton (section 2's Levenberg-Marquardt; from this start it needs no damping) on the
reprojection error, each marker's corners weighted by what its sides say of them. Markers that do not agree
with the rest are dropped. Camera axes are OpenCV's.

What a pose errs by has two parts. One is new in each frame: the corners' noise, by the Jacobian. The other,
the calibration's error along and across the ray, is the same in all of them: averaging frames does not
shrink it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from companion.base.geometry import (
    ZERO3,
    FloatArray,
    Vector3,
    cross,
    matrix_from_quat,
    quat_from_rotation_vector,
    vector3,
)
from companion.config import VisionConfig
from companion.sense.vision.aruco import Detection
from companion.sense.vision.lens import NEAREST_M, Lens
from companion.sense.vision.pose_noise import (
    edge_std_px,
    shrinking,
    side_noise_px,
    unseen_m2,
    vibration,
    whitening,
)

MAXIMUM_REPROJECTION_ERROR_PX: Final = 2.0  # a marker with more is dropped

ITERATIONS: Final = 6
CONVERGED: Final = 1e-4
# a landing's speed of approach, as a share of the distance a second
APPROACH_PER_S: Final = 0.2
# the corners' stated noise is worth as much as this many observed misses
PRIOR_MISSES: Final = 20.0
# a blurred marker that is large in the image may miss by this share of its side
RELATIVE_ERROR: Final = 0.03
# a pad whose tilt is more than this many standard deviations is not our pad
MAXIMUM_TILT_SIGMA: Final = 4.0


@dataclass(frozen=True, slots=True)
class PoseFit:
    """The pad's pose as fitted, in camera axes: the pad's centre seen from the camera, and the rotation.

    `covariance` is 6x6: position (m), small rotation about camera axes (rad).
    `common_variance_m2`, of each axis of the position, is the part of it that all frames share. The pose
    holds when `row_px` is exposed.
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

    `rate` (3,) is how the camera is known to turn. `delay_s` is when each point's row is exposed, after the
    mean row; `shared` how what the rays' errors have in common (the rotors' vibration, sides that lie too far
    in) moves them. `weight` (6 + c,) holds the inverse variances of velocity, rate of turn and these.
    """

    points: FloatArray  # (n, 3)
    rays: FloatArray  # (n, 2)
    delay_s: FloatArray  # (n,)
    down: FloatArray | None  # (3,)
    whitening: FloatArray  # (2n, 2n)
    level_sigma: float
    shared: FloatArray  # (2n, c)
    weight: FloatArray
    rate: FloatArray
    focal_px: float


@dataclass(frozen=True, slots=True)
class _Fit:
    """A pose with its covariance (6, 6), each point's miss (2, n) as a ray, and the sum of the misses'
    squares.

    The latter in terms of what was expected of them.
    """

    rotation: FloatArray
    position: FloatArray
    covariance: FloatArray
    misses: FloatArray
    squares: float


def estimate_pose(
    found: list[Detection],
    lens: Lens,
    config: VisionConfig,
    down_camera: Vector3 | None,
    climb_m_s: float = 0.0,
    rate_camera_rad_s: Vector3 = ZERO3,
) -> PoseFit | None:
    """Fit one pose to all corners, dropping the worst marker while some disagree.

    Args:
        found: markers with corners in pixels.
        down_camera: gravity's direction (unit) in camera axes, or None when the attitude is unknown.
        climb_m_s: how fast the height over the pad is expected to change.
        rate_camera_rad_s: how the camera turns, in its own axes.

    Returns:
        None when no majority of the markers agrees on a level pad in front of the camera.
    """
    candidates = list(found)
    while 2 * len(candidates) > len(found):
        problem = _problem(candidates, lens, config, down_camera, climb_m_s, rate_camera_rad_s)
        fit = _fit(problem)
        if fit is None:
            return None
        errors_px = np.hypot(fit.misses[0], fit.misses[1]).reshape(-1, 4) * lens.focal_px
        limits = [max(MAXIMUM_REPROJECTION_ERROR_PX, RELATIVE_ERROR * d.side_px) for d in candidates]
        excess = np.sqrt((errors_px**2).mean(axis=1)) / limits
        if excess.max() <= 1.0:
            return None if _is_tilted(problem, fit) else _accept(problem, fit, candidates, errors_px, config)
        del candidates[int(np.argmax(excess))]
    return None


def _problem(
    detections: list[Detection],
    lens: Lens,
    config: VisionConfig,
    down_camera: Vector3 | None,
    climb_m_s: float,
    rate_camera_rad_s: Vector3,
) -> _Problem:
    pixels = np.concatenate([d.corners_px for d in detections])
    delay_s = (pixels[:, 1] - pixels[:, 1].mean()) * (lens.readout_s / lens.size_px[1])
    vibrating, rays = vibration(delay_s), lens.undistort(pixels)
    shrunk = shrinking(rays, np.array([edge_std_px(d) for d in detections]) / lens.focal_px)
    speed = config.relative_speed_std_m_s
    climb = math.hypot(_climb_std_m_s(detections, lens, config), climb_m_s)
    spread = [speed, speed, climb] + [config.turn_rate_std_rad_s] * 3
    spread += [1e-3 * config.vibration_mrad] * vibrating.shape[1] + [1.0]
    return _Problem(
        points=np.concatenate([d.corners_pad_m for d in detections]),
        rays=rays,
        delay_s=delay_s,
        down=None if down_camera is None else np.array(down_camera),
        whitening=whitening(rays, np.array([side_noise_px(d, config) for d in detections]) / lens.focal_px),
        level_sigma=math.radians(config.tilt_std_deg),
        shared=np.concatenate((vibrating, shrunk), axis=1),
        weight=np.array(spread) ** -2,
        rate=np.array(rate_camera_rad_s),
        focal_px=lens.focal_px,
    )


def _climb_std_m_s(detections: list[Detection], lens: Lens, config: VisionConfig) -> float:
    """How fast the pad may plausibly come nearer: what is near comes slowly.

    The distance is what the markers' sizes say.
    """
    distance_m = max(lens.focal_px * d.marker.side_m / d.side_px for d in detections)
    near = math.hypot(config.relative_climb_std_m_s, APPROACH_PER_S * distance_m)
    return min(near, config.relative_speed_std_m_s)


def _accept(
    problem: _Problem, fit: _Fit, used: list[Detection], errors_px: FloatArray, config: VisionConfig
) -> PoseFit:
    """The pose with its covariance: the corners' noise as observed, and what they do not show.

    The stated noise and the misses are weighed against each other: a single marker fits itself well, and many
    that miss by more or less than was stated say how large the noise is.
    """
    freedom = max(2 * len(problem.points) - 6, 0)
    scale = (PRIOR_MISSES + fit.squares) / (PRIOR_MISSES + freedom)
    common = (config.scale_error * float(np.linalg.norm(fit.position))) ** 2
    covariance = fit.covariance * scale
    unseen = unseen_m2(float(fit.position[2]), problem.delay_s, problem.focal_px)
    covariance[:3, :3] += np.eye(3) * (common + unseen)
    row_px = float(np.mean([d.corners_px[:, 1].mean() for d in used]))
    rms_px = float(np.sqrt((errors_px**2).mean()))
    return PoseFit(fit.position, fit.rotation, covariance, row_px, tuple(used), rms_px, common)


def _is_tilted(problem: _Problem, fit: _Fit) -> bool:
    if problem.down is None:
        return False
    tilt_rad = math.acos(min(1.0, max(-1.0, float(fit.rotation[:, 2] @ problem.down))))
    return tilt_rad > MAXIMUM_TILT_SIGMA * problem.level_sigma


def _fit(problem: _Problem) -> _Fit | None:
    """Gauss-Newton from the levelled or the planar start; None when there is no pad in front."""
    start = _planar_start(problem) if problem.down is None else _level_start(problem, problem.down)
    if start is None:
        return None
    rotation, position = start
    expected = np.zeros(len(problem.weight))
    expected[3:6] = -problem.rate
    expected[:3] = cross(vector3(expected[3:6]), vector3(position))
    moved = expected.copy()
    for _ in range(ITERATIONS):
        jacobian, misses = _linearised(problem, rotation, position, moved)
        white, missed = problem.whitening @ jacobian, problem.whitening @ misses
        information, gradient = _normal_equations(problem, white, missed, rotation, moved - expected)
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        position, moved = position + step[:3], moved + step[6:]
        turn = quat_from_rotation_vector(vector3(step[3:6].tolist()))
        rotation = matrix_from_quat(turn) @ rotation
        if not np.isfinite(step).all() or position[2] <= 0.0:
            return None
        if np.abs(step[:6]).max() < CONVERGED:
            break
    left = (misses - jacobian @ step).reshape(2, -1)
    squares = float(((missed - white @ step) ** 2).sum())
    covariance = np.linalg.inv(information)[:6, :6]
    return _Fit(rotation, position, 0.5 * (covariance + covariance.T), left, squares)


def _linearised(
    problem: _Problem, rotation: FloatArray, position: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Jacobian (2n, m) and misses (2n,) of the rays, all u and then all v.

    Unknowns: position, rotation (on the left), and in `moved`: velocity of the pad's origin and its rate of
    turn, and what the errors have in common.
    """
    turned = rotation @ problem.points.T
    a, b, c = turned
    vx, vy, vz, wx, wy, wz = moved[:6].tolist()
    delay = problem.delay_s
    x = a + position[0] + delay * (vx + wy * c - wz * b)
    y = b + position[1] + delay * (vy + wz * a - wx * c)
    inverse = 1.0 / np.maximum(c + position[2] + delay * (vz + wx * b - wy * a), NEAREST_M)
    u, v = x * inverse, y * inverse
    a, b, c = a * inverse, b * inverse, c * inverse
    n = len(u)
    whole = np.empty((2 * n, 12 + problem.shared.shape[1]))
    whole[:, 12:] = problem.shared
    jacobian = np.zeros((2, n, 6))
    along_u, along_v = jacobian
    # a small turn moves a point by turn x point, so a row's rotation part is point x (its position part)
    along_u[:, 0], along_u[:, 2] = inverse, -u * inverse
    along_u[:, 3], along_u[:, 4], along_u[:, 5] = -u * b, c + u * a, -b
    along_v[:, 1], along_v[:, 2] = inverse, -v * inverse
    along_v[:, 3], along_v[:, 4], along_v[:, 5] = -c - v * b, v * a, a
    whole[:, :6] = jacobian.reshape(-1, 6)
    whole[:, 6:12] = (jacobian * delay[:, None]).reshape(-1, 6)
    seen = np.concatenate((problem.rays[:, 0] - u, problem.rays[:, 1] - v))
    return whole, seen - problem.shared @ moved[6:]


def _normal_equations(
    problem: _Problem, white: FloatArray, missed: FloatArray, rotation: FloatArray, unexpected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information (m, m) and gradient (m,): the corners, gravity, and what is known of the motion.

    Of the corners it takes the Jacobian and the misses, whitened; `unexpected` is the motion beyond what is
    known of it.
    """
    information = white.T @ white
    gradient = white.T @ missed
    if problem.down is not None:
        axis, weight = rotation[:, 2], problem.level_sigma**-2
        information[3:6, 3:6] += weight * (np.eye(3) - np.outer(axis, axis))
        gradient[3:6] += weight * np.array(cross(vector3(axis), vector3(problem.down)))
    information[6:, 6:] += np.diag(problem.weight)
    gradient[6:] -= problem.weight * unexpected
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
