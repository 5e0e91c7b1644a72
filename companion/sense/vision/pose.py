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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from companion.base.geometry import (
    EYE3,
    ZERO3,
    FloatArray,
    Vector3,
    cross,
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotation_vector,
    rotation_vector_from_quat,
    vector3,
)
from companion.config import VisionConfig
from companion.sense.vision.aruco import Detection
from companion.sense.vision.edges import ComplexArray, normals
from companion.sense.vision.lens import NEAREST_M, Lens
from companion.sense.vision.pose_noise import (
    corner_covariance_px2,
    edge_std_px,
    shrinking,
    side_noise_px,
    unseen_m2,
    vibration,
    whitening,
)
from companion.sense.vision.pose_start import Start, level_start, planar_starts

MAXIMUM_REPROJECTION_ERROR_PX: Final = 2.0  # a marker with more is dropped

ITERATIONS: Final = 6
CONVERGED: Final = 1e-4
# a landing's speed of approach, as a share of the distance a second
APPROACH_PER_S: Final = 0.2
# the corners' stated noise is worth as much as this many observed misses
PRIOR_MISSES: Final = 20.0
# a blurred marker that is large in the image may miss by this share of its side
RELATIVE_ERROR: Final = 0.03
# what fits worse than the best by more than this many standard deviations is ruled out
RULED_OUT_SIGMA: Final = 4.0
# how far the pad's normal is turned, in standard deviations, to see if misses grow as the covariance says
TURNED_SIGMA: Final = (-4.0, 4.0)
# about the fit's own covariance, and about what came of it
ROUNDS: Final = 2
# and is the same when it is turned by less
SAME_RAD: Final = 0.002
# a pose that may be turned by more than this, one standard deviation, says nothing
MAXIMUM_TURN_RAD: Final = math.radians(10.0)
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
    mean row, `row_px`; `shared` how what the rays' errors have in common (the rotors' vibration, sides that
    lie too far in) moves them. `weight` (6 + c,) holds the inverse variances of velocity, rate of turn and
    these.
    """

    points: FloatArray  # (n, 3)
    rays: FloatArray  # (n, 2)
    row_px: float
    delay_s: FloatArray  # (n,)
    down: FloatArray | None  # (3,)
    whitening: FloatArray  # (2n, 2n)
    level_sigma: float
    shared: FloatArray  # (c, 2, n)
    weight: FloatArray
    rate: FloatArray
    focal_px: float
    slopes: FloatArray | None  # (n, 2, 2) d pixel / d ray, of a fisheye; else it is the focal length


@dataclass(frozen=True, slots=True)
class _Fit:
    """A pose with its covariance (6, 6), each point's miss (2, n) as a ray, and the sum of the squares of the
    misses and of the motion that it takes, in terms of what was expected of them.
    """

    rotation: FloatArray
    position: FloatArray
    covariance: FloatArray
    misses: FloatArray
    squares: float


@dataclass(frozen=True, slots=True)
class PoseFits:
    """What the corners fit.

    `hypotheses` are the best pose and, where gravity does not choose, a second one that fits about as well:
    each with the fit's own covariance, which takes the corners' moves for straight and the other for ruled
    out.
    """

    hypotheses: tuple[PoseFit, ...]
    problem: _Problem
    fits: tuple[_Fit, ...]

    def pose(self) -> PoseFit:
        """The best one, in whose covariance no pose is farther off than it fits worse."""
        best, problem = self.hypotheses[0], self.problem
        if problem.down is not None:
            return best
        curvature = _curvature(problem, list(self.fits), _scale(self.fits[0], problem))
        return replace(best, covariance=best.covariance + curvature)


def estimate_pose(
    found: list[Detection],
    lens: Lens,
    config: VisionConfig,
    down_camera: Vector3 | None,
    climb_m_s: float = 0.0,
    rate_camera_rad_s: Vector3 = ZERO3,
) -> PoseFit | None:
    """The pose that fits all corners: see `fit_poses`."""
    fits = fit_poses(found, lens, config, down_camera, climb_m_s, rate_camera_rad_s)
    return None if fits is None else fits.pose()


def fit_poses(
    found: list[Detection],
    lens: Lens,
    config: VisionConfig,
    down_camera: Vector3 | None,
    climb_m_s: float = 0.0,
    rate_camera_rad_s: Vector3 = ZERO3,
    near: Sequence[PoseFit] = (),
) -> PoseFits | None:
    """Fit one pose to all corners, dropping the worst marker while some disagree.

    Args:
        found: markers with corners in pixels.
        down_camera: gravity's direction (unit) in camera axes, or None when the attitude is unknown.
        climb_m_s: how fast the height over the pad is expected to change.
        rate_camera_rad_s: how the camera turns, in its own axes.
        near: poses that some of the corners have given; without them it begins with what all of them show.

    Returns:
        None when no majority of the markers agrees on a level pad in front of the camera.
    """
    candidates = list(found)
    while 2 * len(candidates) > len(found):
        problem = _problem(candidates, lens, config, down_camera, climb_m_s, rate_camera_rad_s)
        fits = _fits(problem, near)
        if not fits:
            return None
        fit = fits[0]
        errors_px = _errors_px(problem, fit.misses).reshape(-1, 4)
        limits = [max(MAXIMUM_REPROJECTION_ERROR_PX, RELATIVE_ERROR * d.side_px) for d in candidates]
        excess = np.sqrt((errors_px**2).mean(axis=1)) / limits
        if excess.max() <= 1.0:
            return None if _is_tilted(problem, fit) else _accept(problem, fits, candidates, errors_px, config)
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
    row_px = float(pixels[:, 1].sum()) / len(pixels)
    delay_s = (pixels[:, 1] - row_px) * (lens.readout_s / lens.size_px[1])
    vibrating, rays = vibration(delay_s), lens.undistort(pixels)
    slopes = lens.slopes(rays) if lens.fisheye else None
    shrunk_px = np.array([edge_std_px(d) for d in detections])
    normal = normals((rays if slopes is None else pixels).reshape(-1, 4, 2))
    if slopes is None:
        shrunk = shrinking(normal, shrunk_px / lens.focal_px)
    else:
        shrunk = np.asarray(np.linalg.solve(slopes, shrinking(normal, shrunk_px)[..., None])[..., 0], float)
    speed = config.relative_speed_std_m_s
    climb = math.hypot(_climb_std_m_s(detections, lens, config), climb_m_s)
    spread = [speed, speed, climb] + [config.turn_rate_std_rad_s] * 3
    spread += [1e-3 * config.vibration_mrad] * vibrating.shape[1] + [1.0]
    return _Problem(
        points=np.concatenate([d.corners_pad_m for d in detections]),
        rays=rays,
        row_px=row_px,
        delay_s=delay_s,
        down=None if down_camera is None else np.array(down_camera),
        whitening=_whitening(detections, normal, slopes, lens, config),
        level_sigma=math.radians(config.tilt_std_deg),
        shared=np.concatenate((vibrating.T.reshape(-1, 2, len(rays)), shrunk.T[None])),
        weight=np.array(spread) ** -2,
        rate=np.array(rate_camera_rad_s),
        focal_px=lens.focal_px,
        slopes=slopes,
    )


def _whitening(
    detections: list[Detection],
    normal: ComplexArray,
    slopes: FloatArray | None,
    lens: Lens,
    config: VisionConfig,
) -> FloatArray:
    """By what each marker's sides, or its whole print, say of how its corners err in the image.

    `normal` (m, 4) are the sides' normals: of the rays, or with `slopes` of the pixels.
    """
    sigma = np.array([side_noise_px(d, config) for d in detections])
    covariances = [corner_covariance_px2(d, config) for d in detections]
    if slopes is None:
        scaled = [None if each is None else each / lens.focal_px**2 for each in covariances]
        return whitening(normal, sigma / lens.focal_px, scaled)
    n = normal.size
    white = whitening(normal, sigma, covariances)
    in_u, in_v = white[:, :n], white[:, n:]
    return np.hstack([in_u * slopes[:, 0, k] + in_v * slopes[:, 1, k] for k in (0, 1)])


def _errors_px(problem: _Problem, misses: FloatArray) -> FloatArray:
    """The lengths (n,) in the image of misses (2, n) of the rays."""
    if problem.slopes is None:
        return np.asarray(np.hypot(misses[0], misses[1]) * problem.focal_px)
    return np.asarray(np.linalg.norm(problem.slopes @ misses.T[..., None], axis=(1, 2)))


def _climb_std_m_s(detections: list[Detection], lens: Lens, config: VisionConfig) -> float:
    """How fast the pad may plausibly come nearer: what is near comes slowly.

    The distance is what the markers' sizes say.
    """
    distance_m = max(lens.focal_px * d.marker.side_m / d.side_px for d in detections)
    near = math.hypot(config.relative_climb_std_m_s, APPROACH_PER_S * distance_m)
    return min(near, config.relative_speed_std_m_s)


def _accept(
    problem: _Problem, fits: list[_Fit], used: list[Detection], errors_px: FloatArray, config: VisionConfig
) -> PoseFits:
    """Poses with their covariances: the corners' noise as observed, and what they do not show."""
    scale = _scale(fits[0], problem)
    rms_px = float(np.sqrt((errors_px**2).mean()))
    made = []
    for fit in fits:
        common = (config.scale_error * float(np.linalg.norm(fit.position))) ** 2
        covariance = fit.covariance * scale
        unseen = unseen_m2(float(fit.position[2]), problem.delay_s, problem.focal_px)
        covariance[:3, :3] += EYE3 * (common + unseen)
        made.append(
            PoseFit(fit.position, fit.rotation, covariance, problem.row_px, tuple(used), rms_px, common)
        )
    alike = len(fits) > 1 and fits[1].squares <= _most_squares(fits[0], problem)
    return PoseFits(tuple(made[: 1 + alike]), problem, tuple(fits))


