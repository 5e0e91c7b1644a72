"""The vehicle's motion between two IMU samples, by the newest biases: body FRD and NED, SI units."""

from __future__ import annotations

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    between,
    norm,
    quat_conjugate,
    quat_integrate,
    quat_multiply,
    quat_rotate,
    rotation_vector_from_quat,
    side_force,
    subtract,
    vector3,
)
from companion.base.messages import ACCELERATION_FILTER_S, ImuSample
from companion.estimate.ahrs.complementary import ACCEL_AVERAGE_S
from companion.estimate.ahrs.orientation import Orientation
from companion.estimate.motion import MotionHistory


class InertialMotion:
    """Attitude, rate, acceleration and side force at the newest sample; each sample goes to the history, too.

    `disturbance_m_s2` is the largest acceleration within the time over which the pre-filter averages.
    """

    def __init__(self, history: MotionHistory) -> None:
        self._history = history
        self.attitude: Quaternion = IDENTITY
        self.rate_body_rad_s: Vector3 = ZERO3
        self.acceleration_ned_m_s2: Vector3 = ZERO3
        self._lasting: Vector3 = ZERO3
        self.side_force_ned_m_s2: Vector3 = ZERO3
        self.gyro_bias_rad_s: Vector3 = ZERO3
        self.accel_bias_m_s2: Vector3 = ZERO3
        self._yaw_share: Vector3 = ZERO3
        self.disturbance_m_s2 = 0.0
        self._by_orientation: Vector3 = ZERO3

    def add(
        self,
        sample: ImuSample,
        of_turning: Vector3,
        dt_s: float,
        mean_rate: Vector3,
        mean_force: Vector3,
        orientation: Orientation,
    ) -> None:
        """Take a sample, and the means since the one before, dt_s ago; the pre-filter goes along.

        `of_turning` is what its place adds to the sample's force (m/s², body; see `lever_arm`): `mean_force`
        is the centre of mass's already.
        """
        (u, v, w), (gx, gy, gz), (kx, ky, kz) = mean_rate, self.gyro_bias_rad_s, self._yaw_share
        p, q, r = turned = (u - gx, v - gy, w - gz)
        self.attitude = quat_integrate(self.attitude, (p - kx * r, q - ky * r, r - kz * r), dt_s)
        # a rotor's tone lies near half of the samples' rate: a low-pass leaves a tenth of it as wind, of the
        # means between samples next to nothing
        (x, y, z), (bx, by, bz) = mean_force, self.accel_bias_m_s2
        force = (x - bx, y - by, z - bz)
        orientation.update_imu(turned, force, dt_s)
        (p, q, r), (x, y, z), (u, v, w) = sample.rate_body_rad_s, sample.specific_force_body_m_s2, of_turning
        self.rate_body_rad_s = (p - gx, q - gy, r - gz)
        felt = _acceleration(self.attitude, (x - u - bx, y - v - by, z - w - bz))
        acceleration = _acceleration(self.attitude, force)
        span_s = None if sample.interval_s is None else dt_s
        k = dt_s / (ACCELERATION_FILTER_S + dt_s)
        self.acceleration_ned_m_s2 = between(self.acceleration_ned_m_s2, acceleration, k)
        # a blow is over when it is felt: what lasts changes by no more than thrust can
        self._lasting = between(self._lasting, _near(self._lasting, acceleration, GRAVITY_M_S2), k)
        self._history.add(sample.time_s, self.attitude, felt, span_s, self._lasting)
        self.side_force_ned_m_s2 = between(self.side_force_ned_m_s2, side_force(self.attitude, force), k)
        # the pre-filter remembers an acceleration for as long as it averages; taken with its own attitude, so
        # that a wrong one of the EKF does not look like an acceleration and shut out what would correct it
        own = _acceleration(orientation.attitude, force)
        self._by_orientation = between(self._by_orientation, own, k)
        fade = 1.0 - min(dt_s / max(ACCEL_AVERAGE_S, dt_s), 1.0)
        self.disturbance_m_s2 = max(norm(self._by_orientation), self.disturbance_m_s2 * fade)

    def follow(self, attitude: Quaternion, age_s: float, yaw_share: FloatArray) -> None:
        """Take the EKF's attitude of age_s ago; by how much it corrects ours is told to the history.

        `yaw_share` is what a yaw adds to the gyroscope's rate (`YawError.share`): taken off as the EKF does,
        so that what is left to correct is its measurements' work alone.
        """
        attitude = self.turned(attitude, age_s)
        self._history.correct(
            rotation_vector_from_quat(quat_multiply(attitude, quat_conjugate(self.attitude)))
        )
        self.attitude, self._yaw_share = attitude, vector3(yaw_share)

    def turned(self, attitude: Quaternion, dt_s: float) -> Quaternion:
        """An attitude after dt_s at the newest sample's rate."""
        return quat_integrate(attitude, self.rate_body_rad_s, dt_s)


def _acceleration(attitude: Quaternion, specific_force_m_s2: Vector3) -> Vector3:
    north, east, down = quat_rotate(attitude, specific_force_m_s2)
    return (north, east, down + GRAVITY_M_S2)


def _near(centre: Vector3, value: Vector3, reach: float) -> Vector3:
    """The value, or the nearest one to it within reach of the centre."""
    distance = norm(subtract(value, centre))
    return value if distance <= reach else between(centre, value, reach / distance)
