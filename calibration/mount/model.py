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
from scipy.spatial.transform import Rotation

from calibration.mount.recording import ImuSamples, Indices
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
        return self._true(measured, GYRO_BIAS, GYRO_MATRIX)

    def true_force(self, measured: FloatArray) -> FloatArray:
        """Specific forces (..., 3) corrected for the accelerometer's errors, to first order."""
        return self._true(measured, ACCEL_BIAS, ACCEL_MATRIX)

    def _true(self, measured: FloatArray, bias: slice, matrix: slice) -> FloatArray:
        flaw = self.values[matrix].reshape(3, 3)
        return np.asarray((measured - self.values[bias]) @ (np.eye(3) - flaw).T)


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


# ---------------------------------------------------------------- integration
# IMU preintegration over short segments: the motion between sightings by gyroscope and accelerometer.
#
# A segment starts with an unknown pose and velocity. From there, integrating rates and specific forces gives
# rotation, velocity and position ("preintegration": Lupton and Sukkarieh, IEEE T-RO 28, 2012). Over two
# seconds this is more precise than a sighting, so the sightings of a segment must fit one such path.
#
# All segments share one uniform time grid; the first axis of each array is the segment.

SEGMENT_S: Final = 2.0
MARGIN_S: Final = 0.35  # the largest error of the stamps


@dataclass(frozen=True, slots=True)
class ImuSegments:
    """IMU samples (s, n, 3) at the middle of each grid step; segment k starts at start_s[k]."""

    start_s: FloatArray
    step_s: float
    rate: FloatArray
    force: FloatArray


@dataclass(frozen=True, slots=True)
class IntegratedAttitude:
    """Rotation since the segment's start: at grid points (s, n + 1, 3, 3), at their middles (s, n, 3, 3)."""

    at: FloatArray
    middle: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True)
class MotionSamples:
    """The motion at some times (k,): rotation, position and velocity in the segment's first axes, rate."""

    rotation: FloatArray
    position: FloatArray
    velocity: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True)
class IntegratedMotion:
    """Acceleration (s, n, 3) in each step, velocity and position (s, n + 1, 3), by the force alone."""

    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray


def split_into_segments(inertial: ImuSamples, first_s: float, last_s: float) -> ImuSegments:
    """Split a recording into segments of SEGMENT_S from `first_s` on, without those that have a gap.

    The grid of each segment extends by MARGIN_S on both sides.
    """
    step_s = inertial.period_s
    begins = np.arange(first_s, last_s, SEGMENT_S)
    gaps = inertial.gaps()
    from_s, to_s = begins - MARGIN_S, begins + SEGMENT_S + MARGIN_S
    # outside the recording the last sample is held: there are no sightings there either
    whole = ~((gaps[:, 0] < to_s[:, None]) & (gaps[:, 1] > from_s[:, None])).any(axis=1)
    start_s = from_s[whole]
    middles = start_s[:, None] + step_s * (
        np.arange(int(np.ceil((SEGMENT_S + 2.0 * MARGIN_S) / step_s))) + 0.5
    )
    at = [np.interp(middles, inertial.time_s, column) for column in (*inertial.rate.T, *inertial.force.T)]
    return ImuSegments(start_s, step_s, np.stack(at[:3], axis=-1), np.stack(at[3:], axis=-1))


def integrate_rates(segments: ImuSegments, rate: FloatArray) -> IntegratedAttitude:
    """Integrate rates (s, n, 3), each constant within its step."""
    half = exp(rate * (0.5 * segments.step_s))
    steps = half @ half
    at = np.empty((rate.shape[0], rate.shape[1] + 1, 3, 3))
    at[:, 0] = np.eye(3)
    for k in range(rate.shape[1]):
        at[:, k + 1] = at[:, k] @ steps[:, k]
    return IntegratedAttitude(at, at[:, :-1] @ half, rate)


def integrate_forces(
    segments: ImuSegments, attitude: IntegratedAttitude, force: FloatArray
) -> IntegratedMotion:
    """Integrate specific forces (s, n, 3) twice in the segment's first body axes."""
    h = segments.step_s
    acceleration = (attitude.middle @ force[..., None])[..., 0]
    start = np.zeros((force.shape[0], 1, 3))
    velocity = np.concatenate((start, np.cumsum(acceleration * h, axis=1)), axis=1)
    steps = velocity[:, :-1] * h + (0.5 * h * h) * acceleration
    return IntegratedMotion(acceleration, velocity, np.concatenate((start, np.cumsum(steps, axis=1)), axis=1))


def at_times(
    segments: ImuSegments,
    attitude: IntegratedAttitude,
    motion: IntegratedMotion,
    which: Indices,
    since_s: FloatArray,
) -> MotionSamples:
    """The motion of segments `which` (k,), `since_s` (k,) after their beginning."""
    index = np.clip((since_s / segments.step_s).astype(int), 0, attitude.rate.shape[1] - 1)
    rest = (since_s - index * segments.step_s)[:, None]
    rate, acceleration = attitude.rate[which, index], motion.acceleration[which, index]
    velocity = motion.velocity[which, index]
    return MotionSamples(
        rotation=attitude.at[which, index] @ exp(rate * rest),
        position=motion.position[which, index] + velocity * rest + 0.5 * acceleration * rest**2,
        velocity=velocity + acceleration * rest,
        rate=rate,
    )


# ---------------------------------------------------------------- rotations
# `companion.base.geometry` decides order and sign; these are the same functions over a leading axis.

SMALL_RAD = 1e-6


def exp(v: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    matrices = Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()
    return np.asarray(matrices.reshape(*v.shape, 3))


def log(matrices: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), the shortest way, of rotation matrices (..., 3, 3).

    By the antisymmetric part: exact to a thousandth of a degree of half a turn, where the axis is lost.
    """
    across = 0.5 * np.stack(
        (
            matrices[..., 2, 1] - matrices[..., 1, 2],
            matrices[..., 0, 2] - matrices[..., 2, 0],
            matrices[..., 1, 0] - matrices[..., 0, 1],
        ),
        axis=-1,
    )
    sine = np.linalg.norm(across, axis=-1)
    cosine = 0.5 * (np.trace(matrices, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > SMALL_RAD, angle / np.maximum(sine, SMALL_RAD), 1.0)
    return np.asarray(across * factor[..., None])


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation (3, 3) that maximises trace(R' matrix) (Kabsch; Umeyama's sign)."""
    u, _, vt = np.linalg.svd(matrix)
    turn = np.diag((1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))))
    return np.asarray(u @ turn @ vt)