def _curvature(problem: _Problem, fits: list[_Fit], scale: float) -> FloatArray:
    """What the best fit's covariance lacks (6, 6) of poses that fit as well, or not as much worse as it says.

    The second pose, and those with other normals, about each of the two and then about what came of it.
    """
    best = fits[0]
    linear = covariance = scale * best.covariance
    others = fits[1:] + [o for fit in fits[1:] for o in _turned(problem, fit, scale * fit.covariance)]
    for _ in range(ROUNDS):
        before = covariance
        others += _turned(problem, best, covariance)
        for other in others:
            apart = np.concatenate((other.position - best.position, _turn(other, best)))
            covariance = _reaching(covariance, apart, (other.squares - best.squares) / scale)
        if covariance is before or np.linalg.eigvalsh(covariance[3:, 3:])[-1] > MAXIMUM_TURN_RAD**2:
            break
    return covariance - linear


def _turned(problem: _Problem, fit: _Fit, covariance: FloatArray) -> list[_Fit]:
    """The best poses whose normals are some standard deviations off, where a turn's square is not negligible.

    Foreshortening grows with the square of the pad's tilt: where that is all that is seen of the tilt, the
    misses do not grow as the fit's Jacobian says.
    """
    variances, axes = np.linalg.eigh(covariance[3:, 3:])
    # the square of so many standard deviations of the least certain turn, beside the most certain one
    if 0.5 * TURNED_SIGMA[-1] ** 2 * variances[-1] < math.sqrt(variances[0]):
        return []
    found = []
    for variance, axis in zip(variances[1:], axes.T[1:], strict=True):
        for sigma in TURNED_SIGMA:
            turn = quat_from_rotation_vector(vector3((sigma * math.sqrt(variance) * axis).tolist()))
            down = matrix_from_quat(turn) @ fit.rotation[:, 2]
            for start in level_start(problem.points, problem.rays, down):
                other = _fit(replace(problem, down=down, level_sigma=CONVERGED), start, iterations=1)
                found += [] if other is None else [other]
    return found


