"""The vision stage: one frame in, one sighting of the pad out, in body axes.

The camera sits on the airframe at `camera_position_body_m`, turned by `camera_yaw_deg` (clockwise seen
from above; 0: the image's top edge is forward) after being tilted by `camera_tilt_deg` (positive: it
looks towards the image's top edge) after being rolled by `camera_roll_deg` (positive: it looks to the left).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.base.geometry import (
    BODY_FROM_DOWNWARD_CAMERA,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
    vector3,
)
from companion.base.messages import Frame, MarkerGroup, PadPrior, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import ENOUGH, GROUPS, Detection, PadDetector, SearchPass
from companion.sense.vision.lens import Lens
from companion.sense.vision.paper_pose import paper_pose
from companion.sense.vision.pose import MAXIMUM_TURN_RAD, PoseFit, fit_poses
from companion.sense.vision.print_check import PrintCheck, correctable
from companion.sense.vision.search import CELL_PX, SearchPlanner
from companion.sense.vision.unread import PartialMarkers, UnreadMarkers

# what is known of it, in camera axes: gravity's direction, if it is, the speed of climb, the rate of turn
_Motion = tuple[Vector3 | None, float, Vector3]


@dataclass(frozen=True, slots=True)
class VisionResult:
    """What one frame gave: the sighting if the pad was recognised, and what a frame's report needs.

    `used` are the markers that the pose is made of, `read` all that the last look has read.
    """

    sighting: PadSighting | None
    marker_count: dict[MarkerGroup, int]
    searched_whole_frame: bool
    used: tuple[Detection, ...] = ()
    read: tuple[Detection, ...] = ()


class Vision:
    """Detection and pose for one pad, camera and airframe.

    Stateless between frames, but for whose turn it is in the search.
    """

    def __init__(self, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, config: VisionConfig) -> None:
        self._config = config
        self._camera = camera
        self._lens = Lens(camera)
        self._planner = SearchPlanner(pad, self._lens, config)
        self._detector = PadDetector(pad, config, self._lens)
        self._print = PrintCheck(pad, self._lens)
        self._unread = UnreadMarkers(pad, self._lens, config, self._print)
        self._partial = PartialMarkers(pad, self._lens, self._print)
        self._body_from_camera = body_from_camera(vehicle)
        self._rotation = matrix_from_quat(self._body_from_camera)
        self._mount = np.array(vehicle.camera_position_body_m)
        self._turn = 0

    def step(self, frame: Frame, prior: PadPrior | None) -> VisionResult:
        """Look where the pad is expected, then everywhere; for any marker when nothing is expected.

        Without an expectation, far and near pads are looked for in turn, in every other frame each; one
        that is near, but with no marker whole in view, in every frame.

        Raises:
            ValueError: the image is not of the calibrated camera's size.
        """
        self._lens.check(frame.image)
        down = None if prior is None else self._to_camera(prior.down_body)
        climb_m_s = 0.0 if prior is None else prior.climb_m_s
        rate = ZERO3 if prior is None else self._to_camera(prior.rate_body_rad_s)
        motion = (down, climb_m_s, rate)
        expected = self._expected(prior)
        looks = () if expected is None else self._planner.expected(*expected)
        wide = self._planner.widened(looks[0]) if looks else self._whole_frame(prior)
        found: list[Detection] = []
        coarse: VisionResult | None = None
        lucky: list[list[Detection]] = []
        for number, look in enumerate((*looks, *wide)):
            found, everywhere = self._detector.read(frame.image, look), number >= len(looks)
            legible = any(d.side_px >= CELL_PX * look.shrink * d.marker.cells for d in found)
            if everywhere and look.shrink > 1 and not legible and len(found) < ENOUGH:
                # of what a shrunk picture shows a little by luck, a look that shrinks it less shows more
                lucky += [found] if found else []
                continue
            result = self._result(frame, found, everywhere, motion)
            if result is not None and result.used[0].refined:
                return result
            # corners of contours: another look may show markers whose sides can be followed
            coarse = coarse or result
        for seen in lucky:
            coarse = coarse or self._result(frame, seen, True, motion)
        if coarse is None and expected is not None:
            parts = self._partial.find(frame.image, *expected)
            coarse = self._result(frame, [], False, motion, parts)
        return coarse or VisionResult(None, count_groups(tuple(found)), bool(wide), read=tuple(found))

    def _result(
        self,
        frame: Frame,
        read: list[Detection],
        everywhere: bool,
        motion: _Motion,
        parts: Sequence[Detection] = (),
    ) -> VisionResult | None:
        """The sighting that markers give which were read, or measured in part, if they give one."""
        found = list(parts) or self._detector.refine(frame.image, read)
        pose = self._pose(frame, found, motion, read) if found else None
        if pose is None:
            return None
        sighting = sighting_of(frame, pose, self._camera, self._rotation, self._mount)
        return VisionResult(sighting, sighting.marker_count, everywhere, pose.used, tuple(found))

    def pixels(self, points_body_m: FloatArray) -> FloatArray:
        """Where points (n, 3) in body axes are in the image: (n, 2), NaN where the lens cannot see."""
        return self._lens.project((points_body_m - self._mount) @ self._rotation)[0]

    def _pose(
        self, frame: Frame, found: list[Detection], motion: _Motion, read: list[Detection]
    ) -> PoseFit | None:
        """The pose as the settings have it; one marker alone is trusted when the print about it fits."""
        if self._config.pose == "paper":
            return paper_pose(found, self._lens, self._config)
        given = (self._lens, self._config, *motion)
        fits = fit_poses(found, *given)
        if fits is None:
            return None
        few = ENOUGH if motion[0] is None else 2
        starts = fits.hypotheses
        if len(starts[0].used) < few or len(starts) > 1:
            more = max((self._unread.find(frame.image, each) for each in starts), key=len)
            if more:
                sure = [d for d in found if d.refined]
                fits = fit_poses([*sure, *more], *given, starts) or fits
        pose = fits.pose()
        if read and len(pose.used) == 1 and (wrong := self._print.wrong_cells(frame.image, pose.used[0])):
            # where something lies on a marker that was read, a corner may have been guessed
            rest = self._partial.find(frame.image, pose.camera_from_pad, pose.position_camera_m, 0.0)
            fits = fit_poses(rest, *given)
            if fits is None and wrong > correctable(pose.used[0].marker):
                return None
            pose = pose if fits is None else fits.pose()
        if len(pose.used) == 1 and not self._print.bears_out(frame.image, pose, read):
            return None
        turn_rad2 = float(np.linalg.eigvalsh(pose.covariance[3:, 3:])[-1])
        return pose if turn_rad2 < MAXIMUM_TURN_RAD**2 else None

    def _whole_frame(self, prior: PadPrior | None) -> tuple[SearchPass, ...]:
        self._turn += 1
        if prior is None or prior.pad_position_body_m is None:
            return self._planner.whole_frame(self._turn)
        near = self._planner.is_near(self._position(prior.pad_position_body_m), prior.position_std_m)
        return self._planner.whole_frame(self._turn, near=near)

    def _position(self, pad_position_body_m: Vector3) -> FloatArray:
        """The pad's place in camera axes (3,)."""
        return np.asarray(self._rotation.T @ (np.array(pad_position_body_m) - self._mount))

    def _to_camera(self, v_body: Vector3) -> Vector3:
        return quat_rotate(quat_conjugate(self._body_from_camera), v_body)

    def _expected(self, prior: PadPrior | None) -> tuple[FloatArray, FloatArray, float] | None:
        """The pad's turn (3, 3) and place (3,) in camera axes, and the place's standard deviation."""
        if prior is None or prior.pad_position_body_m is None or prior.body_from_pad is None:
            return None
        camera_from_pad = self._rotation.T @ matrix_from_quat(prior.body_from_pad)
        return camera_from_pad, self._position(prior.pad_position_body_m), prior.position_std_m


