"""What the eyes made of one shot: error, covariance, flip, and the noise and information of the corners they
used.

The Cramér-Rao bound of a shot is that of the position at the sighting's time, from the corners that were
used, as a corner's noise really is (measured over all shots of a case: the detected corners less the true
ones, rolling shutter included). Known beside the corners: gravity to the attitude's error; of the motion
within the frame how it spreads over the hover; of the rotors' vibration its frequency and how far it goes,
not its phase. With p = R x + t for a corner x, a speed v and a rate w shift it by (v + w x R x) times the
time from the sighting to the corner's row, so the motion's columns are the pose's times that time; a turn d
of the camera shifts it by p x d.

Camera axes for the bound, body axes for errors and covariances; the trace is the same.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from benchmarks.vision.shots import ATTITUDE_STD_RAD, BenchShot, PadBeforeCamera, vehicle
from companion.base.geometry import FloatArray, Quaternion, quat_conjugate, quat_multiply, quat_rotate
from companion.base.messages import PadSighting
from companion.config import CameraConfig, VisionConfig
from companion.sense.vision.aruco import Detection
from companion.sense.vision.pipeline import Vision

FLIP_RAD: Final = math.radians(10.0)
# nearer to square-on than this, the attitude's own error may put a pose on the other side
CLEAR_TILT_RAD: Final = 5.0 * ATTITUDE_STD_RAD


# place, orientation, speed, rate; sine and cosine of the vibration about the camera's x and y
UNKNOWNS: Final = 16


@dataclass
class JudgedShot:
    """One shot's outcome; without a sighting only the first three say something.

    `information` is of pose, motion and vibration (16, 16), for each group of markers, at a noise of 1 px;
    `misses_px` (n, 2) are the detected corners less the true ones, by group.
    """

    seen: bool
    whole_frame: bool
    error_m: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    covariance_m2: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))
    turn_error_rad: float = math.nan
    flipped: bool = False
    misses_px: dict[str, FloatArray] = field(default_factory=dict)
    information: dict[str, FloatArray] = field(default_factory=dict)
    known: FloatArray = field(default_factory=lambda: np.zeros((UNKNOWNS, UNKNOWNS)))

    @property
    def squared_m2(self) -> float:
        """Of the position's error."""
        return float(self.error_m @ self.error_m)


def eyes(stage: PadBeforeCamera, config: VisionConfig, camera: CameraConfig | None = None) -> Vision:
    """The app's eyes, by a calibration that may be another than the lens is."""
    return Vision(stage.pad, camera or stage.camera, vehicle(), config)


def judge(vision: Vision, stage: PadBeforeCamera, shot: BenchShot, *, corners: bool = False) -> JudgedShot:
    """Let the eyes look; `corners`: also what the bound needs."""
    result = vision.step(shot.frame, shot.prior)
    if result.sighting is None:
        return JudgedShot(False, result.searched_whole_frame)
    found = _errors(shot, result.sighting)
    found.whole_frame = result.searched_whole_frame
    if corners:
        _corners(found, stage, shot, result.sighting.time_s, result.used)
    return found


def _errors(shot: BenchShot, sighting: PadSighting) -> JudgedShot:
    place, body_from_pad = shot.scene.pad_in_body(sighting.time_s)
    error = np.array(sighting.pad_position_body_m) - np.array(place)
    turn = quat_multiply(quat_conjugate(body_from_pad), sighting.body_from_pad)
    turn_error = 2.0 * math.acos(min(1.0, abs(turn[0])))
    other_side = _on_the_other_side(body_from_pad, sighting.body_from_pad, np.array(place))
    return JudgedShot(
        True,
        False,
        error_m=error,
        covariance_m2=sighting.covariance[:3, :3],
        turn_error_rad=turn_error,
        flipped=turn_error > FLIP_RAD or other_side,
    )


def _on_the_other_side(truth: Quaternion, told: Quaternion, place: FloatArray) -> bool:
    """Whether the pad tilts to the other side of the line of sight than it does."""
    sight = place / np.linalg.norm(place)
    sides = []
    for attitude in (truth, told):
        normal = np.array(quat_rotate(attitude, (0.0, 0.0, 1.0)))
        sides.append(normal - (normal @ sight) * sight)
    clear = float(np.linalg.norm(sides[0])) > math.sin(CLEAR_TILT_RAD)
    return clear and float(sides[0] @ sides[1]) < 0.0


