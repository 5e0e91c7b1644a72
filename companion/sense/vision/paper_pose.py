"""The pad's pose the paper's way (section 2.2 and 2.3), beside the joint fit that flies: `vision.pose:
paper`.

Each marker by itself: a planar homography gives the start and Levenberg-Marquardt on the reprojection error
the pose (section 2.3), eq. 4 takes it to the pad's centre. A group of markers is chosen by the distance,
estimates are dropped by eq. 1 as it is written, and the mean of the rest is the answer. What the paper
leaves open is left as plain as it is there: a marker that is seen square-on has two poses, and the better
fit is taken; gravity has no part; a rolling shutter is not known of; the covariance is the scatter of the
estimates over their number.

Camera axes are OpenCV's.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.config import VisionConfig
from companion.sense.vision.aruco import GROUPS, Detection
from companion.sense.vision.lens import Lens
from companion.sense.vision.pose import PoseFit

# eq. 1
EXTRACTION: Final = 0.3
# a group's markers are used while they are at least this large: the smallest group that is
GROUP_SIDE_PX: Final = 30.0
# of an estimate by one marker: for a scatter that a single one does not show, a share of the distance and
# an angle
SINGLE_SHARE: Final = 0.01
SINGLE_TURN_RAD: Final = math.radians(5.0)


def paper_pose(found: list[Detection], lens: Lens, config: VisionConfig) -> PoseFit | None:
    """The mean of the chosen group's poses after extraction.

    Args:
        found: markers with corners in pixels.
        lens: the calibration (eqs. 2 and 3).
        config: for the calibration's error alone.

    Returns:
        None when there is no marker, or none has a pose in front of the camera.
    """
    chosen = of_the_group_for_the_distance(found)
    solved = [(d, pose) for d in chosen if (pose := marker_pose(d, lens)) is not None]
    if not solved:
        return None
    positions = np.array([position for _, (_, position) in solved])
    kept = np.flatnonzero(np.logical_not(extracted(positions)))
    used = tuple(solved[k][0] for k in kept)
    rotation = mean_rotation(np.array([solved[k][1][0] for k in kept]))
    position = positions[kept].mean(axis=0)
    errors_px = _reprojection_px(used, rotation, position, lens)
    common = (config.scale_error * float(np.linalg.norm(position))) ** 2
    return PoseFit(
        position_camera_m=position,
        camera_from_pad=rotation,
        covariance=_covariance(positions[kept], common),
        row_px=float(np.mean([d.corners_px[:, 1].mean() for d in used])),
        used=used,
        reprojection_error_px=float(np.sqrt((errors_px**2).mean())),
        common_variance_m2=common,
    )


def of_the_group_for_the_distance(found: list[Detection]) -> list[Detection]:
    """The markers of one group: the smallest print that is large in the image, else the largest that is seen.

    The nearer the pad, the smaller the markers that are used (section 2.2); how large they appear is the
    distance in terms of their own size.
    """
    groups: dict[MarkerGroup, list[Detection]] = {
        group: [d for d in found if d.marker.group == group] for group in GROUPS
    }
    for group in reversed(GROUPS):
        if groups[group] and float(np.median([d.side_px for d in groups[group]])) >= GROUP_SIDE_PX:
            return groups[group]
    return next((groups[group] for group in GROUPS if groups[group]), [])


def marker_pose(detection: Detection, lens: Lens) -> tuple[FloatArray, FloatArray] | None:
    """One marker's pose of the pad: camera-from-pad (3, 3), and the pad's centre (3,) in camera axes (m).

    The homography of four corners and its planar solutions (IPPE) start Levenberg-Marquardt on the
    reprojection error; eq. 4 then takes the marker's own pose to the pad, whose frame its corners are in.
    """
    rays = lens.undistort(detection.corners_px)
    eye, straight = np.eye(3), np.zeros(5)
    solved, turns, places, _ = cv2.solvePnPGeneric(
        detection.corners_pad_m, rays, eye, straight, flags=cv2.SOLVEPNP_IPPE
    )
    if not solved:
        return None
    turn, place = cv2.solvePnPRefineLM(detection.corners_pad_m, rays, eye, straight, turns[0], places[0])
    rotation, position = cv2.Rodrigues(turn)[0], np.asarray(place, dtype=np.float64).reshape(3)
    if not np.isfinite(position).all() or position[2] <= 0.0:
        return None
    return np.asarray(rotation, dtype=np.float64), position


def extracted(estimates: FloatArray) -> FloatArray:
    """Which estimates (n, 3) are dropped: (n,) true where eq. 1 holds, as it is written.

    An estimate goes when its squared deviation from the mean, over the largest of the axes' variances,
    exceeds 0.3. The flaw is kept: the variance is that of the very estimates, so however well they agree,
    those that agree least are dropped, and two estimates always go both. Where all would go, all stay.
    """
    mean = estimates.mean(axis=0)
    largest = float(np.abs(estimates.var(axis=0)).max())
    if len(estimates) < 2 or largest <= 0.0:
        return np.zeros(len(estimates), dtype=bool)
    dropped = ((estimates - mean) ** 2).sum(axis=1) / largest > EXTRACTION
    return np.zeros(len(estimates), dtype=bool) if dropped.all() else np.asarray(dropped)


def mean_rotation(rotations: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to the mean of rotations (n, 3, 3)."""
    left, _, right = np.linalg.svd(rotations.mean(axis=0))
    sign = np.sign(np.linalg.det(left @ right))
    return np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right)


def _covariance(positions: FloatArray, common: float) -> FloatArray:
    """Of a mean (6, 6): the estimates' scatter over their number, and what a single one may be off by."""
    n = len(positions)
    single = (SINGLE_SHARE * float(np.linalg.norm(positions.mean(axis=0)))) ** 2
    scatter = positions.var(axis=0) * n / (n - 1) if n > 1 else np.zeros(3)
    place = np.maximum(scatter, single) / n + common
    return np.diag(np.concatenate((place, np.full(3, SINGLE_TURN_RAD**2 / n))))


def _reprojection_px(
    used: tuple[Detection, ...], rotation: FloatArray, position: FloatArray, lens: Lens
) -> FloatArray:
    """How far (n,) px the corners are from where the mean pose puts them."""
    points = np.concatenate([d.corners_pad_m for d in used]) @ rotation.T + position
    pixels = np.concatenate([d.corners_px for d in used])
    if lens.fisheye:
        return np.asarray(np.linalg.norm(pixels - lens.project(points)[0], axis=1))
    away = lens.undistort(pixels) - points[:, :2] / points[:, 2:]
    return np.asarray(np.hypot(away[:, 0], away[:, 1]) * lens.focal_px)
