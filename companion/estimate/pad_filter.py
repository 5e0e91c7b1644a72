"""The pad's motion relative to the vehicle: a nine-state Kalman filter in NED, and two states of heading.

State: relative position (pad - vehicle's reference point, m), relative velocity (m/s), and the pad's own
acceleration (m/s²), a first-order Markov (Singer) process. The vehicle's acceleration, measured by the IMU,
is a known input; GPS never enters, so that neither its noise nor its jumps reach the landing.
Sightings are fused at their exposure, echoes at their time; `gating.Timeline` puts late ones in place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.config import PadFilterConfig
from companion.estimate.gating import CHI_SQUARE_999, Gate, normalised_innovation_squared
from companion.estimate.motion import MotionHistory
from companion.geometry import FloatArray, Vector3, wrap_angle

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ACCELERATION = slice(6, 9)

_EYE3 = np.eye(3)
_SEE_POSITION = np.hstack([_EYE3, np.zeros((3, 6))])
_SEE_HEIGHT = _SEE_POSITION[2:3]
_SEE_HEADING = np.array([[1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class PadFix:
    """A sighting turned into NED at its exposure; covariance (3, 3) in m², attitude's share included."""

    position_ned_m: Vector3
    covariance_ned_m2: FloatArray
    heading_rad: float
    heading_std_rad: float
    vehicle_velocity_ned_m_s: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class HeightFix:
    """Height (m) of the range sensor over what lies under it, and the sensor's offset in NED axes (m)."""

    height_m: float
    sensor_offset_ned_m: Vector3
    noise_m: float


PadInput = PadFix | HeightFix


class PadSnapshot(NamedTuple):
    """All of the filter; the arrays are never written to again."""

    time_s: float
    x: FloatArray | None
    P: FloatArray
    heading: FloatArray
    heading_covariance: FloatArray
    gates: dict[str, Gate]
    seen_time_s: float


