"""Accelerometer calibration by the six-position method, and the gyroscope's bias. Pure, sensor axes.

At rest an accelerometer measures g in any attitude: |M (a - o)| = g for every static interval, with an offset
o and a matrix M of scale and skew. The norm does not observe a rotation, so M is symmetric and the configured
mounting stays. Six faces determine offset and scale, even if the vehicle lies on them at an angle (a second
order error). The skew needs more than six attitudes. Until then a prior from the data sheet holds it near
zero (MPU-9250, PS-MPU-9250A-01 table 2: ±2 % cross-axis, ±3 % scale).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.clipping import clipped_axes
from calibration.mount import FACES
from calibration.mount.recording import ImuSamples, Indices, rows_of
from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3, euler_from_quat, quat_from_matrix
from companion.base.messages import ImuSample

MEAN_STD_M_S2: Final = 0.01  # of an interval's mean: noise, and thermal drift within minutes
OFFSET_STD_M_S2: Final = 0.6
SCALE_STD: Final = 0.02
SKEW_STD: Final = 0.01
FACE_DEG: Final = 30.0

ASKED: Final[dict[str, str]] = {
    "level": "lay it down level, as it flies",
    "upside-down": "lay it upside down",
    "nose-down": "stand it on its nose",
    "nose-up": "stand it on its tail, nose up",
    "right-down": "lay it on its right side",
    "left-down": "lay it on its left side",
}


@dataclass(frozen=True, slots=True)
class AccelerometerFit:
    """True force = matrix (3, 3) (measured - offset (3,)); misses (n,) of |a| - g, before and after."""

    matrix: FloatArray
    offset: FloatArray
    offset_std: FloatArray
    scale_std: FloatArray
    raw_residuals: FloatArray
    residuals: FloatArray


@dataclass(frozen=True, slots=True)
class GyroFit:
    """Bias (3,) rad/s; `std` is the scatter of the intervals' own biases about it, rad/s."""

    bias: FloatArray
    std: float
    temperature_c: float


def fit_accelerometer(rests: Sequence[StaticInterval]) -> AccelerometerFit:
    """Least squares over all static intervals, with the data sheet as a prior."""
    forces = np.array([rest.force for rest in rests])
    scale = np.where(np.eye(3) > 0.0, SCALE_STD, SKEW_STD).ravel()
    prior_std = np.concatenate((np.full(3, OFFSET_STD_M_S2), scale))

    def residuals(x: FloatArray) -> FloatArray:
        residuals = _sizes(forces, x[:3], np.eye(3) + x[3:].reshape(3, 3)) - GRAVITY_M_S2
        return np.concatenate((residuals / MEAN_STD_M_S2, x / prior_std))

    found = least_squares(residuals, np.zeros(12), x_scale=prior_std, method="lm")
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    std = np.sqrt(np.diag(covariance))
    offset, matrix = found.x[:3], np.eye(3) + found.x[3:].reshape(3, 3)
    return AccelerometerFit(
        matrix=0.5 * (matrix + matrix.T),
        offset=offset,
        offset_std=std[:3],
        scale_std=std[[3, 7, 11]],
        raw_residuals=np.linalg.norm(forces, axis=1) - GRAVITY_M_S2,
        residuals=_sizes(forces, offset, 0.5 * (matrix + matrix.T)) - GRAVITY_M_S2,
    )


def _sizes(forces: FloatArray, offset: FloatArray, matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm((forces - offset) @ matrix.T, axis=1))


def fit_gyro(rests: Sequence[StaticInterval]) -> GyroFit:
    """The mean over all static intervals, weighted by their sample counts."""
    weight = np.array([rest.samples for rest in rests], dtype=float)
    rates = np.array([rest.rate for rest in rests])
    bias = weight @ rates / weight.sum()
    spread = float(np.sqrt(weight @ ((rates - bias) ** 2).mean(axis=1) / weight.sum()))
    warmth = np.array([rest.temperature_c for rest in rests])
    return GyroFit(bias, spread, float(weight @ warmth / weight.sum()))


# ---------------------------------------------------------------- faces and the mounting


def face_of(force: FloatArray, body_from_sensor: FloatArray) -> str | None:
    """Which face is down at a specific force (3,) in sensor axes; None when it lies on an edge."""
    down = -(body_from_sensor @ force) / np.linalg.norm(force)
    name, axis = max(FACES.items(), key=lambda item: float(np.dot(item[1], down)))
    return name if float(np.dot(axis, down)) > math.cos(math.radians(FACE_DEG)) else None


def faces_down(rests: Sequence[StaticInterval], body_from_sensor: FloatArray) -> list[str]:
    seen = {face_of(rest.force, body_from_sensor) for rest in rests}
    return [name for name in FACES if name in seen]


