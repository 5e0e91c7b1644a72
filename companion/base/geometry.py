"""Quaternions, rotations and frames: the one place where an order or a sign is decided.

Frames: world NED (north, east, down); body FRD (forward, right, down); camera as OpenCV has it
(x right in the image, y down in the image, z along the optical axis); pad FRD-like (x along the
pad's heading, y to its right, z down into the ground).

Quaternions are Hamilton, (w, x, y, z), and turn body vectors into NED: v_ned = q * v_body * conj(q).
Everything here works on plain floats: at these sizes a tuple is several times faster than an array.
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np
import pymap3d
from numpy.typing import NDArray

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
FloatArray = NDArray[np.float64]

GRAVITY_M_S2: Final = 9.80665
IDENTITY: Final[Quaternion] = (1.0, 0.0, 0.0, 0.0)
MINIMUM_DOWN_COMPONENT: Final = 0.1  # of a vehicle on its side: no tilt says what it gives
_SEMIMAJOR_M: Final = 6378137.0  # WGS-84
_SEMIMINOR_M: Final = 6356752.31424518
_FOCAL2_M2: Final = _SEMIMAJOR_M**2 - _SEMIMINOR_M**2
ZERO3: Final[Vector3] = (0.0, 0.0, 0.0)
DOWN: Final[Vector3] = (0.0, 0.0, 1.0)
EYE3: Final[FloatArray] = np.eye(3)
EYE3.flags.writeable = False  # it is everybody's


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def add(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vector3, factor: float) -> Vector3:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def dot(a: Vector3, b: Vector3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(a: Vector3) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def between(a: Vector3, b: Vector3, share: float) -> Vector3:
    """Straight between two vectors: a at 0, b at 1."""
    (x, y, z), (u, v, w) = a, b
    return (x + share * (u - x), y + share * (v - y), z + share * (w - z))


def vector3(values: FloatArray | list[float] | tuple[float, ...]) -> Vector3:
    """Three plain floats from any sequence of three.

    Raises:
        ValueError: the sequence does not hold exactly three values.
    """
    if isinstance(values, np.ndarray):
        # an array's elements one by one are objects of numpy's, ten times as slow as its list
        x, y, z = values.tolist()
        return (x, y, z)
    x, y, z = values
    return (float(x), float(y), float(z))


def quat_multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product p * q: first q's rotation, then p's."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


def quat_conjugate(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def quat_normalise(q: Quaternion) -> Quaternion:
    """Scale to unit length.

    Raises:
        ZeroDivisionError: q is zero.
    """
    w, x, y, z = q
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * n, x * n, y * n, z * n)


def quat_between(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """Between two attitudes that are near one another, the short way: the chord, scaled to unit length."""
    sign = 1.0 if sum(x * y for x, y in zip(a, b, strict=True)) >= 0.0 else -1.0
    w, x, y, z = (p + share * (sign * q - p) for p, q in zip(a, b, strict=True))
    return quat_normalise((w, x, y, z))


def quat_rotate(q: Quaternion, v: Vector3) -> Vector3:
    """Turn v by q: body to NED for an attitude quaternion."""
    w, x, y, z = q
    a, b, c = v
    tx = 2.0 * (y * c - z * b)
    ty = 2.0 * (z * a - x * c)
    tz = 2.0 * (x * b - y * a)
    return (
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    )


def quat_rotate_inverse(q: Quaternion, v: Vector3) -> Vector3:
    """Turn v by the inverse of q: NED to body for an attitude quaternion."""
    w, x, y, z = q
    return quat_rotate((w, -x, -y, -z), v)


def down_axis(q: Quaternion) -> Vector3:
    """`quat_rotate` of the down axis: the body's in NED for an attitude quaternion."""
    w, x, y, z = q
    a, b = 2.0 * x, 2.0 * y
    return (w * b + z * a, z * b - w * a, 1.0 - x * a - y * b)


def down_in_body(q: Quaternion) -> Vector3:
    """`quat_rotate_inverse` of the down axis: NED's in the body for an attitude quaternion."""
    w, x, y, z = q
    return down_axis((w, -x, -y, -z))