def sighting_of(
    frame: Frame, pose: PoseFit, camera: CameraConfig, body_from_camera: FloatArray, mount_m: FloatArray
) -> PadSighting:
    """A pose in body axes, at the time at which the rows that show the markers were exposed.

    The camera sits at `mount_m` (3,), turned by `body_from_camera` (3, 3).
    """
    row_time_s = ((pose.row_px + 0.5) / camera.height_px - 0.5) * camera.readout_s
    count = count_groups(pose.used)
    return PadSighting(
        time_s=frame.time_s + row_time_s,
        sequence=frame.sequence,
        pad_position_body_m=vector3(body_from_camera @ pose.position_camera_m + mount_m),
        body_from_pad=quat_from_matrix(body_from_camera @ pose.camera_from_pad),
        covariance=turn_covariance(pose.covariance, body_from_camera),
        group=max(GROUPS, key=lambda group: count[group]),
        marker_ids=tuple(d.marker.id for d in pose.used),
        marker_count=count,
        reprojection_error_px=pose.reprojection_error_px,
        common_variance_m2=pose.common_variance_m2,
    )


def body_from_camera(vehicle: VehicleConfig) -> Quaternion:
    """The rotation of camera axes (OpenCV's) into body axes by the vehicle's settings."""
    roll, tilt, yaw = vehicle.camera_turn_rad
    return quat_multiply(quat_from_euler(roll, tilt, yaw), BODY_FROM_DOWNWARD_CAMERA)


def turn_covariance(covariance: FloatArray, rotation: FloatArray) -> FloatArray:
    """A 6x6 covariance of position and small rotation in other axes."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    return both @ covariance @ both.T


def count_groups(detections: tuple[Detection, ...]) -> dict[MarkerGroup, int]:
    """How many markers of each group."""
    groups = [d.marker.group for d in detections]
    return {group: groups.count(group) for group in GROUPS}
