"""The inputs of the EKF: steps of the IMU, fixes, and external corrections. NED and FRD, SI units, µT."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from companion.base.geometry import (
    Quaternion,
    Vector3,
    ned_from_geodetic,
    quat_conjugate,
    quat_multiply,
    rotation_vector_from_quat,
)
from companion.base.messages import GpsFix
from companion.config import EkfConfig
from companion.estimate.vehicle.gyro_bias_check import BiasStep
from companion.estimate.vehicle.imu_noise import STEADY, StepNoise

# Of the autopilot's attitude at rest. The horizons of the three calibrated IMUs on one board, in each of two
# flight logs, differ by 0.5 deg an axis (standard deviation); the boards may lie askew by as much again.
OTHER_COMPASS_STD_RAD: Final = math.radians(3.0)
OTHER_HORIZON_STD_RAD: Final = math.radians(0.8)  # see above: 0.5 and as much again by the boards
# Further off one of the two boards lies askew, and nothing at rest tells which: the heading alone counts.
# Further still it is no attitude of this vehicle, and the gate refuses it as a whole.
OTHER_HORIZON_ASKEW_RAD: Final = (math.radians(3.0), math.radians(10.0))
UNKNOWN_RAD: Final = math.pi  # of an angle of which nothing is known


@dataclass(frozen=True, slots=True)
class ImuStep:
    """The mean of a few IMU samples at their mean time, and what else is known at that time.

    `attitude` is the orientation filter's, `tilt_noise_rad` and `heading_noise_rad` are its own, of a small
    rotation. `span_s` is how long the step has lasted by the sensor's own clock; None: since the step before.
    """

    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    samples: int = 1
    field_body_ut: Vector3 | None = None
    attitude: Quaternion | None = None
    tilt_noise_rad: float = 0.2
    heading_noise_rad: float = 0.35
    still: bool = False
    at_rest: bool = False
    noise: StepNoise = STEADY
    span_s: float | None = None


@dataclass(frozen=True, slots=True)
class GpsStep:
    """A fix in the EKF's NED: where the antenna was, and how fast.

    `usual_force_error_m_s2` is by how much the vibration at that time usually sets the force off.
    """

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    position_std_m: Vector3
    velocity_std_m_s: Vector3
    usual_force_error_m_s2: float = 0.0


class AttitudeStep(NamedTuple):
    """The attitude is off: `turn` (about NED axes) corrects it, to these standard deviations (rad)."""

    turn: Quaternion
    tilt_std_rad: float
    heading_std_rad: float


class SecondAttitudeStep(NamedTuple):
    """Another attitude is ours turned by `turn_rad` (about NED axes), to these standard deviations; rad."""

    turn_rad: Vector3
    tilt_std_rad: float
    heading_std_rad: float


EkfInput = ImuStep | GpsStep | BiasStep | AttitudeStep | SecondAttitudeStep


def at_rest(ours: Quaternion, theirs: Quaternion) -> SecondAttitudeStep:
    """What the autopilot's attitude (body to NED) at rest says of ours."""
    turn = rotation_vector_from_quat(quat_multiply(theirs, quat_conjugate(ours)))
    least, most = OTHER_HORIZON_ASKEW_RAD
    askew = least < math.hypot(turn[0], turn[1]) <= most
    return SecondAttitudeStep(turn, UNKNOWN_RAD if askew else OTHER_HORIZON_STD_RAD, OTHER_COMPASS_STD_RAD)


def gps_step(fix: GpsFix, origin: Vector3, config: EkfConfig, usual_force_error_m_s2: float) -> GpsStep:
    """A fix in NED about the origin (latitude deg, longitude deg, altitude m), with the noise to expect."""
    factor = config.gps_accuracy_factor
    across = max(factor * fix.horizontal_accuracy_m, config.gps_position_noise_m)
    along = max(factor * fix.vertical_accuracy_m, 1.5 * config.gps_position_noise_m)
    speed = max(factor * fix.speed_accuracy_m_s, config.gps_velocity_noise_m_s)
    climb = max(factor * (fix.vertical_speed_accuracy_m_s or 0.0), 1.4 * speed)
    return GpsStep(
        position_ned_m=ned_from_geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m, origin),
        velocity_ned_m_s=fix.velocity_ned_m_s,
        position_std_m=(across, across, along),
        velocity_std_m_s=(speed, speed, climb),
        usual_force_error_m_s2=usual_force_error_m_s2,
    )