def quat_from_rotation_vector(rotation: Vector3) -> Quaternion:
    """Unit quaternion of a rotation by |rotation| rad about its direction."""
    x, y, z = rotation
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-9:
        return quat_normalise((1.0, 0.5 * x, 0.5 * y, 0.5 * z))
    s = math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), x * s, y * s, z * s)


def rotation_vector_from_quat(q: Quaternion) -> Vector3:
    """Rotation vector (rad, shortest way) of a unit quaternion."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    s = math.sqrt(x * x + y * y + z * z)
    if s < 1e-12:
        return (2.0 * x, 2.0 * y, 2.0 * z)
    k = 2.0 * math.atan2(s, w) / s
    return (x * k, y * k, z * k)


def quat_integrate(q: Quaternion, rate_body_rad_s: Vector3, dt_s: float) -> Quaternion:
    """Attitude after dt at a constant body rate (the exact solution of q' = q * (0, w) / 2).

    `quat_multiply`, `quat_from_rotation_vector` and `quat_normalise` in one, for it is called most of all.
    """
    rx, ry, rz = rate_body_rad_s
    x, y, z = rx * dt_s, ry * dt_s, rz * dt_s
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-9:
        w, x, y, z = quat_normalise((1.0, 0.5 * x, 0.5 * y, 0.5 * z))
    else:
        s = math.sin(0.5 * angle) / angle
        w, x, y, z = math.cos(0.5 * angle), x * s, y * s, z * s
    a, b, c, d = q
    e = a * w - b * x - c * y - d * z
    f = a * x + b * w + c * z - d * y
    g = a * y - b * z + c * w + d * x
    h = a * z + b * y - c * x + d * w
    n = 1.0 / math.sqrt(e * e + f * f + g * g + h * h)
    return (e * n, f * n, g * n, h * n)


def quat_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Attitude from aerospace angles (yaw, then pitch, then roll)."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_from_quat(q: Quaternion) -> Vector3:
    """Roll, pitch, yaw (rad) of an attitude; pitch is clamped to +-pi/2 at gimbal lock."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return (roll, pitch, yaw_from_quat(q))


def yaw_from_quat(q: Quaternion) -> float:
    """Heading (rad, clockwise from north seen from above) of an attitude."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def tilt_from_quat(q: Quaternion) -> float:
    """Tilt (rad): the angle of the thrust axis, the body's down axis, from the vertical."""
    _, x, y, _ = q
    return math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))


def rotate_yaw(v: Vector3, yaw_rad: float) -> Vector3:
    """Turn v about the down axis, clockwise seen from above."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def matrix_from_quat(q: Quaternion) -> FloatArray:
    """3x3 rotation matrix R with v_ned = R v_body."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_matrix(matrix: FloatArray) -> Quaternion:
    """Unit quaternion (w >= 0) of a 3x3 rotation matrix, by its largest component (Shepperd's method)."""
    m = [[float(value) for value in row] for row in matrix]
    trace = m[0][0] + m[1][1] + m[2][2]
    squares = (trace, m[0][0], m[1][1], m[2][2])
    largest = squares.index(max(squares))
    if largest == 0:
        q = (1.0 + trace, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
    elif largest == 1:
        q = (m[2][1] - m[1][2], 1.0 + 2 * m[0][0] - trace, m[0][1] + m[1][0], m[0][2] + m[2][0])
    elif largest == 2:
        q = (m[0][2] - m[2][0], m[0][1] + m[1][0], 1.0 + 2 * m[1][1] - trace, m[1][2] + m[2][1])
    else:
        q = (m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], 1.0 + 2 * m[2][2] - trace)
    unit = quat_normalise(q)
    return unit if unit[0] >= 0.0 else (-unit[0], -unit[1], -unit[2], -unit[3])


# A camera that looks straight down with the image's top edge forward: the image's right is the
# body's right, the image's down is the body's back, the optical axis is the body's down.
BODY_FROM_DOWNWARD_CAMERA: Final[Quaternion] = quat_from_matrix(
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
)


