"""Madgwick's orientation filter, and the first attitude from accelerometer and magnetometer.

Source: S. Madgwick, "An efficient orientation filter for inertial and inertial/magnetic sensor arrays"
(2010), written for NED and FRD: at rest and level the specific force is (0, 0, -g), so that the
accelerometer's objective compares R'(0, 0, -1) with its direction. The gyroscope is integrated exactly;
one gradient step of at most gain * dt per sample pulls towards gravity and magnetic north.
Plain floats: numpy would take ten times as long.
"""

from __future__ import annotations

import math

from companion.base.geometry import (
    Quaternion,
    Vector3,
    norm,
    quat_from_euler,
    quat_integrate,
    quat_normalise,
    quat_rotate,
    scale,
    wrap_angle,
)


def align(specific_force_m_s2: Vector3, field_body_ut: Vector3, declination_rad: float) -> Quaternion:
    """Attitude of a vehicle at rest (eq. 13 in FRD).

    Pitch = asin(f_x / |f|), roll = atan2(-f_y, -f_z), heading = tilt-compensated
    atan2(-m_y', m_x') + declination (rad, east positive).

    Raises:
        ValueError: no specific force (free fall), or no horizontal field to find north by.
    """
    size = norm(specific_force_m_s2)
    if size < 1e-6:
        raise ValueError("no specific force: a vehicle in free fall has no tilt to measure")
    fx, fy, fz = specific_force_m_s2
    pitch = math.asin(max(-1.0, min(1.0, fx / size)))
    roll = math.atan2(-fy, -fz)
    level_x, level_y, _ = quat_rotate(quat_from_euler(roll, pitch, 0.0), field_body_ut)
    if math.hypot(level_x, level_y) < 1e-6:
        raise ValueError("no horizontal magnetic field: north is undetermined")
    yaw = wrap_angle(math.atan2(-level_y, level_x) + declination_rad)
    return quat_from_euler(roll, pitch, yaw)


def tilt_gradient(q: Quaternion, up_body: Vector3) -> Quaternion:
    """Gradient of 1/2 |R'(0, 0, -1) - up_body|^2 by the quaternion; up_body is f / |f|."""
    w, x, y, z = q
    ex = -2.0 * (x * z - w * y) - up_body[0]
    ey = -2.0 * (y * z + w * x) - up_body[1]
    ez = -(1.0 - 2.0 * (x * x + y * y)) - up_body[2]
    return (
        2.0 * (y * ex - x * ey),
        2.0 * (-z * ex - w * ey + 2.0 * x * ez),
        2.0 * (w * ex - z * ey + 2.0 * y * ez),
        2.0 * (-x * ex - y * ey),
    )


def field_gradient(q: Quaternion, direction_body: Vector3, declination_rad: float) -> Quaternion:
    """Gradient of the magnetometer's objective, direction_body = m / |m|.

    The reference takes its dip from the measurement itself (Madgwick's distortion compensation), so that
    a wrong vertical field turns the heading but never the tilt.
    """
    w, x, y, z = q
    hx, hy, down = quat_rotate(q, direction_body)
    horizontal = math.hypot(hx, hy)
    bx, by = horizontal * math.cos(declination_rad), horizontal * math.sin(declination_rad)
    ex = bx * (1 - 2 * (y * y + z * z)) + by * 2 * (x * y + w * z) + down * 2 * (x * z - w * y)
    ey = bx * 2 * (x * y - w * z) + by * (1 - 2 * (x * x + z * z)) + down * 2 * (y * z + w * x)
    ez = bx * 2 * (x * z + w * y) + by * 2 * (y * z - w * x) + down * (1 - 2 * (x * x + y * y))
    ex, ey, ez = ex - direction_body[0], ey - direction_body[1], ez - direction_body[2]
    return (
        2 * ((by * z - down * y) * ex + (down * x - bx * z) * ey + (bx * y - by * x) * ez),
        2
        * (
            (by * y + down * z) * ex
            + (bx * y - 2 * by * x + down * w) * ey
            + (bx * z - by * w - 2 * down * x) * ez
        ),
        2
        * (
            (-2 * bx * y + by * x - down * w) * ex
            + (bx * x + down * z) * ey
            + (bx * w + by * z - 2 * down * y) * ez
        ),
        2
        * (
            (-2 * bx * z + by * w + down * x) * ex
            + (-bx * w - 2 * by * z + down * y) * ey
            + (bx * x + by * y) * ez
        ),
    )


def descend(q: Quaternion, gradient: Quaternion, step: float) -> Quaternion:
    """One step (quaternion length, half an angle in rad) down the gradient, back to unit length."""
    gw, gx, gy, gz = gradient
    size = math.sqrt(gw * gw + gx * gx + gy * gy + gz * gz)
    if size < 1e-12:
        return q
    k = step / size
    return quat_normalise((q[0] - k * gw, q[1] - k * gx, q[2] - k * gy, q[3] - k * gz))


class MadgwickFilter:
    """Orientation from gyroscope, accelerometer and, when there is one, magnetometer.

    `gain` is Madgwick's beta: the length of the quaternion rate (1/s) that pulls against the gyro's error.
    A field waits for the next IMU sample, and both go into one step down their joint objective; an IMU
    sample without a new field descends on gravity alone.
    """

    # it has no gates: it trusts both sensors always, at its slow gain
    gravity_error_m_s2 = 0.0
    mag_trusted = True

    def __init__(self, gain: float, declination_rad: float, attitude: Quaternion) -> None:
        self._gain = gain
        self._declination_rad = declination_rad
        self._field_direction: Vector3 | None = None
        self.attitude = attitude

    def update_imu(self, rate_body_rad_s: Vector3, specific_force_m_s2: Vector3, dt_s: float) -> Quaternion:
        """Attitude after one gyroscope and accelerometer sample, dt_s after the last."""
        # the gradient of the attitude before the turn, as in the paper: gyroscope and gradient add up
        gradient = self._gradient(self.attitude, specific_force_m_s2)
        q = quat_integrate(self.attitude, rate_body_rad_s, dt_s)
        self.attitude = descend(q, gradient, self._gain * dt_s)
        return self.attitude

    def _gradient(self, q: Quaternion, specific_force_m_s2: Vector3) -> Quaternion:
        gw = gx = gy = gz = 0.0
        size = norm(specific_force_m_s2)
        if size > 1e-6:
            gw, gx, gy, gz = tilt_gradient(q, scale(specific_force_m_s2, 1.0 / size))
        if self._field_direction is not None:
            hw, hx, hy, hz = field_gradient(q, self._field_direction, self._declination_rad)
            gw, gx, gy, gz = gw + hw, gx + hx, gy + hy, gz + hz
            self._field_direction = None
        return (gw, gx, gy, gz)

    def update_mag(self, field_body_ut: Vector3, dt_s: float) -> Quaternion:
        """Keep one magnetometer sample for the next of the IMU; a zero field shows nothing."""
        size = norm(field_body_ut)
        self._field_direction = scale(field_body_ut, 1.0 / size) if size > 1e-6 else None
        return self.attitude
