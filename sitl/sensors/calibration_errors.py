"""Calibration errors of three-axis sensors: scale, misalignment and offset before calibration.

    measured = matrix @ true + offset        (the sensor's own axes, SI units, field in µT)

Of the IMU: tolerances of the MPU-9250 product specification PS-MPU-9250A-01 rev. 1.1 (tables 1 and 2), taken
as uniform. Of the magnetometer: the vehicle's iron about it, magnetised (hard: an offset) or not (soft: a
symmetric matrix, since it bends the field without turning the sensor).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray

ACCEL_OFFSET_M_S2: Final = 0.060 * GRAVITY_M_S2
ACCEL_SCALE: Final = 0.03
GYRO_OFFSET_RAD_S: Final = math.radians(5.0)
GYRO_SCALE: Final = 0.03
CROSS_AXIS: Final = 0.02
HARD_IRON_UT: Final = (20.0, 60.0)  # its size, whatever its direction
SOFT_IRON: Final = 0.3


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """measured = matrix (3, 3) @ true + offset (3,)."""

    matrix: FloatArray
    offset: FloatArray

    @classmethod
    def of(
        cls, flawed_rows: list[float], sensor_from_body: FloatArray, offset: FloatArray
    ) -> CalibrationErrors:
        """From the nine numbers, row by row, that take the truth in body axes to the sensor's."""
        return cls(np.reshape(flawed_rows, (3, 3)) @ sensor_from_body.T, np.array(offset, dtype=float))

    def rows(self, sensor_from_body: FloatArray) -> list[float]:
        """The inverse of `of`."""
        return [float(value) for value in (self.matrix @ sensor_from_body).flat]


@dataclass(frozen=True, slots=True)
class BoardTruth:
    """The true flaws of an IMU with its magnetometer: for tests and benches, never for the app.

    `sensor_from_body` (3, 3) is how it is mounted; a gyroscope's and an accelerometer's offsets wander by
    little (`ImuErrors`) about these.
    """

    accelerometer: CalibrationErrors
    gyroscope: CalibrationErrors
    magnetometer: CalibrationErrors
    sensor_from_body: FloatArray


def uncalibrated_accelerometer(rng: np.random.Generator) -> CalibrationErrors:
    """An uncalibrated one."""
    return _uncalibrated(rng, ACCEL_SCALE, ACCEL_OFFSET_M_S2)


def uncalibrated_gyroscope(rng: np.random.Generator) -> CalibrationErrors:
    """An uncalibrated one."""
    return _uncalibrated(rng, GYRO_SCALE, GYRO_OFFSET_RAD_S)


def _uncalibrated(rng: np.random.Generator, scale: float, offset: float) -> CalibrationErrors:
    flaw = CROSS_AXIS * rng.uniform(-1.0, 1.0, (3, 3))
    np.fill_diagonal(flaw, scale * rng.uniform(-1.0, 1.0, 3))
    return CalibrationErrors(np.eye(3) + flaw, offset * rng.uniform(-1.0, 1.0, 3))


def uncalibrated_magnetometer(rng: np.random.Generator) -> CalibrationErrors:
    """Hard and soft iron: principal gains 0.7 to 1.3 along random directions."""
    directions, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    gains = 1.0 + SOFT_IRON * rng.uniform(-1.0, 1.0, 3)
    way = rng.standard_normal(3)
    hard_iron = float(rng.uniform(*HARD_IRON_UT)) * way / np.linalg.norm(way)
    return CalibrationErrors(np.asarray(directions @ np.diag(gains) @ directions.T), hard_iron)
