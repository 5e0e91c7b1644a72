"""Pad detection for the mount calibration: the app's detector and pose estimation, without gravity.

In flight, the pose uses the gravity direction, through the camera mounting that is the unknown here: an error
of the mounting would confirm itself. So a pose here uses the corners only. It may then be the second solution
of the planar pose; the solver rejects those.

The search region follows from the last sighting. Without one, the whole frame is searched for all markers,
which takes longer.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, matrix_from_quat
from companion.base.messages import Frame, PadSighting
from companion.config import CameraConfig, VehicleConfig, VisionConfig
from companion.pad import Pad
from companion.sense.vision.aruco import PadDetector, SearchPass
from companion.sense.vision.lens import Lens
from companion.sense.vision.pipeline import body_from_camera, sighting_of
from companion.sense.vision.pose import PoseFit, estimate_pose
from companion.sense.vision.search import SearchPlanner

# how far the pad may have moved since the last sighting, of its distance
STRAYED: Final = 0.06
# a vehicle in the hands is moved more quickly than it flies
HAND_SPEED_M_S: Final = 1.0
HAND_RATE_RAD_S: Final = 1.0


class GravityFreePadDetector:
    """One frame in, one sighting out, in body axes by the vehicle's settings (time offset not applied)."""

    def __init__(self, pad: Pad, camera: CameraConfig, vehicle: VehicleConfig, config: VisionConfig) -> None:
        by_hand = {"relative_speed_std_m_s": HAND_SPEED_M_S, "turn_rate_std_rad_s": HAND_RATE_RAD_S}
        self._camera, self._config = camera, config.model_copy(update=by_hand)
        self._lens = Lens(camera)
        self._planner = SearchPlanner(pad, self._lens, config)
        self._detector = PadDetector(pad, config, self._lens)
        self._rotation = matrix_from_quat(body_from_camera(vehicle))
        self._mount = np.array(vehicle.camera_position_body_m)
        self._last: PoseFit | None = None

    def look(self, frame: Frame) -> PadSighting | None:
        """Find the pad.

        Raises:
            ValueError: the image is not of the calibrated camera's size.
        """
        self._lens.check(frame.image)
        for looks in (self._expected(), self._everywhere()):
            for look in looks:
                found = self._detector.detect(frame.image, look)
                pose = estimate_pose(found, self._lens, self._config, None) if found else None
                if pose is not None:
                    self._last = pose
                    return sighting_of(frame, pose, self._camera, self._rotation, self._mount)
        self._last = None
        return None

    def _expected(self) -> tuple[SearchPass, ...]:
        if self._last is None:
            return ()
        position: FloatArray = self._last.position_camera_m
        strayed_m = STRAYED * float(np.linalg.norm(position))
        return self._planner.expected(self._last.camera_from_pad, position, strayed_m)

    def _everywhere(self) -> tuple[SearchPass, ...]:
        return (*self._planner.whole_frame(1), *self._planner.whole_frame(0))