def _reaching(covariance: FloatArray, apart: FloatArray, worse: float) -> FloatArray:
    """The covariance (6, 6), so much larger that what lies `apart` (6,) is within as many of its standard
    deviations as its fit is `worse` (in variances), or within one.
    """
    stated = float(apart @ np.linalg.solve(covariance, apart))
    allowed = max(worse, 1.0)
    if stated <= allowed:
        return covariance
    return np.asarray(covariance + (1.0 / allowed - 1.0 / stated) * np.outer(apart, apart))


def _turn(fit: _Fit, other: _Fit) -> FloatArray:
    """The rotation vector (3,) from another pose to this one."""
    return np.array(rotation_vector_from_quat(quat_from_matrix(fit.rotation @ other.rotation.T)))


def _is_tilted(problem: _Problem, fit: _Fit) -> bool:
    if problem.down is None:
        return False
    tilt_rad = math.acos(min(1.0, max(-1.0, float(fit.rotation[:, 2] @ problem.down))))
    return tilt_rad > MAXIMUM_TILT_SIGMA * problem.level_sigma


def _fits(problem: _Problem, near: Sequence[PoseFit]) -> list[_Fit]:
    """Poses in front of the camera that the corners show, the best first: one, or where gravity is not known
    two at the most."""
    starts: Sequence[Start]
    if near:
        starts = [(pose.camera_from_pad, pose.position_camera_m) for pose in near]
    elif problem.down is not None:
        starts = level_start(problem.points, problem.rays, problem.down)
    else:
        starts = planar_starts(problem.points, problem.rays)
    fits: list[_Fit] = []
    for start in starts:
        fit = _fit(problem, start, _most_squares(fits[0], problem) if fits else math.inf)
        fits += [] if fit is None else [fit]
    fits.sort(key=lambda fit: fit.squares)
    if len(fits) == 2 and float(np.linalg.norm(_turn(fits[1], fits[0]))) < SAME_RAD:
        del fits[1]
    return fits