@dataclass(frozen=True, slots=True)
class PadEstimate:
    """The filter's state at a time: x (9,) and P (9, 9), heading (rad), its rate (rad/s), both's P (2, 2)."""

    x: FloatArray
    P: FloatArray
    heading_rad: float
    heading_rate_rad_s: float
    heading_covariance: FloatArray
    seen_time_s: float = field(default=-math.inf)

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the relative position, all axes together."""
        return math.sqrt(self.P[0, 0] + self.P[1, 1] + self.P[2, 2])

    @property
    def velocity_std_m_s(self) -> float:
        """Standard deviation of the relative velocity, all axes together."""
        return math.sqrt(self.P[3, 3] + self.P[4, 4] + self.P[5, 5])


class PadFilter:
    """Two linear Kalman filters side by side; see the module's text."""

    def __init__(self, config: PadFilterConfig, motion: MotionHistory, board_half_width_m: float) -> None:
        self._config = config
        self._motion = motion
        self._half_width_m = board_half_width_m
        self._filter = KalmanFilter(dim_x=9, dim_z=3)
        self._heading = KalmanFilter(dim_x=2, dim_z=1)
        self.time_s = -math.inf
        self.seen_time_s = -math.inf
        self.started = False
        self.gates: dict[str, Gate] = {}

    # ------------------------------------------------------------ replayable

    def snapshot(self) -> PadSnapshot:
        """The whole state; cheap, since filterpy makes new arrays at every step."""
        x = self._filter.x if self.started else None
        heading = self._heading
        return PadSnapshot(self.time_s, x, self._filter.P, heading.x, heading.P, self.gates, self.seen_time_s)

    def restore(self, snapshot: PadSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, x, self._filter.P, self._heading.x, self._heading.P, self.gates, self.seen_time_s = (
            snapshot
        )
        self.started = x is not None
        if x is not None:
            self._filter.x = x

    def apply(self, time_s: float, item: PadInput) -> None:
        """Predict to time_s and take the input in."""
        if self.started:
            self._predict(time_s)
        if isinstance(item, HeightFix):
            self._take_height(item)
        else:
            self._take_sighting(time_s, item)

    # ------------------------------------------------------------ prediction

    def predicted(self, snapshot: PadSnapshot, time_s: float) -> PadEstimate | None:
        """The state at a time not before the snapshot's; None when there is no pad in the snapshot."""
        if snapshot.x is None:
            return None
        F, Q, u = self._step(snapshot.time_s, time_s)
        G, W = self._heading_step(time_s - snapshot.time_s)
        heading = G @ snapshot.heading
        return PadEstimate(
            x=(F @ snapshot.x + u)[:, 0],
            P=F @ snapshot.P @ F.T + Q,
            heading_rad=wrap_angle(float(heading[0, 0])),
            heading_rate_rad_s=float(heading[1, 0]),
            heading_covariance=G @ snapshot.heading_covariance @ G.T + W,
            seen_time_s=snapshot.seen_time_s,
        )

    def _predict(self, time_s: float) -> None:
        if time_s <= self.time_s:
            return
        F, Q, u = self._step(self.time_s, time_s)
        self._filter.predict(u=u, B=np.eye(9), F=F, Q=Q)
        G, W = self._heading_step(time_s - self.time_s)
        self._heading.predict(F=G, Q=W)
        self.time_s = time_s

    def _step(self, start_s: float, end_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """F (9, 9), Q (9, 9) and input (9, 1) from one time to another."""
        config, dt = self._config, end_s - start_s
        F = np.eye(9)
        for axis, tau in enumerate(_time_constants_s(config)):
            fade = math.exp(-dt / tau)
            gain = tau * (1.0 - fade)
            F[axis, 3 + axis] = dt
            F[axis, 6 + axis] = tau * (dt - gain)
            F[3 + axis, 6 + axis] = gain
            F[6 + axis, 6 + axis] = fade
        place, speed = self._motion.moved(start_s, end_s)
        u = np.zeros((9, 1))
        u[POSITION, 0], u[VELOCITY, 0] = place, speed
        return F, _process_noise(config, dt), -u

    def _heading_step(self, dt_s: float) -> tuple[FloatArray, FloatArray]:
        s = self._config.heading_acceleration_rad_s2_rthz**2
        square, cube = 0.5 * s * dt_s**2, s * dt_s**3 / 3.0
        return np.array([[1.0, dt_s], [0.0, 1.0]]), np.array([[cube, square], [square, s * dt_s]])

    # ------------------------------------------------------------ measurements

    def _take_sighting(self, time_s: float, fix: PadFix) -> None:
        R = self._config.sighting_noise_scale**2 * fix.covariance_ned_m2
        R = R + self._config.sighting_noise_floor_m**2 * _EYE3
        z = np.array(fix.position_ned_m).reshape(3, 1)
        if not self.started:
            self._start(time_s, fix, R)
        elif self._passes("sighting", z, _SEE_POSITION, R):
            self._filter.update(z, R=R, H=_SEE_POSITION)
            self._take_heading(fix)
            self.seen_time_s = time_s
        elif self.gates["sighting"].shut_out(time_s, self._config.patience_s):
            self._start(time_s, fix, R)

    def _take_heading(self, fix: PadFix) -> None:
        expected = float(self._heading.x[0, 0])
        innovation = wrap_angle(fix.heading_rad - expected)
        noise = fix.heading_std_rad**2 + math.radians(self._config.heading_noise_deg) ** 2
        variance = float(self._heading.P[0, 0]) + noise
        passed = innovation * innovation / variance <= CHI_SQUARE_999[1]
        self._record("heading", passed)
        if passed:
            self._heading.update(np.array([[expected + innovation]]), R=np.array([[noise]]), H=_SEE_HEADING)
        elif self.gates["heading"].shut_out(self.time_s, self._config.patience_s):
            self._start_heading(fix)

    def _take_height(self, fix: HeightFix) -> None:
        """Height of the sensor over the board = relative position's z - the sensor's own offset."""
        if not self.started or not self._over_the_board(fix):
            return
        z = np.array([[fix.height_m + fix.sensor_offset_ned_m[2]]])
        R = np.array([[fix.noise_m**2]])
        if self._passes("range", z, _SEE_HEIGHT, R):
            self._filter.update(z, R=R, H=_SEE_HEIGHT)

    def _over_the_board(self, fix: HeightFix) -> bool:
        north, east, down = (float(value) for value in self._filter.x[POSITION, 0])
        offset = math.hypot(north - fix.sensor_offset_ned_m[0], east - fix.sensor_offset_ned_m[1])
        spread = math.sqrt(float(self._filter.P[0, 0] + self._filter.P[1, 1]))
        return down < self._config.range_maximum_height_m and offset + spread < self._half_width_m

    def _passes(self, kind: str, z: FloatArray, H: FloatArray, R: FloatArray) -> bool:
        innovation = (z - H @ self._filter.x)[:, 0]
        S = H @ self._filter.P @ H.T + R
        passed = normalised_innovation_squared(innovation, S) <= CHI_SQUARE_999[len(innovation)]
        self._record(kind, passed)
        return passed

    def _record(self, kind: str, passed: bool) -> None:
        self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}

    # ------------------------------------------------------------ starting

    def _start(self, time_s: float, fix: PadFix, R: FloatArray) -> None:
        """From one sighting: the pad may stand still or drive at a few m/s, the vehicle's speed is known."""
        across, up = self._config.first_speed_std_m_s, self._config.first_climb_std_m_s
        x = np.zeros((9, 1))
        x[POSITION, 0] = fix.position_ned_m
        x[VELOCITY, 0] = np.negative(fix.vehicle_velocity_ned_m_s)
        P = np.zeros((9, 9))
        P[POSITION, POSITION] = R
        P[VELOCITY, VELOCITY] = np.diag((across**2, across**2, up**2))
        P[ACCELERATION, ACCELERATION] = np.diag(_acceleration_variance(self._config))
        self._filter.x, self._filter.P = x, P
        self.time_s = self.seen_time_s = time_s
        self.started = True
        self._start_heading(fix)
        self._record("sighting", True)

    def _start_heading(self, fix: PadFix) -> None:
        self._heading.x = np.array([[fix.heading_rad], [0.0]])
        self._heading.P = np.diag([fix.heading_std_rad**2 + math.radians(1.0) ** 2, 0.5**2])
        self._record("heading", True)


def _jerk_density(config: PadFilterConfig) -> Vector3:
    horizontal, vertical = config.horizontal_jerk_m_s3_rthz**2, config.vertical_jerk_m_s3_rthz**2
    return (horizontal, horizontal, vertical)


def _acceleration_variance(config: PadFilterConfig) -> Vector3:
    """Of a Markov process driven by white jerk: density * time constant / 2."""
    (x, y, z), (tx, ty, tz) = _jerk_density(config), _time_constants_s(config)
    return (0.5 * x * tx, 0.5 * y * ty, 0.5 * z * tz)


def _time_constants_s(config: PadFilterConfig) -> Vector3:
    across, up = config.horizontal_time_constant_s, config.vertical_time_constant_s
    return (across, across, up)


def _process_noise(config: PadFilterConfig, dt: float) -> FloatArray:
    """Q (9, 9): white jerk of the pad, and white noise of the measured vehicle acceleration.

    The jerk's share is that of an unfading acceleration; over seconds it errs on the large side.
    """
    w = config.vehicle_acceleration_noise_m_s2_rthz**2
    jerk = (
        (dt**5 / 20, dt**4 / 8, dt**3 / 6),
        (dt**4 / 8, dt**3 / 3, dt**2 / 2),
        (dt**3 / 6, dt**2 / 2, dt),
    )
    Q = np.zeros((9, 9))
    for axis, density in enumerate(_jerk_density(config)):
        Q[axis::3, axis::3] = [[density * value for value in row] for row in jerk]
        Q[axis, axis] += w * dt**3 / 3
        Q[3 + axis, 3 + axis] += w * dt
        Q[axis, 3 + axis] += w * dt**2 / 2
        Q[3 + axis, axis] += w * dt**2 / 2
    return Q
