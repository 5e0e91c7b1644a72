"""Process and measurement models of the 31-state EKF (Table 5), with analytic Jacobians.

State, NED and FRD, SI units except µT:
quaternion 0:4, Euler angles 4:7 (rad), angular velocity 7:10 (body, rad/s), position 10:13 (m),
velocity 13:16, acceleration 16:19, accelerometer bias 19:22 (m/s²), gyroscope bias 22:25 (rad/s),
geomagnetic field 25:28 (NED, µT), magnetometer bias 28:31 (body, µT). (The table counts from 1.)

The IMU is the input u and nothing else: less its biases it drives attitude, velocity and position, and is
the angular velocity and the acceleration. Its noise enters where its biases do.
The Euler angles are a function of the quaternion: in the transition their rows are the quaternion's rows
times d(Euler)/d(quaternion), so that state and covariance stay consistent.
Every function returns plain values and Jacobians; none changes its arguments.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import (
    EYE3,
    GRAVITY_M_S2,
    FloatArray,
    Quaternion,
    Vector3,
    add,
    cross,
    euler_from_quat,
    matrix_from_quat,
    quat_conjugate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    scale,
    vector3,
)
from companion.estimate.motion import rotation_lever


def _in_a_row(*sizes: int) -> list[slice]:
    """Where groups of so many states stand, one after another."""
    ends = accumulate(sizes)
    return [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]


QUATERNION, EULER, RATE, POSITION, VELOCITY, ACCELERATION, ACCEL_BIAS, GYRO_BIAS, FIELD, MAG_BIAS = _in_a_row(
    4, 3, 3, 3, 3, 3, 3, 3, 3, 3
)
STATES: Final[int] = MAG_BIAS.stop
MOVING: Final[int] = ACCELERATION.stop  # these rows change by themselves, the biases and the field do not
COUPLED: Final[int] = GYRO_BIAS.stop  # and what they change by is in these columns
ATTITUDE: Final = slice(QUATERNION.start, EULER.stop)
IMU_BIASES: Final = slice(ACCEL_BIAS.start, GYRO_BIAS.stop)


EYE: Final = np.eye(STATES)
EYE.flags.writeable = False


def diagonal(x: float, y: float, z: float) -> FloatArray:
    """A diagonal matrix (3, 3); numpy's own for any size takes four times as long."""
    return np.array((x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z)).reshape(3, 3)


def _places() -> NDArray[np.intp]:
    """Where each element (19, 25) of A is found in the row of all that A is made of: see `transition`."""
    zero, one, minus, step = range(4)
    turning, showing, gaining, mean, moving = 4, 32, 53, 83, 113
    places = np.full((MOVING, COUPLED), zero)

    def put(rows: slice, first: int) -> None:
        """A Jacobian (n, 7) by the quaternion and the gyroscope's bias."""
        block = first + np.arange(7 * len(places[rows])).reshape(-1, 7)
        places[rows, QUATERNION], places[rows, GYRO_BIAS] = block[:, :4], block[:, 4:]

    for rows, first in ((QUATERNION, turning), (EULER, showing)):
        put(rows, first)
    for rows, first in ((VELOCITY, gaining), (ACCELERATION, mean), (POSITION, moving)):
        put(rows, first)
        places[rows, ACCEL_BIAS] = first + 21 + np.arange(9).reshape(3, 3)
    for rows, columns, place in (
        (POSITION, POSITION, one),
        (VELOCITY, VELOCITY, one),
        (POSITION, VELOCITY, step),
        (RATE, GYRO_BIAS, minus),
    ):
        np.fill_diagonal(places[rows, columns], place)
    return places


_PLACES: Final = _places()


def quaternion_of(x: FloatArray) -> Quaternion:
    """The attitude in a state vector as plain floats."""
    w, i, j, k = x[QUATERNION].tolist()
    return (w, i, j, k)


def rotation_jacobian(q: Quaternion, v: Vector3) -> FloatArray:
    """d(R(q) v)/dq, (3, 4), with R(q) v = v + 2w r×v + 2 r×(r×v) as geometry.quat_rotate has it."""
    w, x, y, z = q
    a, b, c = v
    d = x * a + y * b + z * c
    values = (
        *(y * c - z * b, d - x * a, w * c + x * b - 2 * y * a, -w * b + x * c - 2 * z * a),
        *(z * a - x * c, -w * c + y * a - 2 * x * b, d - y * b, w * a + y * c - 2 * z * b),
        *(x * b - y * a, w * b + z * a - 2 * x * c, -w * a + z * b - 2 * y * c, d - z * c),
    )
    return 2.0 * np.array(values).reshape(3, 4)


