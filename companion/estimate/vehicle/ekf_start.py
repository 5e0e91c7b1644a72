"""The initial state and covariance of the 31-state EKF, and its process noise (Table 5, eq. 17)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import (
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    dot,
    euler_from_quat,
    norm,
    quat_rotate_inverse,
    vector3,
)
from companion.config import EkfConfig
from companion.estimate.ahrs.alignment import InitialAlignment
from companion.estimate.ahrs.madgwick import align
from companion.estimate.vehicle import ekf_model as model

# random walks: an MEMS sensor's bias drifts with its temperature, the field with iron and currents nearby
ACCEL_BIAS_WALK_M_S2_RTS: Final = 0.0005
GYRO_BIAS_WALK_RAD_S_RTS: Final = 2e-5  # see above; judged: 0.07 deg/s in an hour
FIELD_WALK_UT_RTS: Final = 0.005  # see above; judged: 0.3 uT in an hour
MAG_BIAS_WALK_UT_RTS: Final = 0.02  # see above; judged: 1.2 uT in an hour

# of the field while no fix has told the place: between 60 deg south and north nine in ten are within 30 deg
DECLINATION_STD_RAD: Final = math.radians(20.0)

# an axis, of a vehicle that is started in motion; a fix whose velocity is more uncertain says nothing of it
MOVING_SPEED_M_S: Final = 10.0

# keeps the covariance positive definite along the quaternion's length and the Euler angles, which are
# functions of other states (1e-5 rad)
TINY_VARIANCE: Final = 1e-10


@dataclass(frozen=True, slots=True)
class InitialState:
    """What standing still before the flight has shown.

    `heading_std_rad` is beyond what biases of the magnetometer and of the field make of it.
    """

    time_s: float
    attitude: Quaternion
    gyro_bias_rad_s: Vector3
    field_ned_ut: Vector3
    tilt_std_rad: float
    heading_std_rad: float
    gyro_bias_std_rad_s: float
    speed_std_m_s: float = 0.1
    north_unknown: bool = False  # magnetic north stands for it


def start_state(
    time_s: float, found: InitialAlignment, config: EkfConfig, field_ned_ut: Vector3 | None
) -> InitialState | None:
    """What the alignment shows; one in motion shows little. None when a sensor is dead.

    `field_ned_ut` None: it is not known yet, and magnetic north stands for north.
    """
    field = field_ned_ut or _measured_field(found)
    declination_rad = math.atan2(field[1], field[0])
    try:
        attitude = align(found.specific_force_body_m_s2, found.field_body_ut, declination_rad)
    except ValueError:
        return None
    gyro_std = config.gyro_noise_rad_s / math.sqrt(found.samples) + 2e-4
    return InitialState(
        time_s=time_s,
        attitude=attitude,
        gyro_bias_rad_s=found.rate_body_rad_s if found.still else ZERO3,
        field_ned_ut=field,
        north_unknown=field_ned_ut is None,
        tilt_std_rad=math.radians(2.0 if found.still else 15.0),
        heading_std_rad=math.radians(1.5 if found.still else 40.0),
        gyro_bias_std_rad_s=gyro_std if found.still else math.radians(1.0),
        speed_std_m_s=0.1 if found.still else MOVING_SPEED_M_S,
    )


def _measured_field(found: InitialAlignment) -> Vector3:
    """Size and dip (µT, NED with magnetic north for north) as the alignment measures them."""
    size_ut, force = norm(found.field_body_ut), norm(found.specific_force_body_m_s2)
    down_ut = -dot(found.field_body_ut, found.specific_force_body_m_s2) / force if force > 0.0 else 0.0
    return (math.sqrt(max(size_ut * size_ut - down_ut * down_ut, 0.0)), 0.0, down_ut)


def noise_density() -> FloatArray:
    """Diagonal (31,) of the white process noise per second, without the IMU's."""
    density = np.zeros(model.STATES)
    density[model.ACCEL_BIAS] = ACCEL_BIAS_WALK_M_S2_RTS**2
    density[model.GYRO_BIAS] = GYRO_BIAS_WALK_RAD_S_RTS**2
    density[model.FIELD] = FIELD_WALK_UT_RTS**2
    density[model.MAG_BIAS] = MAG_BIAS_WALK_UT_RTS**2
    return density


def initial_state(start: InitialState) -> FloatArray:
    """State vector (31,) at rest at the origin; accelerometer and magnetometer biases are taken as zero."""
    x = np.zeros(model.STATES)
    x[model.QUATERNION] = start.attitude
    x[model.EULER] = euler_from_quat(start.attitude)
    x[model.GYRO_BIAS] = start.gyro_bias_rad_s
    x[model.FIELD] = start.field_ned_ut
    return x


def initial_covariance(config: EkfConfig, start: InitialState) -> FloatArray:
    """Covariance (31, 31) to go with `initial_state`.

    The heading is the magnetometer's: what its bias and the field are off by, east of the field, has turned
    it, by that over the horizontal field. So they are correlated.
    """
    P = np.zeros((model.STATES, model.STATES))
    diagonal = P.reshape(-1)[:: model.STATES + 1]
    diagonal[model.RATE] = 0.1**2
    diagonal[model.POSITION] = 1.0
    diagonal[model.VELOCITY] = start.speed_std_m_s**2
    diagonal[model.ACCELERATION] = 0.5**2
    diagonal[model.ACCEL_BIAS] = config.accel_bias_std_m_s2**2
    diagonal[model.GYRO_BIAS] = start.gyro_bias_std_rad_s**2
    diagonal[model.FIELD] = config.field_std_ut**2
    if start.north_unknown:
        diagonal[model.FIELD] += (math.tan(DECLINATION_STD_RAD) * start.field_ned_ut[0]) ** 2
    diagonal[model.MAG_BIAS] = config.mag_bias_std_ut**2
    north, east, _ = start.field_ned_ut
    turned_by = np.array((-east, north, 0.0)) / (north**2 + east**2)  # rad/µT
    # how the attitude's error, a small rotation about NED axes, comes of the other states'
    turns = np.zeros((3, model.STATES))
    turns[2, model.FIELD] = turned_by
    turns[2, model.MAG_BIAS] = quat_rotate_inverse(start.attitude, vector3(turned_by))
    rotation = turns @ P @ turns.T
    rotation += np.diag([start.tilt_std_rad**2, start.tilt_std_rad**2, start.heading_std_rad**2])
    J = np.vstack((np.eye(4), model.euler_jacobian(start.attitude))) @ model.quaternion_jacobian(
        start.attitude
    )
    P[model.ATTITUDE] = J @ turns @ P
    P[:, model.ATTITUDE] = P[model.ATTITUDE].T
    P[model.ATTITUDE, model.ATTITUDE] = J @ rotation @ J.T
    diagonal[model.ATTITUDE] += TINY_VARIANCE
    return P
