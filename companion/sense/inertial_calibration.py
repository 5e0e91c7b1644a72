"""The inertial calibration (`calibrate-mount accelerometer`, `gyro`) as the driver applies it.

The file holds it in sensor axes, a = M (a_raw - o) and w = w_raw - b. The driver turns counts into body axes
by one matrix each, so M goes into that matrix, and what is to be taken off is turned into body axes once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.config import ImuConfig, InertialCalibration, load_model
from companion.geometry import Vector3, vector3
from companion.sense.mounting import Rows, mounting_rows


@dataclass(frozen=True, slots=True)
class Offsets:
    """What is taken off in body axes: rate (rad/s) and specific force (m/s²)."""

    rate: Vector3
    force: Vector3


def load_inertial(config: ImuConfig) -> InertialCalibration | None:
    """The calibration that the settings name, if they name one.

    Raises:
        ConfigError: the file is missing or wrong.
    """
    name = config.inertial_calibration
    return None if name is None else load_model(InertialCalibration, Path(name))


def calibrated(
    gyro: Rows, accel: Rows, body_from_sensor_deg: Vector3, inertial: InertialCalibration
) -> tuple[Rows, Rows, Offsets]:
    """The driver's matrices (counts to body axes) with the calibration in them, and what to take off."""
    mounting = _matrix(mounting_rows(body_from_sensor_deg, 1.0))
    rate = vector3(mounting @ inertial.gyro.bias_rad_s)
    found = inertial.accelerometer
    if found is None:
        return gyro, accel, Offsets(rate, (0.0, 0.0, 0.0))
    scale = np.array(found.matrix)
    # mounting M mounting' is M in body axes: the mounting already stands in the driver's matrix
    turned = mounting @ scale @ mounting.T @ _matrix(accel)
    force = vector3(mounting @ scale @ np.array(found.offset_m_s2))
    a, b, c, d, e, f, g, h, i = (float(value) for value in turned.flat)
    return gyro, (a, b, c, d, e, f, g, h, i), Offsets(rate, force)


def _matrix(rows: Rows) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.array(rows).reshape(3, 3)