def inverse_rotation_jacobian(q: Quaternion, v: Vector3) -> FloatArray:
    """d(R(q)ᵀ v)/dq, (3, 4): the rotation by the conjugate, whose vector part has the other sign."""
    jacobian = rotation_jacobian(quat_conjugate(q), v)
    jacobian[:, 1:] *= -1.0
    return jacobian


def euler_jacobian(q: Quaternion) -> FloatArray:
    """d(roll, pitch, yaw)/dq, (3, 4), of a unit quaternion; bounded at gimbal lock, where it has no value."""
    w, x, y, z = q
    n_roll, d_roll = 2 * (w * x + y * z), 1 - 2 * (x * x + y * y)
    n_yaw, d_yaw = 2 * (w * z + x * y), 1 - 2 * (y * y + z * z)
    sine = 2 * (w * y - z * x)
    i = 1.0 / max(n_roll * n_roll + d_roll * d_roll, 1e-4)
    k = 1.0 / max(n_yaw * n_yaw + d_yaw * d_yaw, 1e-4)
    j = 2.0 / math.sqrt(max(1.0 - sine * sine, 1e-4))
    by_roll = (
        2 * i * d_roll * x,
        i * (2 * d_roll * w + 4 * n_roll * x),
        i * (2 * d_roll * z + 4 * n_roll * y),
        2 * i * d_roll * y,
    )
    by_yaw = (
        2 * k * d_yaw * z,
        2 * k * d_yaw * y,
        k * (2 * d_yaw * x + 4 * n_yaw * y),
        k * (2 * d_yaw * w + 4 * n_yaw * z),
    )
    return np.array((*by_roll, j * y, -j * z, j * w, -j * x, *by_yaw)).reshape(3, 4)


def right_matrix(q: Quaternion) -> FloatArray:
    """M(q), (4, 4), with p * q = M(q) p."""
    w, x, y, z = q
    return np.array((w, -x, -y, -z, x, w, z, -y, y, -z, w, x, z, y, -x, w)).reshape(4, 4)


def turn_and_derivatives(rotation: Vector3) -> tuple[Quaternion, tuple[Quaternion, ...]]:
    """Quaternion of a rotation vector (rad) and its derivatives by the vector's three components."""
    a, b, c = rotation
    angle = math.sqrt(a * a + b * b + c * c)
    if angle > 1e-3:
        cosine, s = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle
        curve = (0.5 * cosine - s) / (angle * angle)
    else:
        # series: below this the closed form loses its digits
        cosine, s, curve = 1.0 - angle * angle / 8.0, 0.5 - angle * angle / 48.0, -1.0 / 24.0
    h, ca, cb, cc = -0.5 * s, curve * a, curve * b, curve * c
    return (cosine, s * a, s * b, s * c), (
        (h * a, s + ca * a, ca * b, ca * c),
        (h * b, ca * b, s + cb * b, cb * c),
        (h * c, ca * c, cb * c, s + cc * c),
    )


def _turned(q: Quaternion, rotation: Vector3, scale_by: float) -> tuple[Quaternion, FloatArray]:
    """q turned by a rotation (body, rad), and its Jacobian (4, 7) by q and by what makes the rotation.

    `scale_by` is the rotation's derivative by that.
    """
    turn, derivatives = turn_and_derivatives(rotation)
    w, x, y, z = turn
    (ew, ex, ey, ez), (fw, fx, fy, fz), (gw, gx, gy, gz) = (quat_multiply(q, d) for d in derivatives)
    k = scale_by
    values = (
        *(w, -x, -y, -z, k * ew, k * fw, k * gw),
        *(x, w, z, -y, k * ex, k * fx, k * gx),
        *(y, -z, w, x, k * ey, k * fy, k * gy),
        *(z, y, -x, w, k * ez, k * fz, k * gz),
    )
    return quat_multiply(q, turn), np.array(values).reshape(4, 7)


# What the IMU measured over a step, u of eq. 17: the constant rate and specific force (body) that would have
# turned and accelerated the vehicle as the samples did.
InertialInput = tuple[Vector3, Vector3]