def fitting_mountings(asked: Sequence[str], rests: Sequence[StaticInterval]) -> list[Vector3]:
    """The right-angled mountings (roll, pitch, yaw; deg) with the asked face down in every interval."""
    fitting = []
    for matrix in np.rint(Rotation.create_group("O").as_matrix()) + 0.0:  # the 24 by quarter turns
        if all(face_of(rest.force, matrix) == name for name, rest in zip(asked, rests, strict=True)):
            roll, pitch, yaw = (
                round(math.degrees(a)) + 0.0 for a in euler_from_quat(quat_from_matrix(matrix))
            )
            fitting.append((roll, pitch, yaw))
    return fitting


# ---------------------------------------------------------------- verdict

MOST_RESIDUAL_M_S2: Final = 0.05
MOST_OFFSET_M_S2: Final = 1.5
MOST_SCALE: Final = 0.1
MOST_GYRO_STD_RAD_S: Final = math.radians(0.1)
MOST_BIAS_RAD_S: Final = math.radians(20.0)
MOST_WARMING_C: Final = 8.0


def accelerometer_reasons(
    fit: AccelerometerFit, rests: Sequence[StaticInterval], faces: Sequence[str]
) -> tuple[str, ...]:
    """Reasons to refuse an accelerometer calibration; empty if it is good."""
    found = []
    if missing := [name for name in FACES if name not in faces]:
        found.append(f"never lay still on: {', '.join(missing)}; expected all six faces")
    found += [
        f"the {'xyz'[axis]} axis reads {rest.force[axis]:.2f} m/s² and no more from {rest.from_s:.1f} to "
        f"{rest.to_s:.1f} s; expected its noise, within its range (too small a range, or a broken chip?)"
        for rest in rests
        for axis in rest.clipped
    ]
    residual = float(np.sqrt(np.mean(fit.residuals**2)))
    if residual > MOST_RESIDUAL_M_S2:
        found.append(
            f"the rests do not agree: |a| misses g by {residual:.3f} m/s² rms, expected "
            f"{MOST_RESIDUAL_M_S2:g} at most (was it moved while it lay?)"
        )
    if np.abs(fit.offset).max() > MOST_OFFSET_M_S2:
        found.append(
            f"an offset of {np.abs(fit.offset).max():.2f} m/s²; expected {MOST_OFFSET_M_S2:g} at most "
            "(a broken chip, or another range than the settings'?)"
        )
    if np.abs(np.diag(fit.matrix) - 1.0).max() > MOST_SCALE:
        found.append(
            f"a scale of {np.diag(fit.matrix)[np.argmax(np.abs(np.diag(fit.matrix) - 1.0))]:.3f}; expected "
            f"1 within {MOST_SCALE:g} (another range than the settings', or another unit?)"
        )
    return (*found, *gyro_reasons(fit_gyro(rests), rests))


def gyro_reasons(fit: GyroFit, rests: Sequence[StaticInterval]) -> tuple[str, ...]:
    """Reasons to refuse a gyroscope bias; empty if it is good."""
    found = []
    if fit.std > MOST_GYRO_STD_RAD_S:
        found.append(
            f"the gyroscope's bias changed by {math.degrees(fit.std):.2f}°/s between rests; expected "
            f"{math.degrees(MOST_GYRO_STD_RAD_S):g}°/s at most (let it warm up)"
        )
    if np.linalg.norm(fit.bias) > MOST_BIAS_RAD_S:
        found.append(
            f"a bias of {math.degrees(float(np.linalg.norm(fit.bias))):.0f}°/s; expected less than "
            f"{math.degrees(MOST_BIAS_RAD_S):g}°/s (was it turning?)"
        )
    warmth = [rest.temperature_c for rest in rests]
    if max(warmth) - min(warmth) > MOST_WARMING_C:
        found.append(
            f"it warmed by {max(warmth) - min(warmth):.0f} °C meanwhile; expected {MOST_WARMING_C:g} at most "
            "(let it warm up first)"
        )
    return tuple(found)


# ---------------------------------------------------------------- static intervals
# Pure; axes as given. A static interval lasts at least REST_S. In it, both sensors scatter by no more than
# noise and the vibration of a table, and the specific force is constant. Both ends are cut off, because hands
# let go and take hold there.

BLOCK_S: Final = 0.25
REST_S: Final = 1.5
STILL_RATE_RAD_S: Final = 0.02
STILL_FORCE_M_S2: Final = 0.15
SAME_FORCE_M_S2: Final = 0.1


