"""The unknowns of a mount calibration, and their prior.

Common to all segments: rotation and position of the camera, time offset, tilt of the pad, the effect of the
rolling shutter on a pose, and the errors of the IMU. Per segment: its start state. A measured rate is
(I + E) w + b, and so is a force. E and b are known only to a standard deviation, which limits how well the
body axes are known: a chip whose axes are misaligned by 0.3° knows "forward" no better than that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.solve.rotations import exp
from companion.base.geometry import GRAVITY_M_S2, FloatArray

ROTATION: Final = slice(0, 3)
POSITION: Final = slice(3, 6)
OFFSET: Final = slice(6, 7)
TILT: Final = slice(7, 9)
SHUTTER: Final = slice(9, 11)
GYRO_BIAS: Final = slice(11, 14)
GYRO_MATRIX: Final = slice(14, 23)
ACCEL_BIAS: Final = slice(23, 26)
ACCEL_MATRIX: Final = slice(26, 35)
COUNT: Final = 35
# from here on an unknown changes the integrated motion; before, only the view of the camera
FIRST_OF_PATH: Final = 11

SEGMENT_STATE_COUNT: Final = 9
# of the shutter's two times, where the camera file gives none
SHUTTER_STD_S: Final = 0.003


@dataclass(frozen=True, slots=True)
class MountPrior:
    """The prior's standard deviations. The IMU's are for a calibrated MPU9250.

    Cross-axis sensitivity of ±2 % in the data sheet (PS-MPU-9250A-01, tables 1 and 2) is a bound; a quarter
    of that is usual. `lens_rad` is the error of the principal point as an angle, equal to a rotation of
    the camera. `stamp_s` is the error of the driver's IMU stamps (a tenth of a sample period).
    """

    position_m: float = 0.02  # by tape measure
    level_rad: float = math.radians(3.0)
    gyro_bias_rad_s: float = math.radians(5.0)
    gyro_scale: float = 0.005
    gyro_cross: float = 0.005
    accel_bias_m_s2: float = 0.07
    accel_scale: float = 0.003
    accel_cross: float = 0.005
    lens_rad: float = 0.003
    stamp_s: float = 0.0005

    def standard_deviations(self, shutter_s: float) -> FloatArray:
        """One for each unknown (35,); infinite where there is no prior.

        `shutter_s` is the time in which a rolling shutter passes one focal length of the image.
        """
        cross = np.eye(3)
        gyro = np.where(cross > 0.0, self.gyro_scale, self.gyro_cross)
        accel = np.where(cross > 0.0, self.accel_scale, self.accel_cross)
        out = np.full(COUNT, math.inf)
        out[POSITION], out[TILT] = self.position_m, self.level_rad
        out[SHUTTER] = 0.3 * shutter_s + SHUTTER_STD_S
        out[GYRO_BIAS], out[ACCEL_BIAS] = self.gyro_bias_rad_s, self.accel_bias_m_s2
        out[GYRO_MATRIX], out[ACCEL_MATRIX] = gyro.ravel(), accel.ravel()
        return out


@dataclass(frozen=True, slots=True)
class Unknowns:
    """The unknowns of the whole recording.

    `values` (35,) holds all but the rotation, which stands in `body_from_camera` (3, 3): its three values
    are small turns about the body's axes, and zero here.
    """

    body_from_camera: FloatArray
    values: FloatArray

    def moved(self, step: FloatArray) -> Unknowns:
        """A step (35,) further."""
        values = self.values + step
        values[ROTATION] = 0.0
        return Unknowns(exp(step[ROTATION]) @ self.body_from_camera, values)

    @property
    def gravity_pad(self) -> FloatArray:
        """Gravity (3,) m/s² in the pad's axes: straight down but for the pad's tilt."""
        x, y = self.values[TILT]
        return np.array([x, y, math.sqrt(max(1.0 - x * x - y * y, 0.0))]) * GRAVITY_M_S2

    def shutter_turn(self, closing_1_s: FloatArray, roll_rad_s: FloatArray) -> FloatArray:
        """What a rolling shutter adds to poses (k, 3), a small rotation about the camera's axes.

        Vision's pose takes out that the image drifts while its rows are read. What is left: that it grows
        (`closing_1_s`, speed along the optical axis over distance) looks like a tilt about the image's
        horizontal, and that it turns (`roll_rad_s`, about the optical axis) like half a tilt about the
        vertical. Rows k (in focal lengths) are read k s later, so grown and turned points are off by
        s k (u, v) and s k (v, -u); a tilting plane's by (uv, v²) and (u², uv).
        """
        grows, turns = self.values[SHUTTER]
        return np.stack((-grows * closing_1_s, -turns * roll_rad_s, np.zeros_like(roll_rad_s)), axis=-1)

    def true_rate(self, measured: FloatArray) -> FloatArray:
        """Rates (..., 3) corrected for the gyroscope's errors, to first order."""
        flaw = self.values[GYRO_MATRIX].reshape(3, 3)
        return np.asarray((measured - self.values[GYRO_BIAS]) @ (np.eye(3) - flaw).T)

    def true_force(self, measured: FloatArray) -> FloatArray:
        """Specific forces (..., 3) corrected for the accelerometer's errors, to first order."""
        flaw = self.values[ACCEL_MATRIX].reshape(3, 3)
        return np.asarray((measured - self.values[ACCEL_BIAS]) @ (np.eye(3) - flaw).T)


@dataclass(frozen=True, slots=True)
class SegmentStarts:
    """Start states of the segments, in the pad's axes: attitude (s, 3, 3), position and velocity (s, 3)."""

    pad_from_body: FloatArray
    position_m: FloatArray
    velocity_m_s: FloatArray

    def moved(self, steps: FloatArray) -> SegmentStarts:
        """Steps (s, 9) further: turns about the body's axes, position, velocity."""
        return SegmentStarts(
            self.pad_from_body @ exp(steps[:, :3]),
            self.position_m + steps[:, 3:6],
            self.velocity_m_s + steps[:, 6:],
        )