def transition(x: FloatArray, u: InertialInput, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """State (31,) after dt_s, and A (19, 25): the Jacobian of its first 19 rows by its first 25 (eq. 17).

    The other rows stay. The IMU less its biases drives attitude, velocity and position (strapdown), and is
    the mean rate and acceleration over the step: no model of how fast these may change stands between.
    The columns of the IMU's biases are also the G of its noise, with the other sign.
    """
    state = x.tolist()
    qw, qx, qy, qz = state[QUATERNION]
    (ax, ay, az), (gx, gy, gz) = state[ACCEL_BIAS], state[GYRO_BIAS]
    (rx, ry, rz), (fx, fy, fz) = u
    rx, ry, rz, force = (rx - gx) * dt_s, (ry - gy) * dt_s, (rz - gz) * dt_s, (fx - ax, fy - ay, fz - az)
    q_after, turning = _turned((qw, qx, qy, qz), (rx, ry, rz), -dt_s)
    q_mid, turning_half = _turned((qw, qx, qy, qz), (0.5 * rx, 0.5 * ry, 0.5 * rz), -0.5 * dt_s)
    q_after = quat_normalise(q_after)
    an, ae, ad = quat_rotate(q_mid, force)
    acceleration = (an, ae, ad + GRAVITY_M_S2)
    gained = scale(acceleration, dt_s)
    velocity = state[VELOCITY]
    position = add(state[POSITION], scale(add(velocity, scale(gained, 0.5)), dt_s))
    state[: ACCELERATION.stop] = (
        *(*q_after, *euler_from_quat(q_after), rx / dt_s, ry / dt_s, rz / dt_s),
        *(*position, *add(velocity, gained), *acceleration),
    )
    accelerating = rotation_jacobian(q_mid, force) @ (dt_s * turning_half)
    showing = euler_jacobian(q_after) @ turning
    pushing = matrix_from_quat(q_mid) * -dt_s
    gaining = np.concatenate((accelerating.ravel(), pushing.ravel()))
    constants = np.array((0.0, 1.0, -1.0, dt_s))
    parts = (constants, turning.ravel(), showing.ravel(), gaining, gaining / dt_s, (0.5 * dt_s) * gaining)
    A: FloatArray = np.concatenate(parts).take(_PLACES)
    return np.array(state), A


def mag_model(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Magnetometer RᵀB + b_m: values (3,) in µT and Jacobian (3, 31)."""
    q, field = quaternion_of(x), vector3(x[FIELD])
    C = np.zeros((3, STATES))
    C[:, QUATERNION] = inverse_rotation_jacobian(q, field)
    C[:, FIELD] = matrix_from_quat(q).T
    C[:, MAG_BIAS] = EYE3
    return x[MAG_BIAS] + quat_rotate_inverse(q, field), C


def gps_position_model(
    x: FloatArray, antenna_body_m: Vector3, later_s: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Antenna's position p + v t + R l, t = later_s after the state's time: (3,) NED in m, and (3, 31)."""
    q = quaternion_of(x)
    C = np.zeros((3, STATES))
    C[:, POSITION] = EYE3
    C[:, VELOCITY] = later_s * EYE3
    C[:, QUATERNION] = rotation_jacobian(q, antenna_body_m)
    return x[POSITION] + later_s * x[VELOCITY] + quat_rotate(q, antenna_body_m), C


def gps_velocity_model(
    x: FloatArray, antenna_body_m: Vector3, later_s: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Antenna's velocity v + a t + R (ω × l), t = later_s after the state's time: (3,) m/s, and (3, 31)."""
    q, lever = quaternion_of(x), cross(vector3(x[RATE]), antenna_body_m)
    C = np.zeros((3, STATES))
    C[:, VELOCITY] = EYE3
    C[:, ACCELERATION] = later_s * EYE3
    C[:, QUATERNION] = rotation_jacobian(q, lever)
    C[:, RATE] = matrix_from_quat(q) @ rotation_lever(antenna_body_m)
    return x[VELOCITY] + later_s * x[ACCELERATION] + quat_rotate(q, lever), C


def attitude_covariance(q: Quaternion, rotation_ned_covariance: FloatArray) -> FloatArray:
    """Covariance (4, 4) of a quaternion from that of a small rotation (3, 3) about NED axes (rad²)."""
    G = quaternion_jacobian(q)
    covariance: FloatArray = G @ rotation_ned_covariance @ G.T
    return covariance


def quaternion_jacobian(q: Quaternion) -> FloatArray:
    """dq/d(small rotation about NED axes, rad) at q, (4, 3)."""
    jacobian: FloatArray = 0.5 * right_matrix(q)[:, 1:]
    return jacobian


def rotation_covariance(q: Quaternion, quaternion_covariance: FloatArray) -> FloatArray:
    """Covariance (3, 3) of the small rotation about NED axes (rad²): the inverse of `attitude_covariance`."""
    J = rotation_from_quaternion(q)
    covariance: FloatArray = J @ quaternion_covariance @ J.T
    return covariance


def rotation_from_quaternion(q: Quaternion) -> FloatArray:
    """d(small rotation about NED axes, rad)/dq at q, (3, 4)."""
    w, x, y, z = (2.0 * part for part in q)
    return np.array((-x, w, -z, y, -y, z, w, -x, -z, -y, x, w)).reshape(3, 4)