def _corners(
    found: JudgedShot, stage: PadBeforeCamera, shot: BenchShot, time_s: float, used: Iterable[Detection]
) -> None:
    """Fill in what the used corners missed by, and what they could have told."""
    by_group: dict[str, list[Detection]] = {}
    for detection in used:
        by_group.setdefault(detection.marker.group, []).append(detection)
    rotation, position = stage.pose_in_camera(shot.scene, time_s)
    focal_px = 0.5 * (stage.camera.fx_px + stage.camera.fy_px)
    rotor_rate = shot.scene.moment.rotor_rate_rad_s
    for group, markers in by_group.items():
        points = np.concatenate([d.marker.corners_pad_m() for d in markers])
        true_px, row_s = stage.pixels(shot.scene, points, shot.frame.time_s)
        found.misses_px[group] = np.concatenate([d.corners_px for d in markers]) - true_px
        swing = np.stack([f(rotor_rate * row_s) - f(rotor_rate * time_s) for f in (np.sin, np.cos)], axis=1)
        rows = _rows(points @ rotation.T, position, row_s - time_s, swing)
        found.information[group] = focal_px**2 * rows.T @ rows
    found.known = _known(rotation, shot)


def _rows(turned: FloatArray, position: FloatArray, after_s: FloatArray, swing: FloatArray) -> FloatArray:
    """By how much each unknown moves ideal image coordinates: (2n, 16).

    Args:
        turned: the corners (n, 3) less the pad's place, camera axes (m).
        position: the pad's place (3,).
        after_s: when each corner's row is exposed (n,), since the sighting.
        swing: how far sine and cosine of the vibration (n, 2) have gone since then.
    """
    points = turned + position
    x, y, z = points.T
    n = len(z)
    to_image = np.zeros((n, 2, 3))
    to_image[:, 0, 0] = to_image[:, 1, 1] = 1.0 / z
    to_image[:, 0, 2], to_image[:, 1, 2] = -x / z**2, -y / z**2
    pose = np.concatenate([to_image, to_image @ _crossed(turned)], axis=2)
    shaken = (to_image @ _crossed(points))[:, :, :2]
    moving = [pose * after_s[:, None, None], *(shaken * swing[:, k, None, None] for k in (0, 1))]
    return np.concatenate([pose, *moving], axis=2).reshape(2 * n, UNKNOWNS)


def _crossed(points: FloatArray) -> FloatArray:
    """What a small turn moves points (n, 3) by: d x p as matrices (n, 3, 3)."""
    a, b, c = points.T
    zero = np.zeros(len(points))
    return np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=1).reshape(-1, 3, 3)


def _known(rotation: FloatArray, shot: BenchShot) -> FloatArray:
    """Gravity, which the attitude tells, and how far the hover's motion and the rotors' vibration go."""
    known = np.zeros((UNKNOWNS, UNKNOWNS))
    normal, flight = rotation[:, 2], shot.scene.moment.flight
    known[3:6, 3:6] = (np.eye(3) - np.outer(normal, normal)) / ATTITUDE_STD_RAD**2
    known[6:9, 6:9] = np.eye(3) / flight.speed_std_m_s**2
    known[9:12, 9:12] = np.eye(3) / flight.rate_std_rad_s**2
    known[12:, 12:] = np.eye(4) / (0.5 * shot.scene.moment.shaken_rad**2)
    return known


# ---------------------------------------------------------------- over many shots


def noise_px(shots: Iterable[JudgedShot]) -> dict[str, float]:
    """Root mean square of what corners missed by, an axis, by group of markers."""
    misses: dict[str, list[FloatArray]] = {}
    for shot in shots:
        for group, missed in shot.misses_px.items():
            misses.setdefault(group, []).append(missed)
    return {group: float(np.sqrt(np.mean(np.concatenate(all_) ** 2))) for group, all_ in misses.items()}


def bound_m2(shot: JudgedShot, noise: dict[str, float]) -> float:
    """Cramér-Rao: the least mean square of the position's error."""
    information = shot.known.copy()
    for group, found in shot.information.items():
        information += found / noise[group] ** 2
    return float(np.trace(np.linalg.inv(information)[:3, :3]))
