"""State and covariance of the 31-state EKF: prediction, correction (eq. 17) and reset.

The correction is filterpy's. The prediction is our own: it leaves out the states that do not move.

`x` and `P` are replaced and never changed in place, so that a snapshot costs nothing. NED and FRD, SI, µT.

The IMU drives the motion, and its noise enters where its biases do. White noise also drives the biases and
the field.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import EYE3, FloatArray, Quaternion, euler_from_quat, quat_normalise
from companion.base.late_import import imported_late
from companion.config import EkfConfig
from companion.estimate.gating import Gate, fits
from companion.estimate.motion import LONGEST_STEP_S, unseen_turn_rad2, unseen_velocity_m2_s2
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf_start import (
    TINY_VARIANCE,
    InitialState,
    initial_covariance,
    initial_state,
    noise_density,
)
from companion.estimate.vehicle.fix_watch import FORCE_ERROR_S, FixWatch
from companion.estimate.vehicle.imu_noise import STEADY, StepNoise
from companion.estimate.vehicle.innovation_watch import InnovationWatch
from companion.estimate.vehicle.yaw_error import GYRO_SCALE_ERROR, YawError

# its statistics and its grid filter bring all of scipy.stats and scipy.ndimage, a third of our start
with imported_late("filterpy.stats", "filterpy.discrete_bayes"):
    from filterpy.kalman import ExtendedKalmanFilter

FIXES: Final = frozenset({"gps_velocity", "gps_position"})
EYE4: Final = model.EYE[model.QUATERNION, model.QUATERNION]


class EkfSnapshot(NamedTuple):
    """All of the filter; the arrays are never written to again.

    `moved` (31, 31) is how an error before the last input has become one after it; None when the input has
    reset states, so that none has.
    """

    time_s: float
    x: FloatArray
    P: FloatArray
    gates: dict[str, Gate]
    has_position: bool
    gps_time_s: float
    fix_watch: FixWatch
    moved: FloatArray | None
    watch: InnovationWatch
    yaw_error: YawError


class EkfState:
    """x and P of the filter with its gates; `ekf_model` has the state's order."""

    def __init__(self, config: EkfConfig, start: InitialState) -> None:
        self._config = config
        self._noise = noise_density()
        self._filter = ExtendedKalmanFilter(model.STATES, dim_z=3)
        self.time_s = start.time_s
        self.x = initial_state(start)
        self.P = initial_covariance(config, start)
        self.gates: dict[str, Gate] = {}
        self.has_position = False
        self.gps_time_s = -math.inf
        self.fix_watch = FixWatch()
        self.watch = InnovationWatch()
        self.yaw_error = YawError.first()
        self.force_density_m2_s3 = 0.0  # of the force's own noise on an axis, in the last prediction
        self._moved: FloatArray | None = model.EYE
        self._rotation: tuple[FloatArray, FloatArray, FloatArray] | None = None  # its covariance, of x and P

    def snapshot(self) -> EkfSnapshot:
        """The whole state; cheap, since nothing is changed in place."""
        return EkfSnapshot(
            *(self.time_s, self.x, self.P, self.gates, self.has_position, self.gps_time_s, self.fix_watch),
            *(self._moved, self.watch, self.yaw_error),
        )

    def restore(self, snapshot: EkfSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.x, self.P, self.gates, self.has_position = snapshot[:5]
        self.gps_time_s, self.fix_watch, self._moved, self.watch, self.yaw_error = snapshot[5:]

    @property
    def attitude(self) -> Quaternion:
        """Body to NED."""
        return model.quaternion_of(self.x)

    def rotation_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the attitude as a small rotation about NED axes (rad²)."""
        if self._rotation is None or self._rotation[0] is not self.x or self._rotation[1] is not self.P:
            P = self.P[model.QUATERNION, model.QUATERNION]
            self._rotation = self.x, self.P, model.rotation_covariance(self.attitude, P)
        return self._rotation[2]

    def motion_covariance(self) -> FloatArray:
        """Covariance (9, 9): small rotation about NED axes (rad), velocity NED (m/s), position NED (m)."""
        rotation = model.rotation_from_quaternion(self.attitude) @ model.EYE[model.QUATERNION]
        J = np.vstack((rotation, model.EYE[model.VELOCITY], model.EYE[model.POSITION]))
        covariance: FloatArray = J @ self.P @ J.T
        return covariance

    # ------------------------------------------------------------ eq. 17

    def predict(
        self,
        time_s: float,
        u: model.InertialInput,
        samples: int = 1,
        noise: StepNoise = STEADY,
        span_s: float | None = None,
    ) -> None:
        """x⁻ = f(x⁺, u), P⁻ = A P⁺ Aᵀ + G Q Gᵀ up to time_s; earlier or equal times change nothing.

        What moves meanwhile moves for `span_s`, when it is given.
        """
        if time_s <= self.time_s:
            return
        dt_s = time_s - self.time_s if span_s is None else span_s
        n, m = model.MOVING, model.COUPLED
        P = self.P.copy()
        diagonal = P.reshape(-1)[:: model.STATES + 1]
        diagonal += self._noise * dt_s
        yaw_rad_s = 0.0  # before any fix nothing has taught what it is measured as: noise, as of other turns
        if self.has_position:
            yaw_rad_s = u[0][2] - float(self.x[model.GYRO_BIAS][2])
        u = self.yaw_error.taken_off(u[0], yaw_rad_s), u[1]
        self.x, A = model.transition(self.x, u, dt_s)
        before = self.yaw_error.with_state
        self.yaw_error, G = self.yaw_error.predicted(A, yaw_rad_s, dt_s)
        P[:n] = A @ P[:m] + G @ before.T
        P[:, :n] = P[:, :m] @ A.T + self.yaw_error.with_state @ G.T
        self.force_density_m2_s3 = self._force_density(noise, dt_s, samples)
        turn_variance, velocity_variance = self._inertial_noise(noise, dt_s, samples)
        velocity_std, turn_std = math.sqrt(velocity_variance), math.sqrt(turn_variance)
        G = A[:, model.IMU_BIASES] / dt_s * np.array((*[velocity_std] * 3, *[turn_std] * 3))
        P[:n, :n] += G @ G.T
        diagonal[:7] += TINY_VARIANCE
        self.P = P
        self._moved = model.EYE.copy()
        self._moved[:n, :m] = A
        self.time_s = time_s

    def _force_density(self, noise: StepNoise, dt_s: float, samples: int) -> float:
        """Density (m²/s³) of the force's own noise: the element's, and what vibration leaves.

        What a gap hides is no noise of the samples around it.
        """
        between_s = min(dt_s, LONGEST_STEP_S) / samples
        return self._config.accel_noise_m_s2**2 * between_s + noise.force_density_m2_s3

    def _inertial_noise(self, noise: StepNoise, dt_s: float, samples: int) -> tuple[float, float]:
        """Variance an axis of the step's turn (rad²) and change of velocity (m²/s²).

        Scale errors and misalignment are proportional to the turn, and a turn keeps its direction for about
        a second. Of a longer step than any in a healthy stream see `unseen_velocity_m2_s2`.
        """
        config = self._config
        p, q, r = noise.lasting_rate_rad_s
        r = 0.0 if self.has_position else r  # a yaw's are in `yaw_error`
        turn = (config.gyro_noise_rad_s * dt_s) ** 2 / samples + noise.rate_density_rad2_s * dt_s
        turn += GYRO_SCALE_ERROR**2 * (p * p + q * q + r * r) * dt_s
        velocity = self.force_density_m2_s3 * dt_s
        velocity += noise.force_error_m_s2**2 * FORCE_ERROR_S * dt_s
        return turn + unseen_turn_rad2(dt_s), velocity + unseen_velocity_m2_s2(dt_s)

    def _update(
        self, kind: str, innovation: FloatArray, C: FloatArray, R: FloatArray, gate_noise: FloatArray | None
    ) -> bool:
        """An update with noise R; False when the innovation fails its test with noise `gate_noise`.

        The two differ where R is larger to make up for errors that are alike in many samples.
        """
        if gate_noise is not None:
            passed = fits(innovation, C @ self.P @ C.T + gate_noise)
            self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}
            if not passed:
                return False
        self._correct(innovation, C, R, kind in FIXES)
        return True

    def _correct(self, innovation: FloatArray, C: FloatArray, R: FloatArray, by_fix: bool = False) -> None:
        """x⁺ = x⁻ + K y, P⁺ = (I - K C) P⁻ (I - K C)ᵀ + K R Kᵀ; then the quaternion's share is corrected."""
        ekf = self._filter
        ekf.x, ekf.P = self.x, self.P
        ekf.update(innovation, lambda _: C, lambda _: 0.0, R)
        x, P, L = ekf.x, ekf.P, model.EYE - ekf.K @ C
        J = self._normalise(x)
        yaw_error = self.yaw_error.learnt(innovation, C, ekf.SI) if by_fix else self.yaw_error
        self.yaw_error = yaw_error.considered(C, ekf.K, J)
        P[model.QUATERNION] = J @ P[model.QUATERNION]
        P[:, model.QUATERNION] = P[:, model.QUATERNION] @ J.T
        P = 0.5 * (P + P.T)
        P.reshape(-1)[: 7 * (model.STATES + 1) : model.STATES + 1] += TINY_VARIANCE
        self.x, self.P = x, P
        if self._moved is not None:
            L[model.QUATERNION] = J @ L[model.QUATERNION]
            self._moved = L @ self._moved

    @staticmethod
    def _normalise(x: FloatArray) -> FloatArray:
        """Quaternion to unit length, and what that does to its errors: J (4, 4) = (I - q qᵀ) / |q|."""
        w, i, j, k = x[model.QUATERNION].tolist()
        size = math.sqrt(w * w + i * i + j * j + k * k)
        unit = quat_normalise((w, i, j, k))
        q = np.array(unit)
        x[model.ATTITUDE] = (*unit, *euler_from_quat(unit))
        return np.asarray((EYE4 - q[:, None] * q) / size)

    def _widen(self, states: slice, std: float) -> None:
        """Three states may have changed by a standard deviation of so much, each for itself."""
        P = self.P.copy()
        P[states, states] += std**2 * EYE3
        self.P = P

    def _inflate_rotation(self, rotation_variance: FloatArray) -> None:
        """Add variance (3, 3) of a small rotation about NED axes (rad²) to quaternion and Euler angles."""
        P, q = self.P.copy(), self.attitude
        J = np.vstack((EYE4, model.euler_jacobian(q)))
        P[:7, :7] += J @ model.attitude_covariance(q, rotation_variance) @ J.T
        P.reshape(-1)[: 7 * (model.STATES + 1) : model.STATES + 1] += TINY_VARIANCE
        self.P = P

    def _set_anew(
        self, states: slice, values: FloatArray | tuple[float, ...], covariance: FloatArray
    ) -> None:
        """Take values with their covariance for states that have proved wrong: what these had in common with
        the others is gone.
        """
        x, P = self.x.copy(), self.P.copy()
        x[states] = values
        P[states, :] = P[:, states] = 0.0
        P[states, states] = covariance
        self.x, self.P, self._moved = x, P, None
        self.yaw_error = self.yaw_error.without(states)

    def _start_attitude(self, attitude: Quaternion, rotation_variance: FloatArray) -> None:
        """Take another attitude: the filter's own has proved wrong."""
        self._set_anew(model.ATTITUDE, (*attitude, *euler_from_quat(attitude)), np.zeros((7, 7)))
        self._inflate_rotation(rotation_variance)
        self.gates = {**self.gates, "orientation": self.gates.get("orientation", Gate()).opened()}
