"""From one rest to the next: how the vehicle was moved, by the camera and, independently, by the IMU.

Both give a rotation (vector in the body axes before, rad) and a displacement (m) in level axes: forward and
right as the vehicle pointed before, and down. Level is by the pad for the camera, by gravity for the IMU.

The IMU's displacement is integrated twice from rest to rest, which is possible because the speed is zero at
both ends: the straight line that brings the speed to zero there takes constant errors of the accelerometer
and of the levelling out (zero-velocity update; P. G. Savage, Strapdown Analytics, 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    ZERO3,
    FloatArray,
    Quaternion,
    Vector3,
    cross,
    dot,
    norm,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_integrate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    scale,
    subtract,
    vector3,
)
from companion.base.messages import ImuSample
from companion.tools.pad_check.rest import LEAST_IMU_SAMPLES, REST_S, StandstillMeans

DOWN: Vector3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Move:
    """Rotation (rad, body axes before) and displacement (m, level axes before: forward, right, down)."""

    rotation_rad: Vector3
    displacement_m: Vector3


def down_by_force(rest: StandstillMeans) -> Vector3:
    """Where down is in body axes, by the accelerometer."""
    return scale(rest.force_m_s2, -1.0 / max(norm(rest.force_m_s2), 1e-6))


def down_by_pad(rest: StandstillMeans) -> Vector3:
    """Where down is in body axes, by a pad that lies level."""
    return quat_rotate(rest.body_from_pad, DOWN)


def carried_along(vector_body: Vector3, rotation_rad: Vector3) -> Vector3:
    """What stands still in the world, in body axes before a rotation, in those after it."""
    return quat_rotate_inverse(quat_from_rotation_vector(rotation_rad), vector_body)


def levelled(down_body: Vector3) -> Quaternion:
    """The shortest rotation of body axes whose down is `down_body` into level ones."""
    x, y, z = cross(down_body, DOWN)
    w = 1.0 + dot(down_body, DOWN)
    return quat_normalise((w, x, y, z)) if w > 1e-6 else (0.0, 1.0, 0.0, 0.0)


def camera_move(before: StandstillMeans, after: StandstillMeans) -> Move:
    """By the pad, which stands still."""
    turned = quat_multiply(before.body_from_pad, quat_conjugate(after.body_from_pad))
    moved_pad = subtract(_place_on_pad(after), _place_on_pad(before))
    moved_body = quat_rotate(before.body_from_pad, moved_pad)
    return Move(rotation_vector_from_quat(turned), quat_rotate(levelled(down_by_pad(before)), moved_body))


def _place_on_pad(rest: StandstillMeans) -> Vector3:
    """Where the vehicle is, in the pad's axes (m)."""
    return quat_rotate_inverse(rest.body_from_pad, scale(rest.pad_position_body_m, -1.0))


def imu_move(
    before: StandstillMeans, after: StandstillMeans, imu: Sequence[ImuSample], rate_bias_rad_s: Vector3
) -> Move:
    """By gyroscope and accelerometer.

    What the gyroscope's zero is off by would tilt the horizon in the course of a move, and gravity would
    pass for acceleration; so for the displacement, not for the rotation, the horizons at both ends are
    made to fit: what is between them is taken as a further bias.

    Args:
        before: the rest that the move begins in.
        after: the rest that it ends in.
        imu: the samples from the start of the one to the end of the other.
        rate_bias_rad_s: the gyroscope's zero.

    Returns:
        The move; none where the samples are too few.
    """
    if len(imu) < LEAST_IMU_SAMPLES:
        return Move(ZERO3, ZERO3)
    turned = _attitudes(imu, rate_bias_rad_s)[-1]
    down = down_by_force(before)
    tilt = cross(quat_rotate(turned, down_by_force(after)), down)
    bias = subtract(rate_bias_rad_s, scale(tilt, 1.0 / (imu[-1].time_s - imu[0].time_s)))
    level = levelled(down)
    forces = [
        quat_rotate(quat_multiply(level, attitude), sample.specific_force_body_m_s2)
        for attitude, sample in zip(_attitudes(imu, bias), imu, strict=True)
    ]
    accelerations = np.array(forces) + np.array((0.0, 0.0, GRAVITY_M_S2))
    displacement = _rest_to_rest(np.array([sample.time_s for sample in imu]), accelerations)
    return Move(rotation_vector_from_quat(turned), vector3(displacement))


def longest_gap_s(imu: Sequence[ImuSample], start_s: float, end_s: float) -> float:
    """The longest time without a sample that is not all before the start or after the end.

    Over a long one no move can be integrated; over a rest, in which nothing changes, it can.
    """
    gaps = (
        new.time_s - old.time_s for old, new in pairwise(imu) if new.time_s > start_s and old.time_s < end_s
    )
    return max(gaps, default=0.0)


def _attitudes(imu: Sequence[ImuSample], rate_bias_rad_s: Vector3) -> list[Quaternion]:
    """The rotation from body axes at each sample into those at the first."""
    attitudes = [IDENTITY]
    for old, new in pairwise(imu):
        rate = subtract(new.rate_body_rad_s, rate_bias_rad_s)
        attitudes.append(quat_integrate(attitudes[-1], rate, new.time_s - old.time_s))
    return attitudes


def _rest_to_rest(times_s: FloatArray, accelerations_m_s2: FloatArray) -> FloatArray:
    """The way (3,) by accelerations (n, 3) at times (n,) whose first and last REST_S are at rest.

    On the mean of such a time a hand stands still, at no instant of it does it quite.
    """
    velocities = _integrated(times_s, accelerations_m_s2)
    first, last = times_s <= times_s[0] + REST_S, times_s >= times_s[-1] - REST_S
    begin_s, end_s = times_s[first].mean(), times_s[last].mean()
    start, end = velocities[first].mean(axis=0), velocities[last].mean(axis=0)
    share = (times_s - begin_s) / max(end_s - begin_s, REST_S)
    places = _integrated(times_s, velocities - start - share[:, None] * (end - start))
    return np.asarray(places[last].mean(axis=0) - places[first].mean(axis=0))


def _integrated(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """The integral from the first time on, by trapezoids."""
    pieces = 0.5 * (values[1:] + values[:-1]) * np.diff(times_s)[:, None]
    return np.vstack((np.zeros((1, values.shape[1])), np.cumsum(pieces, axis=0)))
