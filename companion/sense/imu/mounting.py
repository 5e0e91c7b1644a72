"""How a chip is mounted and calibrated: its own numbers to the body's axes, in plain floats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.base.geometry import ZERO3, FloatArray, Vector3, matrix_from_quat, quat_from_euler

Rows = tuple[float, float, float, float, float, float, float, float, float]


class BodyAxes(NamedTuple):
    """From a sensor's numbers into the body's axes: `rows` (3x3, row by row) times (numbers - `zero`)."""

    rows: Rows
    zero: Vector3
    factor: float

    def of(self, x: float, y: float, z: float) -> Vector3:
        """The vector (x, y, z) of the sensor's numbers in the body's axes."""
        a, b, c, d, e, f, g, h, i = self.rows
        zx, zy, zz = self.zero
        x, y, z = x - zx, y - zy, z - zz
        return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)

    def corrected(self, matrix: Sequence[Sequence[float]] | None, offset: Vector3) -> BodyAxes:
        """With a calibration in the sensor's own axes and units: true = matrix (measured - offset)."""
        rows = np.array(self.rows).reshape(3, 3) @ (np.eye(3) if matrix is None else np.array(matrix))
        x, y, z = offset
        return BodyAxes(_rows(rows), (x / self.factor, y / self.factor, z / self.factor), self.factor)


def body_axes(body_from_sensor_deg: Vector3, factor: float) -> BodyAxes:
    """Body axes from a chip mounted so: roll, pitch, yaw (deg) turn its axes into the body's.

    `factor` is what one of its numbers is worth, in the unit of measurement.
    """
    return BodyAxes(_rows(mounting_matrix(body_from_sensor_deg) * factor), ZERO3, factor)


def mounting_matrix(body_from_sensor_deg: Vector3) -> FloatArray:
    """Rotation (3, 3) from a chip's axes into the body's (FRD), of its roll, pitch and yaw."""
    roll, pitch, yaw = (math.radians(angle) for angle in body_from_sensor_deg)
    return matrix_from_quat(quat_from_euler(roll, pitch, yaw))


def _rows(matrix: FloatArray) -> Rows:
    a, b, c, d, e, f, g, h, i = (float(value) for value in matrix.flat)
    return (a, b, c, d, e, f, g, h, i)
