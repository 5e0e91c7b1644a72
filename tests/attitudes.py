"""The angle between two attitudes."""

import math

from companion.base.geometry import Quaternion, norm, quat_conjugate, quat_multiply, rotation_vector_from_quat

DEGREE = math.radians(1.0)


def between_rad(a: Quaternion, b: Quaternion) -> float:
    return norm(rotation_vector_from_quat(quat_multiply(a, quat_conjugate(b))))


def between_deg(a: Quaternion, b: Quaternion) -> float:
    return between_rad(a, b) / DEGREE
