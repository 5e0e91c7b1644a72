"""How a chip is mounted: its axes to the body's, with the scale of its numbers, in plain floats."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.geometry import Vector3, matrix_from_quat, quat_from_euler

Rows = tuple[float, float, float, float, float, float, float, float, float]


def mounting_rows(body_from_sensor_deg: Vector3, factor: float) -> Rows:
    """The rotation from sensor to body axes (roll, pitch, yaw, degrees) times `factor`, row by row."""
    roll, pitch, yaw = (math.radians(angle) for angle in body_from_sensor_deg)
    matrix = matrix_from_quat(quat_from_euler(roll, pitch, yaw)) * factor
    a, b, c, d, e, f, g, h, i = (float(value) for value in matrix.flat)
    return (a, b, c, d, e, f, g, h, i)


def calibrated_rows(body_from_sensor: Rows, matrix: Sequence[Sequence[float]]) -> Rows:
    """The product of a mounting's rows and a 3x3 correction in the sensor's own axes, row by row."""
    product = np.array(body_from_sensor).reshape(3, 3) @ np.array(matrix)
    a, b, c, d, e, f, g, h, i = (float(value) for value in product.flat)
    return (a, b, c, d, e, f, g, h, i)


def turn(rows: Rows, x: float, y: float, z: float) -> Vector3:
    """The product of the 3x3 matrix `rows` and (x, y, z)."""
    a, b, c, d, e, f, g, h, i = rows
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)
