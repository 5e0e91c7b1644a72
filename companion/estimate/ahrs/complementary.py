"""The orientation pre-filter: gyroscope blended with accelerometer and magnetometer (eqs. 14-16).

    q = γ q_am + (1 - γ) q_ω,   γ = e_ω / (e_ω + e_am)

q_ω is the integrated gyroscope, and e_ω the rate (1/s) at which its error turns the quaternion. q_am is
q_ω, rotated the shortest way until it agrees with the reference: gravity for the accelerometer, magnetic
north for the magnetometer. With both it is the attitude of eq. 13. With only one of them (the sensors have
their own rates, and either may be gated out) it changes nothing that the other measures. e_am = |q_am -
q_ω| / dt is the rate of this correction, so a step never turns faster than e_ω: an acceleration or a
passing car moves the estimate no faster than the gyroscope's error could.

The accelerometer is used only as far as it measures gravity: the specific force is averaged in NED, where
vibration and short manoeuvres cancel, and gated by its magnitude. The magnetometer is used only if
magnitude and dip fit the expected field. Plain floats.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import (
    DOWN,
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    between,
    cross,
    norm,
    quat_integrate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    scale,
)

# of the quaternion, which turns half as fast as the body: a gyroscope that errs by 1.1 deg/s
GYRO_ERROR_RATE: Final = 0.01
ACCEL_AVERAGE_S: Final = 2.0  # manoeuvres shorter than this average out of the specific force
ACCEL_GATE_M_S2: Final = 0.8  # averages that differ more from gravity say nothing of the horizon
MAG_GATE: Final = 0.15  # a disturbance, as a share of the field: it turns the dip by its arc sine at most


def blend(q_gyro: Quaternion, q_reference: Quaternion, gyro_error_rate: float, dt_s: float) -> Quaternion:
    """Eqs. 14-16: γ q_reference + (1 - γ) q_gyro with γ = e_ω / (e_ω + e_am), unit length.

    q and -q are the same attitude: the reference takes the sign that is nearer to q_gyro.
    """
    w, x, y, z = q_gyro
    rw, rx, ry, rz = q_reference
    if w * rw + x * rx + y * ry + z * rz < 0.0:
        rw, rx, ry, rz = -rw, -rx, -ry, -rz
    distance = math.sqrt((rw - w) ** 2 + (rx - x) ** 2 + (ry - y) ** 2 + (rz - z) ** 2)
    reach = gyro_error_rate * dt_s
    if distance + reach <= 0.0:
        return q_gyro
    g = reach / (reach + distance)
    h = 1.0 - g
    return quat_normalise((g * rw + h * w, g * rx + h * x, g * ry + h * y, g * rz + h * z))


def shortest_turn(start: Vector3, end: Vector3) -> Quaternion:
    """Unit quaternion of the shortest rotation of one unit vector onto another."""
    (x, y, z), (u, v, w) = start, end
    cosine = x * u + y * v + z * w
    if cosine < -0.999999:
        # opposite: any axis at right angles will do
        other = (1.0, 0.0, 0.0) if abs(start[0]) < 0.9 else (0.0, 1.0, 0.0)
        axis = cross(start, other)
        return quat_normalise((0.0, *axis))
    return quat_normalise((1.0 + cosine, y * w - z * v, z * u - x * w, x * v - y * u))


class OrientationFilter:
    """Attitude and heading from the IMU and the magnetometer alone, without GPS.

    `gravity_error_m_s2` and `mag_trusted` show the EKF how far to trust the output.
    """

    def __init__(self, field_ned_ut: Vector3, attitude: Quaternion) -> None:
        self._declination_rad = math.atan2(field_ned_ut[1], field_ned_ut[0])
        self._field_ut = norm(field_ned_ut)
        self._dip_rad = math.asin(field_ned_ut[2] / self._field_ut)
        self.attitude = attitude
        self._force_ned_m_s2 = scale(DOWN, -GRAVITY_M_S2)
        self.mag_trusted = True

    @property
    def gravity_error_m_s2(self) -> float:
        """By how much the averaged specific force differs from gravity in size."""
        return abs(norm(self._force_ned_m_s2) - GRAVITY_M_S2)

    def update_imu(self, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3, dt_s: float) -> Quaternion:
        """Attitude after one bias-free gyroscope and accelerometer sample, dt_s after the last."""
        q = quat_integrate(self.attitude, rate_body_rad_s, dt_s)
        felt, k = quat_rotate(q, specific_force_m_s2), dt_s / (ACCEL_AVERAGE_S + dt_s)
        self._force_ned_m_s2 = force = between(self._force_ned_m_s2, felt, k)
        size = norm(force)
        if abs(size - GRAVITY_M_S2) < ACCEL_GATE_M_S2:
            q = self._corrected(q, shortest_turn(scale(force, 1.0 / size), (0.0, 0.0, -1.0)), dt_s)
        self.attitude = q
        return q

    def update_mag(self, field_body_ut: Vector3, dt_s: float) -> Quaternion:
        """Attitude after one magnetometer sample, dt_s after the last: turns the heading, never the tilt."""
        north, east, down = quat_rotate(self.attitude, field_body_ut)
        size = norm(field_body_ut)
        self.mag_trusted = abs(size - self._field_ut) < MAG_GATE * self._field_ut and abs(
            math.asin(max(-1.0, min(1.0, down / size))) - self._dip_rad
        ) < math.asin(MAG_GATE)
        if self.mag_trusted:
            half = 0.5 * math.remainder(self._declination_rad - math.atan2(east, north), math.tau)
            turn = (math.cos(half), 0.0, 0.0, math.sin(half))
            self.attitude = self._corrected(self.attitude, turn, dt_s)
        return self.attitude

    def _corrected(self, q: Quaternion, turn: Quaternion, dt_s: float) -> Quaternion:
        """Draw q to what a turn (NED) makes of it; the average force is in the frame that this turns."""
        w, x, y, z = q
        drawn = blend(q, quat_multiply(turn, q), GYRO_ERROR_RATE, dt_s)
        self._force_ned_m_s2 = quat_rotate(quat_multiply(drawn, (w, -x, -y, -z)), self._force_ned_m_s2)
        return drawn
