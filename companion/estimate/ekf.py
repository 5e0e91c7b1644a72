"""The vehicle's 31-state extended Kalman filter (Table 5, eq. 17): IMU, magnetometer, GPS, orientation.

Asynchronous: each input predicts to its own time and updates. The filter can be put back to any earlier
snapshot (gating.Timeline does, for a fix that arrives late), so `x` and `P` are replaced and never changed
in place. NED and FRD, SI units, µT.

Process noise is white and drives the rate, the acceleration, the biases and the field. Half of a step's
noise enters before the transition and half after it: with that the covariance between rate and attitude is
what makes the gyroscope's update integrate by the trapezoid rule and not by rectangles; the same holds for
acceleration, velocity and position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from companion.config import EkfConfig
from companion.estimate import ekf_model as model
from companion.estimate.ekf_start import (
    TINY_VARIANCE,
    InitialState,
    initial_covariance,
    initial_state,
    noise_density,
)
from companion.estimate.gating import CHI_SQUARE_999, Gate, normalised_innovation_squared
from companion.geometry import FloatArray, Quaternion, Vector3, euler_from_quat, quat_normalise, quat_rotate


@dataclass(frozen=True, slots=True)
class ImuStep:
    """The mean of a few IMU samples at their mean time, and what else is known at that time.

    `attitude` is the orientation filter's; the noises are of a small rotation (rad).
    """

    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    samples: int = 1
    field_body_ut: Vector3 | None = None
    attitude: Quaternion | None = None
    tilt_noise_rad: float = 0.2
    heading_noise_rad: float = 0.35
    still: bool = False
    at_rest: bool = False


@dataclass(frozen=True, slots=True)
class GpsStep:
    """A fix in the EKF's NED: where the antenna was, and how fast."""

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    position_std_m: Vector3
    velocity_std_m_s: Vector3


EkfInput = ImuStep | GpsStep
UNKNOWN_SPEED_M_S: Final = 10.0  # a fix that doubts a component of its velocity by more does not know it


class EkfSnapshot(NamedTuple):
    """All of the filter; the arrays are never written to again."""

    time_s: float
    x: FloatArray
    P: FloatArray
    gates: dict[str, Gate]
    has_position: bool
    gps_time_s: float