def _scale(fit: _Fit, problem: _Problem) -> float:
    """By how much the corners' variances are larger than stated, as observed."""
    freedom = max(2 * len(problem.points) - 6, 0)
    return (PRIOR_MISSES + fit.squares) / (PRIOR_MISSES + freedom)


def _most_squares(best: _Fit, problem: _Problem) -> float:
    """Of a second pose that is not ruled out by the best one."""
    return best.squares + _scale(best, problem) * RULED_OUT_SIGMA**2


def _fit(
    problem: _Problem, start: Start, most_squares: float = math.inf, iterations: int = ITERATIONS
) -> _Fit | None:
    """Gauss-Newton; None when there is no pad in front.

    And where a step would leave more than `most_squares`: from there the fit leads nowhere, or, far round, to
    the pose that is known.
    """
    rotation, position = start
    expected = np.zeros(len(problem.weight))
    expected[3:6] = -problem.rate
    expected[:3] = cross(vector3(expected[3:6]), vector3(position))
    moved = expected.copy()
    for _ in range(iterations):
        jacobian, misses = _linearised(problem, rotation, position, moved)
        white, missed = jacobian @ problem.whitening.T, problem.whitening @ misses
        information, gradient = _normal_equations(problem, white, missed, rotation, moved - expected)
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        unexpected = moved + step[6:] - expected
        squares = float(((missed - step @ white) ** 2).sum() + problem.weight @ unexpected**2)
        if squares > most_squares:
            return None
        position, moved = position + step[:3], moved + step[6:]
        turn = quat_from_rotation_vector(vector3(step[3:6].tolist()))
        rotation = matrix_from_quat(turn) @ rotation
        if not np.isfinite(step).all() or position[2] <= 0.0:
            return None
        if np.abs(step[:6]).max() < CONVERGED:
            break
    left = (misses - step @ jacobian).reshape(2, -1)
    covariance = np.linalg.inv(information)[:6, :6]
    return _Fit(rotation, position, 0.5 * (covariance + covariance.T), left, squares)


def _linearised(
    problem: _Problem, rotation: FloatArray, position: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Jacobian (m, 2n), an unknown a row, and misses (2n,) of the rays, all u and then all v.

    Unknowns: position, rotation (on the left), and in `moved`: velocity of the pad's origin and its rate of
    turn, and what the errors have in common.
    """
    turned, delay, common = rotation @ problem.points.T, problem.delay_s, len(problem.shared)
    wx, wy, wz = moved[3:6].tolist()
    spin = np.array([(0.0, -wz, wy), (wz, 0.0, -wx), (-wy, wx, 0.0)])
    place = position[:, None] + turned + delay * (moved[:3, None] + spin @ turned)
    inverse = 1.0 / np.maximum(place[2], NEAREST_M)
    seen = place[:2] * inverse
    a, b, c = turned * inverse
    by = np.zeros((12 + common, 2, len(inverse)))
    back = -seen
    by[0, 0] = by[1, 1] = inverse
    np.multiply(back, inverse, out=by[2])
    # a small turn moves a point by turn x point, so a ray's rotation part is point x (its position part)
    np.multiply(back, b, out=by[3])
    np.multiply(seen, a, out=by[4])
    by[3, 1] -= c
    by[4, 0] += c
    np.negative(b, out=by[5, 0])
    by[5, 1] = a
    np.multiply(by[:6], delay, out=by[6:12])
    by[12:] = problem.shared
    jacobian = by.reshape(12 + common, -1)
    return jacobian, (problem.rays.T - seen).reshape(-1) - moved[6:] @ jacobian[12:]


def _normal_equations(
    problem: _Problem, white: FloatArray, missed: FloatArray, rotation: FloatArray, unexpected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information (m, m) and gradient (m,): the corners, gravity, and what is known of the motion.

    Of the corners it takes the Jacobian and the misses, whitened; `unexpected` is the motion beyond what is
    known of it.
    """
    information, gradient = white @ white.T, white @ missed
    if problem.down is not None:
        axis, weight = rotation[:, 2], problem.level_sigma**-2
        information[3:6, 3:6] += weight * (EYE3 - axis[:, None] * axis)
        gradient[3:6] += weight * np.array(cross(vector3(axis), vector3(problem.down)))
    information.reshape(-1)[6 * len(information) + 6 :: len(information) + 1] += problem.weight
    gradient[6:] -= problem.weight * unexpected
    return information, gradient