@lru_cache(maxsize=8)
def ned_from_geodetic(
    latitude_deg: float, longitude_deg: float, altitude_m: float, origin: Vector3
) -> Vector3:
    """Position NED (m) relative to the origin (latitude deg, longitude deg, altitude m), on WGS-84.

    The last ones are kept: a place that comes a few times a second is asked for in every control cycle.
    """
    return vector3(pymap3d.geodetic2ned(latitude_deg, longitude_deg, altitude_m, *origin))


def geodetic_from_ned(position_ned_m: Vector3, origin: Vector3) -> Vector3:
    """Latitude (deg), longitude (deg), altitude (m): the inverse of `ned_from_geodetic`.

    By the closed form of R.-J. You, Transformation of Cartesian to geodetic coordinates without iterations
    (Journal of Surveying Engineering 126, 2000), as in the library that the inverse comes from, which takes
    thirty times as long; not for a place on the earth's axis.
    """
    (x0, y0, z0), (sin_lat, cos_lat), (sin_lon, cos_lon) = _tangent_plane(origin)
    north, east, down = position_ned_m
    outward = -cos_lat * down - sin_lat * north
    x, y = x0 + cos_lon * outward - sin_lon * east, y0 + sin_lon * outward + cos_lon * east
    z = z0 - sin_lat * down + cos_lat * north
    a, b, focal2 = _SEMIMAJOR_M, _SEMIMINOR_M, _FOCAL2_M2
    radius = math.hypot(x, y)
    excess = radius * radius + z * z - focal2
    u2 = 0.5 * (excess + math.hypot(excess, 2.0 * math.sqrt(focal2) * z))
    u, across = math.sqrt(u2), math.sqrt(u2 + focal2)
    beta = math.atan2(across * z, u * radius)
    beta += (
        (b * u - a * across + focal2)
        * math.sin(beta)
        / (a * across / math.cos(beta) - focal2 * math.cos(beta))
    )
    above, beyond = z - b * math.sin(beta), radius - a * math.cos(beta)
    inside = (radius / a) ** 2 + (z / b) ** 2 < 1.0
    altitude_m = math.hypot(above, beyond)
    return (
        math.degrees(math.atan2(a * math.sin(beta), b * math.cos(beta))),
        math.degrees(math.atan2(y, x)),
        -altitude_m if inside else altitude_m,
    )


@lru_cache(maxsize=8)
def _tangent_plane(origin: Vector3) -> tuple[Vector3, tuple[float, float], tuple[float, float]]:
    """The origin's earth-fixed place (m), and sine and cosine of its latitude and longitude."""
    latitude, longitude = math.radians(origin[0]), math.radians(origin[1])
    return (
        vector3(pymap3d.geodetic2ecef(*origin)),
        (math.sin(latitude), math.cos(latitude)),
        (math.sin(longitude), math.cos(longitude)),
    )


def horizontal_acceleration(attitude: Quaternion) -> tuple[float, float]:
    """Horizontal acceleration (m/s2, north and east) that this attitude gives while height is held."""
    north, east, down = down_axis(attitude)
    pull = GRAVITY_M_S2 / max(down, MINIMUM_DOWN_COMPONENT)
    return (-north * pull, -east * pull)


def side_force(attitude: Quaternion, specific_force_body_m_s2: Vector3) -> Vector3:
    """The horizontal acceleration (m/s2, NED) that no thrust along body up makes: of wind and drag.

    A thrust that would explain the force along down explains a part sideways; this is the rest. Only what the
    accelerometer feels across body up counts, so that a thrust, of whatever instant, cancels. Upside down or
    on its side the vehicle has none.
    """
    axis_n, axis_e, axis_d = down_axis(attitude)
    if axis_d < MINIMUM_DOWN_COMPONENT:
        return ZERO3
    x, y, _ = specific_force_body_m_s2
    north, east, down = quat_rotate(attitude, (x, y, 0.0))
    return (north - down * axis_n / axis_d, east - down * axis_e / axis_d, 0.0)
