"""The IMU calibration file and the summary lines, from the fits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration.mount.imu.six_faces import AccelerometerFit, GyroFit, fitting_mountings, mounting_matrix
from calibration.mount.imu.static_intervals import StaticInterval
from companion.base.geometry import Vector3, vector3
from companion.config import AccelerometerCalibration, GyroCalibration


def accelerometer_calibration(fit: AccelerometerFit, faces: Sequence[str]) -> AccelerometerCalibration:
    """The file's accelerometer part."""
    rows = np.round(fit.matrix, 6)
    return AccelerometerCalibration(
        offset_m_s2=vector3(np.round(fit.offset, 5)),
        matrix=(vector3(rows[0]), vector3(rows[1]), vector3(rows[2])),
        residual_m_s2=round(float(np.sqrt(np.mean(fit.residuals**2))), 5),
        faces=len(faces),
    )


def gyro_calibration(fit: GyroFit) -> GyroCalibration:
    """The file's gyroscope part; if the temperature is unknown, room temperature."""
    return GyroCalibration(
        bias_rad_s=vector3(np.round(fit.bias, 7)),
        std_rad_s=round(fit.std, 7),
        temperature_c=round(fit.temperature_c, 1) if math.isfinite(fit.temperature_c) else 20.0,
    )


def accelerometer_lines(fit: AccelerometerFit, faces: Sequence[str]) -> list[str]:
    """Summary lines of the accelerometer."""
    before, after = (float(np.sqrt(np.mean(m**2))) for m in (fit.raw_residuals, fit.residuals))
    skew = np.abs(fit.matrix - np.diag(np.diag(fit.matrix))).max()
    return [
        f"rests         {len(fit.residuals)}, faces down: {', '.join(faces)}",
        f"offset        {_list(fit.offset, '+.3f')} m/s² "
        f"(standard deviations {_list(fit.offset_std, '.3f')})",
        f"scale         {_list(np.diag(fit.matrix), '.4f')} (standard deviations "
        f"{_list(fit.scale_std, '.4f')}), skew up to {skew:.4f}",
        f"|a| - g       {before:.3f} m/s² rms as measured, {after:.4f} calibrated",
    ]


def gyro_lines(fit: GyroFit) -> list[str]:
    """Summary lines of the gyroscope."""
    bias, std = np.degrees(fit.bias), math.degrees(fit.std)
    warmth = f" at {fit.temperature_c:.0f} °C" if math.isfinite(fit.temperature_c) else ""
    return [f"gyroscope     {_list(bias, '+.3f')} deg/s at rest{warmth}, changing by {std:.3f} between rests"]


def mounting_line(
    asked: Sequence[str], rests: Sequence[StaticInterval], configured_deg: Vector3
) -> str | None:
    """What is wrong with `body_from_sensor_deg`, by the faces asked for and measured; None: nothing found.

    If no mounting fits, the faces came in another order than asked; that says nothing about the mounting.
    """
    fitting = fitting_mountings(asked, rests)
    now = mounting_matrix(configured_deg)
    if any(np.abs(mounting_matrix(m) - now).max() < 0.5 for m in fitting):
        return None
    is_said = f"sense.imu.body_from_sensor_deg is [{_list(configured_deg, 'g', ', ')}]"
    if len(fitting) == 1:
        return f"{is_said}; what was asked and felt fits [{_list(fitting[0], 'g', ', ')}]"
    if fitting:
        return f"{is_said}, which does not fit what was asked and felt"
    return None


def _list(values: object, form: str, between: str = " ") -> str:
    return between.join(format(float(v), form) for v in np.asarray(values).tolist())