class VehicleEkf:
    """x, P and the inputs' gates; see the module's text for the state's order."""

    def __init__(self, config: EkfConfig, antenna_body_m: Vector3, start: InitialState) -> None:
        self._config = config
        self._antenna_body_m = antenna_body_m
        self._half_noise = 0.5 * noise_density(config)
        self._imu_noise = np.diag([config.gyro_noise_rad_s**2] * 3 + [config.accel_noise_m_s2**2] * 3)
        self._mag_noise = config.mag_noise_ut**2 * np.eye(3)
        self._still_noise = np.diag([0.002**2] * 3)
        self._rest_noise = np.diag([0.05**2] * 3)
        self.time_s = start.time_s
        self.x = initial_state(start)
        self.P = initial_covariance(config, start)
        self.gates: dict[str, Gate] = {}
        self.has_position = False
        self.gps_time_s = -math.inf

    # ------------------------------------------------------------ replayable

    def snapshot(self) -> EkfSnapshot:
        """The whole state; cheap, since nothing is changed in place."""
        return EkfSnapshot(self.time_s, self.x, self.P, self.gates, self.has_position, self.gps_time_s)

    def restore(self, snapshot: EkfSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.x, self.P, self.gates, self.has_position, self.gps_time_s = snapshot

    def apply(self, time_s: float, item: EkfInput) -> None:
        """Predict to time_s and take the input in."""
        self.predict(time_s)
        if isinstance(item, GpsStep):
            self._take_gps(item)
        else:
            self._take_imu(item)

    # ------------------------------------------------------------ state

    @property
    def attitude(self) -> Quaternion:
        """Body to NED."""
        return model.quaternion_of(self.x)

    def rotation_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the attitude as a small rotation about NED axes (rad²)."""
        return model.rotation_covariance(self.attitude, self.P[model.QUATERNION, model.QUATERNION])

    def state_dict(self) -> dict[str, object]:
        """All of the filter as plain numbers, exact in JSON; give it to `from_state` to go on from here."""
        return {
            "time_s": self.time_s,
            "x": self.x.tolist(),
            "P": self.P.tolist(),
            "gates": {kind: list(gate) for kind, gate in self.gates.items()},
            "has_position": self.has_position,
            "gps_time_s": self.gps_time_s if math.isfinite(self.gps_time_s) else None,
        }

    @classmethod
    def from_state(cls, config: EkfConfig, antenna_body_m: Vector3, state: dict[str, object]) -> VehicleEkf:
        """A filter that goes on exactly where `state_dict` was taken.

        Raises:
            ValueError: the state is not one of 31 finite numbers and a 31 x 31 matrix.
        """
        x, P = np.array(state["x"], dtype=float), np.array(state["P"], dtype=float)
        if x.shape != (model.STATES,) or P.shape != (model.STATES, model.STATES):
            raise ValueError(f"expected 31 states and a 31 x 31 covariance, found {x.shape} and {P.shape}")
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise ValueError("expected finite numbers in the EKF's state")
        start = InitialState(0.0, (1.0, 0.0, 0.0, 0.0), (0, 0, 0), (1.0, 0.0, 0.0), 1.0, 1.0, 1.0)
        ekf = cls(config, antenna_body_m, start)
        ekf.x, ekf.P = x, P
        ekf.time_s = float(state["time_s"])  # type: ignore[arg-type]
        ekf.gates = {kind: Gate(*values) for kind, values in state["gates"].items()}  # type: ignore[attr-defined]
        ekf.has_position = bool(state["has_position"])
        gps_time_s = state["gps_time_s"]
        ekf.gps_time_s = -math.inf if gps_time_s is None else float(gps_time_s)  # type: ignore[arg-type]
        return ekf

    # ------------------------------------------------------------ eq. 17

    def predict(self, time_s: float) -> None:
        """x⁻ = f(x⁺), P⁻ = A P⁺ Aᵀ + Q up to time_s; earlier or equal times change nothing."""
        dt_s = time_s - self.time_s
        if dt_s <= 0.0:
            return
        config, n = self._config, model.MOVING
        self.x, A = model.transition(
            self.x, dt_s, config.rate_time_constant_s, config.acceleration_time_constant_s
        )
        P = self.P.copy()
        diagonal = P.reshape(-1)[:: model.STATES + 1]
        noise = self._half_noise * dt_s
        diagonal += noise
        P[:n] = A @ P[:n]
        P[:, :n] = P[:, :n] @ A.T
        diagonal += noise
        diagonal[:7] += TINY_VARIANCE
        self.P = P
        self.time_s = time_s

    def _update(self, kind: str, innovation: FloatArray, C: FloatArray, R: FloatArray, gated: bool) -> bool:
        """Joseph form; False when the innovation fails its chi-square test."""
        P = self.P
        PCt = P @ C.T
        S = C @ PCt + R
        if gated:
            passed = normalised_innovation_squared(innovation, S) <= CHI_SQUARE_999[len(innovation)]
            self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}
            if not passed:
                return False
        K = PCt @ np.linalg.inv(S)
        x = self.x + K @ innovation
        L = -(K @ C)
        L.reshape(-1)[:: model.STATES + 1] += 1.0
        self._normalise(x, K, L)
        P = L @ P @ L.T + K @ R @ K.T
        P += P.T
        P *= 0.5
        P.reshape(-1)[: 7 * (model.STATES + 1) : model.STATES + 1] += TINY_VARIANCE
        self.x, self.P = x, P
        return True

    @staticmethod
    def _normalise(x: FloatArray, K: FloatArray, L: FloatArray) -> None:
        """Quaternion to unit length, and the same for its share of the covariance: J = (I - q qᵀ) / |q|."""
        w, i, j, k = x[model.QUATERNION].tolist()
        size = math.sqrt(w * w + i * i + j * j + k * k)
        unit = quat_normalise((w, i, j, k))
        q = np.array(unit)
        J = (np.eye(4) - np.outer(q, q)) / size
        x[model.QUATERNION] = unit
        x[model.EULER] = euler_from_quat(unit)
        K[model.QUATERNION] = J @ K[model.QUATERNION]
        L[model.QUATERNION] = J @ L[model.QUATERNION]

    # ------------------------------------------------------------ measurements

    def _take_imu(self, step: ImuStep) -> None:
        expected, C = model.imu_model(self.x)
        measured = np.array(step.rate_body_rad_s + step.specific_force_body_m_s2)
        self._update("imu", measured - expected, C, self._imu_noise / step.samples, gated=False)
        if step.field_body_ut is not None:
            expected, C = model.mag_model(self.x)
            self._update("mag", np.array(step.field_body_ut) - expected, C, self._mag_noise, gated=True)
        if step.attitude is not None:
            self._take_attitude(step.attitude, step.tilt_noise_rad, step.heading_noise_rad)
        if step.still:
            self._take_zero(model.RATE, self._still_noise)
        if step.at_rest:
            self._take_zero(model.VELOCITY, self._rest_noise)

    def _take_attitude(self, attitude: Quaternion, tilt_noise_rad: float, heading_noise_rad: float) -> None:
        expected, C = model.attitude_model(self.x)
        measured = np.array(attitude)
        if measured @ expected < 0.0:
            measured = -measured
        rotation = np.diag([tilt_noise_rad**2, tilt_noise_rad**2, heading_noise_rad**2])
        # along the quaternion's length there is nothing to learn: any noise that keeps R regular
        R = model.attitude_covariance(self.attitude, rotation) + 1e-2 * np.outer(expected, expected)
        self._update("orientation", measured - expected, C, R, gated=True)

    def _take_zero(self, states: slice, R: FloatArray) -> None:
        C = np.zeros((3, model.STATES))
        C[:, states] = np.eye(3)
        self._update("still", -self.x[states], C, R, gated=False)

    def _take_gps(self, fix: GpsStep) -> None:
        patience_s = self._config.gps_patience_s
        if not self.has_position:
            self._start_from(fix)
            return
        expected, C = model.gps_velocity_model(self.x, self._antenna_body_m)
        R = np.diag(np.square(fix.velocity_std_m_s))
        fits = self._update("gps_velocity", np.array(fix.velocity_ned_m_s) - expected, C, R, gated=True)
        expected, C = model.gps_position_model(self.x, self._antenna_body_m)
        R = np.diag(np.square(fix.position_std_m))
        fits &= self._update("gps_position", np.array(fix.position_ned_m) - expected, C, R, gated=True)
        if fits:
            self.gps_time_s = self.time_s
        kinds = ("gps_velocity", "gps_position")
        if any(self.gates[kind].shut_out(self.time_s, patience_s) for kind in kinds):
            self._start_from(fix)

    def _start_from(self, fix: GpsStep) -> None:
        """Take position and velocity from the fix alone: at first, or when the old ones proved wrong.

        A component of the velocity that the fix does not know stays as it is.
        """
        q, x = self.attitude, self.x.copy()
        speed_known = np.less(fix.velocity_std_m_s, UNKNOWN_SPEED_M_S)
        x[model.POSITION] = np.subtract(fix.position_ned_m, quat_rotate(q, self._antenna_body_m))
        x[model.VELOCITY] = np.where(speed_known, fix.velocity_ned_m_s, x[model.VELOCITY])
        P = self.P.copy()
        states = slice(model.POSITION.start, model.VELOCITY.stop)
        speed_variance = np.where(
            speed_known, np.square(fix.velocity_std_m_s), self.P.diagonal()[model.VELOCITY]
        )
        P[states, :] = P[:, states] = 0.0
        P[states, states] = np.diag(np.concatenate((np.square(fix.position_std_m), speed_variance)))
        self.x, self.P = x, P
        self.has_position, self.gps_time_s = True, self.time_s
        fresh = {
            kind: Gate(g.accepted, g.refused) for kind, g in self.gates.items() if kind.startswith("gps")
        }
        self.gates = {**self.gates, **fresh}
