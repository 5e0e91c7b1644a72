"""The choice of the orientation pre-filter whose quaternion enters the EKF as a measurement (Fig. 6)."""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Quaternion, Vector3, norm
from companion.config import EstimateConfig
from companion.estimate.ahrs.complementary import MAG_GATE, OrientationFilter
from companion.estimate.ahrs.madgwick import MadgwickFilter

ORIENTATION_TILT_NOISE_DEG: Final = 12.0  # of the pre-filter's attitude in flight

# the pre-filter corrects a bad start slowly, the EKF at once: until then it shall not hold the EKF back
SETTLING_NOISE_RAD: Final = 1.0


Orientation = OrientationFilter | MadgwickFilter


def new_orientation(config: EstimateConfig, field: Vector3, attitude: Quaternion) -> Orientation:
    """The pre-filter that the settings name, starting from an attitude in a field (µT, NED)."""
    if config.orientation.kind == "madgwick":
        return MadgwickFilter(config.madgwick_gain, math.atan2(field[1], field[0]), attitude)
    return OrientationFilter(field, attitude)


def tilt_noise_rad(orientation: Orientation, disturbance_m_s2: float, settled: bool) -> float:
    """By how much a pre-filter's tilt may be off.

    In flight the accelerometer measures thrust and drag, not gravity: the noise grows with the difference.
    """
    base = math.radians(ORIENTATION_TILT_NOISE_DEG) + _unsettled_rad(settled)
    return base + 3.0 * (disturbance_m_s2 + orientation.gravity_error_m_s2) / GRAVITY_M_S2


def heading_noise_rad(field_ned_ut: Vector3, mag_trusted: bool, settled: bool) -> float:
    """By how much its heading may be off; without a trusted field nothing is known of it.

    A disturbance that its gate lets pass turns the heading the further the weaker the horizontal field is.
    """
    north, east, _ = field_ned_ut
    base = math.atan2(MAG_GATE * norm(field_ned_ut), math.hypot(north, east)) + _unsettled_rad(settled)
    return base if mag_trusted else base + 3.0


def _unsettled_rad(settled: bool) -> float:
    return 0.0 if settled else SETTLING_NOISE_RAD
