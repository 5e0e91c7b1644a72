"""What the pad filter is measured against: one model, a fading (Singer) acceleration on three axes alike.

It takes all that a sighting claims for noise, and its settings are those it flew with.
"""

import math
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.base.geometry import FloatArray
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.pad_types import PadMeasurement

JERK_M_S3_RTHZ = 1.0
TIME_CONSTANTS_S = (1.5, 1.5, 1.0)
VEHICLE_M_S2_RTHZ = 0.08
NOISE_SCALE = 1.5
NOISE_FLOOR_M = 0.001
FIRST_STD = (2.0, 2.0, 0.4)
_SEE = np.eye(3, 9)


class Snapshot(NamedTuple):
    """State and covariance at a time; x is None before the first sighting."""

    time_s: float
    x: FloatArray | None
    P: FloatArray


class Estimate(NamedTuple):
    """x (9,) and P (9, 9): position, velocity, acceleration."""

    x: FloatArray
    P: FloatArray


class SingleModelFilter:
    """Position, velocity and acceleration (9,) by one filterpy filter."""

    def __init__(self, motion: MotionHistory) -> None:
        self._motion = motion
        self._filter = KalmanFilter(dim_x=9, dim_z=3)
        self._time_s = -math.inf

    def snapshot(self) -> Snapshot:
        started = self._time_s > -math.inf
        return Snapshot(self._time_s, self._filter.x if started else None, self._filter.P)

    def restore(self, snapshot: Snapshot) -> None:
        self._time_s, x, self._filter.P = snapshot
        if x is not None:
            self._filter.x = x

    def apply(self, time_s: float, fix: PadMeasurement) -> None:
        R = NOISE_SCALE**2 * (fix.covariance_ned_m2 + fix.slow_variance_m2 * np.eye(3))
        R = R + NOISE_FLOOR_M**2 * np.eye(3)
        if self._time_s == -math.inf:
            self._start(fix, R)
        else:
            F, Q, u = self._step(self._time_s, time_s)
            self._filter.predict(u=u, B=np.eye(9), F=F, Q=Q)
            self._filter.update(np.array(fix.position_ned_m)[:, None], R=R, H=_SEE)
        self._time_s = time_s

    def predicted(self, snapshot: Snapshot, time_s: float) -> Estimate | None:
        if snapshot.x is None:
            return None
        F, Q, u = self._step(snapshot.time_s, time_s)
        return Estimate((F @ snapshot.x + u)[:, 0], F @ snapshot.P @ F.T + Q)

    def _start(self, fix: PadMeasurement, R: FloatArray) -> None:
        x, P = np.zeros((9, 1)), np.zeros((9, 9))
        x[:3, 0], x[3:6, 0] = fix.position_ned_m, np.negative(fix.vehicle_velocity_ned_m_s)
        P[:3, :3], P[3:6, 3:6] = R, np.diag(np.square(FIRST_STD))
        P[6:, 6:] = np.diag([0.5 * JERK_M_S3_RTHZ**2 * tau for tau in TIME_CONSTANTS_S])
        self._filter.x, self._filter.P = x, P

    def _step(self, start_s: float, end_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        dt, F, u = end_s - start_s, np.eye(9), np.zeros((9, 1))
        for axis, tau in enumerate(TIME_CONSTANTS_S):
            fade = math.exp(-dt / tau)
            gain = tau * (1.0 - fade)
            F[axis, 3 + axis], F[axis, 6 + axis] = dt, tau * (dt - gain)
            F[3 + axis, 6 + axis], F[6 + axis, 6 + axis] = gain, fade
        place, speed, _ = self._motion.moved(start_s, end_s)
        u[:3, 0], u[3:6, 0] = place, speed
        return F, _noise(dt), -u


def _noise(dt: float) -> FloatArray:
    jerk, vehicle = JERK_M_S3_RTHZ**2, VEHICLE_M_S2_RTHZ**2
    axis = jerk * np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    axis[:2, :2] += vehicle * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return np.asarray(np.kron(axis, np.eye(3)), dtype=np.float64)