@dataclass(frozen=True, slots=True)
class StaticInterval:
    """Means over one static interval: specific force (3,) m/s², rate (3,) rad/s; `samples` is their count.

    `clipped` are the axes that read the end of their range (`clipped_axes`).
    """

    force: FloatArray
    rate: FloatArray
    temperature_c: float
    samples: int
    from_s: float
    to_s: float
    clipped: tuple[int, ...] = ()


def find_static_intervals(inertial: ImuSamples) -> list[StaticInterval]:
    """All static intervals of a recording, in order of time."""
    times = inertial.time_s
    if len(times) < 3:
        return []
    numbers = np.floor((times - times[0]) / BLOCK_S).astype(int)
    edges = np.concatenate(([0], np.flatnonzero(np.diff(numbers)) + 1, [len(times)]))
    forces = np.add.reduceat(inertial.force, edges[:-1], axis=0) / np.diff(edges)[:, None]
    rests, begin = [], 0
    for k in range(len(edges)):
        goes_on = k < len(edges) - 1 and _still(inertial, edges[k], edges[k + 1])
        # a block belongs to those before it if it measures the same force
        if k > begin and not (
            goes_on and np.linalg.norm(forces[k] - forces[begin:k].mean(axis=0)) < SAME_FORCE_M_S2
        ):
            rests += _rest(inertial, edges, begin, k)
            begin = k
        if not goes_on:
            begin = k + 1
    return rests


def _still(inertial: ImuSamples, a: int, b: int) -> bool:
    if b - a < 3:
        return False
    rate = float(np.linalg.norm(inertial.rate[a:b].std(axis=0)))
    force = float(np.linalg.norm(inertial.force[a:b].std(axis=0)))
    return rate < STILL_RATE_RAD_S and force < STILL_FORCE_M_S2


def _rest(inertial: ImuSamples, edges: Indices, begin: int, end: int) -> list[StaticInterval]:
    """The static interval from block `begin` to `end`, without the first and last block, if long enough."""
    if (end - begin) * BLOCK_S < REST_S:
        return []
    inside = slice(int(edges[begin + 1]), int(edges[end - 1]))
    times = inertial.time_s[inside]
    return [
        StaticInterval(
            inertial.force[inside].mean(axis=0),
            inertial.rate[inside].mean(axis=0),
            float(np.mean(inertial.temperature_c[inside])),
            len(times),
            float(times[0]),
            float(times[-1]),
            clipped_axes(inertial.force[inside], inertial.force),
        )
    ]


# ---------------------------------------------------------------- guide
# A face counts once the vehicle has lain on it for HOLD_S, whichever face was asked for: the calibration
# needs no order. If the face asked for and the face measured differ, the configured mounting of the chip is
# wrong.

HOLD_S: Final = 3.0
# minimum rotation between two static intervals
TURNED_RAD: Final = 0.8


class ImuBuffer:
    """IMU samples as they come, rotated back into sensor axes."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._samples: list[ImuSample] = []

    def add(self, sample: ImuSample) -> None:
        self._samples.append(sample)

    def since(self, time_s: float) -> ImuSamples:
        samples = ImuSamples.of(rows_of(s for s in self._samples if s.time_s >= time_s))
        return samples.turned(self._turn)


class FaceGuide:
    """Chooses the face to ask for next."""

    def __init__(self, body_from_sensor: FloatArray) -> None:
        self._turn = body_from_sensor
        self._left = list(FACES)
        self.asked: list[str] = []
        self.rests: list[StaticInterval] = []

    @property
    def done(self) -> bool:
        return not self._left

    @property
    def advice(self) -> str:
        if self.done:
            return "enough"
        return f"{len(self.rests) + 1} of {len(FACES)}: {ASKED[self._left[0]]}, and let go of it"

    @property
    def after_s(self) -> float:
        """The end of the last static interval; earlier samples are not needed."""
        return self.rests[-1].to_s if self.rests else -np.inf

    def take(self, inertial: ImuSamples) -> str | None:
        """Look for the next static interval in samples; returns the message to show if there is one."""
        for rest in find_static_intervals(inertial):
            if self.done or rest.to_s - rest.from_s < HOLD_S - 1.0 or not self._another(rest):
                continue
            asked = self._left.pop(0)
            self.asked.append(asked)
            self.rests.append(rest)
            felt = face_of(rest.force, self._turn)
            if felt == asked:
                return f"{asked}: taken"
            return f"taken, but the sensor feels {felt or 'an edge'} where {asked} was asked"
        return None

    def _another(self, rest: StaticInterval) -> bool:
        if not self.rests:
            return True
        last = self.rests[-1].force
        cosine = float(rest.force @ last / np.linalg.norm(rest.force) / np.linalg.norm(last))
        return cosine < math.cos(TURNED_RAD)
