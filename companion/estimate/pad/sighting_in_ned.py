"""A sighting of the camera's in NED, as the pad filter takes it. Pure."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.base.geometry import (
    EYE3,
    FloatArray,
    down_axis,
    matrix_from_quat,
    quat_multiply,
    quat_rotate,
    yaw_from_quat,
)
from companion.base.messages import PadSighting
from companion.estimate.motion import rotation_lever
from companion.estimate.pad.observation import ObservationKind, VehicleAtExposure
from companion.estimate.pad.pad_types import PadMeasurement

# the fast part of the attitude's error: a calm vehicle shows 0.004 to 0.008; turns add the exposure's jitter
ATTITUDE_JITTER_DEG: Final = 0.01
CALIBRATION_SHARE: Final = (
    0.99  # of a sighting's least variance, at most; the rest keeps its covariance positive
)


def in_ned(sighting: PadSighting, exposure: VehicleAtExposure) -> PadMeasurement:
    """A sighting in NED. Of the attitude's error only the fast part is noise from frame to frame.

    The slow part is a constant offset that shrinks with the distance: to treat it as noise would slow the
    filter down and gain nothing. Fast is the exposure's `jitter_rad2`: what the gyroscope's noise adds from
    frame to frame, and what a vehicle that turns makes of the exposure's jitter.
    """
    attitude = exposure.attitude
    rotation = matrix_from_quat(attitude)
    position = quat_rotate(attitude, sighting.pad_position_body_m)
    jitter = math.radians(ATTITUDE_JITTER_DEG) ** 2 + exposure.jitter_rad2
    lever = rotation_lever(position)
    covariance: FloatArray = rotation @ sighting.covariance[0:3, 0:3] @ rotation.T
    # the calibration's share does not change from frame to frame; what is left has to be a covariance
    slow = min(sighting.common_variance_m2, CALIBRATION_SHARE * float(np.linalg.eigvalsh(covariance)[0]))
    slow = max(slow, 0.0)
    tilt_n, tilt_e, turn = (rotation @ sighting.covariance[3:6, 3:6] @ rotation.T).diagonal().tolist()
    north, east, _ = quat_rotate(attitude, down_axis(sighting.body_from_pad))
    return PadMeasurement(
        position_ned_m=position,
        covariance_ned_m2=covariance - slow * EYE3 + jitter * (lever @ lever.T),
        heading_rad=yaw_from_quat(quat_multiply(attitude, sighting.body_from_pad)),
        heading_std_rad=math.sqrt(max(turn, 0.0) + jitter),
        vehicle_velocity_ned_m_s=exposure.velocity_ned_m_s,
        vehicle_velocity_std_m_s=exposure.velocity_std_m_s,
        slow_variance_m2=slow,
        tilt_rad=(north, east),
        tilt_std_rad=math.sqrt(max(tilt_n, tilt_e, 0.0) + jitter),
    )


def numbers(sighting: PadSighting) -> tuple[float, ...]:
    """All of a sighting that has to be finite."""
    return (*sighting.pad_position_body_m, *sighting.body_from_pad, *sighting.covariance.ravel().tolist())


SIGHTING: Final = ObservationKind("sighting", PadSighting, numbers, in_ned, by_camera=True)
