"""The EKF's state, extrapolated to now by the IMU, for the following stages. NED and FRD, SI units."""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import ZERO3, Quaternion, Vector3, add, scale, vector3
from companion.base.messages import VehicleState
from companion.estimate.motion import PREDICTED_S
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import GPS_TIMEOUT_S, VehicleEkf
from companion.estimate.vehicle.inertial_motion import InertialMotion

ALIGNED_STD_RAD: Final = math.radians(20.0)  # an attitude known less well is none to fly by


def vehicle_state(
    ekf: VehicleEkf,
    inertial: InertialMotion,
    moved: tuple[Vector3, Vector3],
    attitude: Quaternion,
    now_s: float,
    imu_age_s: float,
    origin: Vector3 | None,
) -> VehicleState:
    """The vehicle at now_s.

    Args:
        ekf: at its own time.
        inertial: as of the newest IMU sample.
        moved: change of position (m) beyond constant velocity's and of velocity (m/s) since the EKF's time.
        attitude: at now_s.
        now_s: of the app's clock.
        imu_age_s: of the newest sample; older than PREDICTED_S its rate says nothing any more.
        origin: latitude and longitude (deg) and altitude (m) of the position's zero.
    """
    place, speed = moved
    velocity = vector3(ekf.x[model.VELOCITY])
    position = add(vector3(ekf.x[model.POSITION]), scale(velocity, now_s - ekf.time_s))
    variance = ekf.P.diagonal()
    attitude_std_rad = 2.0 * math.sqrt(float(variance[model.QUATERNION].sum()))
    return VehicleState(
        time_s=now_s,
        attitude=attitude,
        rate_body_rad_s=inertial.rate_body_rad_s if imu_age_s <= PREDICTED_S else ZERO3,
        position_ned_m=add(position, place),
        velocity_ned_m_s=add(velocity, speed),
        acceleration_ned_m_s2=inertial.acceleration_ned_m_s2,
        gyro_bias_rad_s=inertial.gyro_bias_rad_s,
        accel_bias_m_s2=inertial.accel_bias_m_s2,
        attitude_std_rad=attitude_std_rad,
        velocity_std_m_s=math.sqrt(float(variance[model.VELOCITY].sum())),
        position_std_m=math.sqrt(float(variance[model.POSITION].sum())),
        aligned=attitude_std_rad < ALIGNED_STD_RAD,
        has_gps=now_s - ekf.gps_time_s < GPS_TIMEOUT_S,
        origin=origin,
        imu_age_s=max(imu_age_s, 0.0),
        side_force_ned_m_s2=inertial.side_force_ned_m_s2,
        acceleration_density_m2_s3=ekf.force_density_m2_s3,
    )
