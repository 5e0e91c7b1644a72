"""The choice of the orientation pre-filter whose quaternion enters the EKF as a measurement (Fig. 6)."""

from __future__ import annotations

import math
from typing import Protocol

from companion.base.geometry import Quaternion, Vector3
from companion.config import EstimateConfig
from companion.estimate.ahrs.complementary import OrientationFilter
from companion.estimate.ahrs.madgwick import MadgwickFilter


class Orientation(Protocol):
    """What the pre-filters have in common; the two properties tell the EKF how far to believe one."""

    attitude: Quaternion

    @property
    def gravity_error_m_s2(self) -> float:
        """By how much what the accelerometer measures differs from gravity in size."""
        ...

    @property
    def mag_trusted(self) -> bool:
        """Whether the last magnetometer sample fitted the expected field."""
        ...

    def update_imu(self, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3, dt_s: float) -> Quaternion:
        """One bias-free IMU sample."""
        ...

    def update_mag(self, field_body_ut: Vector3, dt_s: float) -> Quaternion:
        """One magnetometer sample."""
        ...


def new_orientation(config: EstimateConfig, attitude: Quaternion) -> Orientation:
    """The pre-filter that the settings name, starting from an attitude."""
    field = config.magnetic_field_ned_ut
    if config.orientation.kind == "madgwick":
        return MadgwickFilter(config.madgwick_gain, math.atan2(field[1], field[0]), attitude)
    return OrientationFilter(config.orientation, field, attitude)
