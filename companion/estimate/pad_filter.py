"""The pad's motion relative to the vehicle: interacting multiple models in NED, and two states of heading.

State: relative position (pad - vehicle's reference point, m), relative velocity (m/s), and the pad's own
acceleration (m/s²). Two banks of models (`pad_models`), one for the plane and one for the vertical, which
hardly depend on one another. The vehicle's acceleration, measured by the IMU, is a known input; GPS never
enters the state, so that neither its noise nor its jumps reach the landing. The vehicle's velocity serves
for a first guess and for the rate at which the pad's course turns, and there an error does little.
Sightings are fused at their exposure, echoes at their time; `gating.Timeline` puts late ones in place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from companion.config import PadFilterConfig
from companion.estimate.gating import CHI_SQUARE_999, Gate, normalised_innovation_squared
from companion.estimate.model_bank import BankState, Blend, ModelBank, Step, advance, blend
from companion.estimate.motion import MotionHistory
from companion.estimate.pad_models import HORIZONTAL, HorizontalModels, VerticalModels, vertical_names
from companion.geometry import FloatArray, Vector3, wrap_angle

ACROSS: Final = slice(0, 2)
# below this speed the course says little about how it turns
MINIMUM_SPEED_M_S: Final = 0.3
# how far a pad's heading and its course may turn apart, and how fast courses turn at all
HEADING_IS_COURSE_RAD_S: Final = 0.1
STRAIGHT_ON_RAD_S: Final = 0.5
_EYE3: Final = np.eye(3)
_SEE_HEADING: Final = np.array([[1.0, 0.0]])
# where the banks' states stand in (position, velocity, acceleration) of all three axes
_HORIZONTAL_ROWS: Final = np.array([0, 1, 3, 4, 6, 7])
_VERTICAL_ROWS: Final = np.array([2, 5, 8])


@dataclass(frozen=True, slots=True)
class PadFix:
    """A sighting turned into NED at its exposure; covariance (3, 3) in m², the attitude's fast share included.

    `slow_variance_m2` (each axis) is what all sightings of a while have in common, the calibration's error
    say: it is no noise to be averaged, and is not part of the covariance.
    """

    position_ned_m: Vector3
    covariance_ned_m2: FloatArray
    heading_rad: float
    heading_std_rad: float
    vehicle_velocity_ned_m_s: Vector3 = (0.0, 0.0, 0.0)
    slow_variance_m2: float = 0.0


@dataclass(frozen=True, slots=True)
class HeightFix:
    """Height (m) of the range sensor over what lies under it, and the sensor's offset in NED axes (m)."""

    height_m: float
    sensor_offset_ned_m: Vector3
    noise_m: float


PadInput = PadFix | HeightFix


class Turn(NamedTuple):
    """The rate (rad/s, clockwise) at which the pad's course turns, its variance, and the acceleration (m/s²)."""

    rate_rad_s: float = 0.0
    variance: float = 0.0
    acceleration_m_s2: float = 0.0


class PadSnapshot(NamedTuple):
    """All of the filter; the arrays are never written to again."""

    time_s: float
    horizontal: BankState | None
    vertical: BankState | None
    turn: Turn
    heading: FloatArray
    heading_covariance: FloatArray
    gates: dict[str, Gate]
    seen_time_s: float
    slow_share: float


@dataclass(frozen=True, slots=True)
class PadEstimate:
    """The filter's state at a time: x (9,) and P (9, 9), heading (rad), its rate (rad/s), both's P (2, 2).

    P is the filter's own; `covariance` adds what all of its measurements have in common. `slow_share` is the
    calibration's error as a share of the distance, `models` the probability of each model of motion by name.
    """

    x: FloatArray
    P: FloatArray
    heading_rad: float
    heading_rate_rad_s: float
    heading_covariance: FloatArray
    seen_time_s: float = field(default=-math.inf)
    turn_rate_rad_s: float = 0.0
    slow_share: float = 0.0
    models: dict[str, float] = field(default_factory=dict)

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the relative position, all axes together."""
        return math.sqrt(self.P[0, 0] + self.P[1, 1] + self.P[2, 2])

    def covariance(self, rotation_covariance: FloatArray, wander_rad_s: float) -> FloatArray:
        """Of relative position and velocity (6, 6), with the errors that no averaging takes away.

        A horizon that is off (rotation_covariance (3, 3), about NED axes, rad²) turns position and velocity
        alike. One that wanders, and a calibration that is off, lend a standing vehicle a velocity.
        """
        position, velocity = self.x[0:3], self.x[3:6]
        swings = np.vstack((_lever(position), _lever(velocity)))
        total = self.P[:6, :6] + swings @ rotation_covariance @ swings.T
        total[3:, 3:] += wander_rad_s**2 * (swings[:3] @ rotation_covariance @ swings[:3].T)
        share = self.slow_share**2
        total[:3, :3] += share * float(position @ position) * _EYE3
        total[3:, 3:] += share * float(velocity @ velocity) * _EYE3
        return total

    @property
    def velocity_std_m_s(self) -> float:
        """Standard deviation of the relative velocity, all axes together."""
        return math.sqrt(self.P[3, 3] + self.P[4, 4] + self.P[5, 5])


class PadFilter:
    """Two banks of linear Kalman filters and one of heading; see the module's text."""

    def __init__(self, config: PadFilterConfig, motion: MotionHistory, board_half_width_m: float) -> None:
        self._config = config
        self._motion = motion
        self._half_width_m = board_half_width_m
        self._plane, self._climb = HorizontalModels(config), VerticalModels(config)
        self._names = (*HORIZONTAL, *vertical_names(config))
        m, n = len(HORIZONTAL), self._climb.count
        self._horizontal = ModelBank(np.full(m, 1.0 / m), config.model_dwell_s, 6, seen=2)
        self._vertical = ModelBank(np.full(n, 1.0 / n), config.model_dwell_s, 4, seen=1)
        self._turn = Turn()
        self._heading = KalmanFilter(dim_x=2, dim_z=1)
        self.time_s = -math.inf
        self.seen_time_s = -math.inf
        self.started = False
        self._slow_share = 0.0
        self.gates: dict[str, Gate] = {}

    # ------------------------------------------------------------ replayable

    def snapshot(self) -> PadSnapshot:
        """The whole state; cheap, since every step makes new arrays."""
        return PadSnapshot(
            self.time_s,
            self._horizontal.state if self.started else None,
            self._vertical.state if self.started else None,
            self._turn,
            self._heading.x,
            self._heading.P,
            self.gates,
            self.seen_time_s,
            self._slow_share,
        )

    def restore(self, snapshot: PadSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.seen_time_s = snapshot.time_s, snapshot.seen_time_s
        self._turn, self.gates, self._slow_share = snapshot.turn, snapshot.gates, snapshot.slow_share
        self._heading.x, self._heading.P = snapshot.heading, snapshot.heading_covariance
        self.started = snapshot.horizontal is not None
        if snapshot.horizontal is not None and snapshot.vertical is not None:
            self._horizontal.restore(snapshot.horizontal)
            self._vertical.restore(snapshot.vertical)

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
        """The state at a time not before the snapshot's; None when there is no pad in the snapshot.

        Unseen, models go their own ways and are blended at the end: how they differ is part of the doubt.
        """
        if snapshot.horizontal is None or snapshot.vertical is None:
            return None
        plane, climb = self._steps(snapshot.time_s, time_s, snapshot.turn)
        horizontal = blend(advance(snapshot.horizontal, plane))
        vertical = blend(advance(snapshot.vertical, climb))
        G, W = self._heading_step(time_s - snapshot.time_s)
        heading = G @ snapshot.heading
        x, P = _joined(horizontal, vertical)
        probabilities = (*snapshot.horizontal.probabilities, *snapshot.vertical.probabilities)
        return PadEstimate(
            x=x,
            P=P,
            heading_rad=wrap_angle(float(heading[0, 0])),
            heading_rate_rad_s=float(heading[1, 0]),
            heading_covariance=G @ snapshot.heading_covariance @ G.T + W,
            seen_time_s=snapshot.seen_time_s,
            turn_rate_rad_s=snapshot.turn.rate_rad_s,
            slow_share=snapshot.slow_share,
            models=dict(zip(self._names, map(float, probabilities), strict=True)),
        )

    def _predict(self, time_s: float) -> None:
        if time_s <= self.time_s:
            return
        dt_s = time_s - self.time_s
        plane, climb = self._steps(self.time_s, time_s, self._turn)
        self._horizontal.predict(dt_s, plane)
        self._vertical.predict(dt_s, climb)
        G, W = self._heading_step(dt_s)
        self._heading.predict(F=G, Q=W)
        self.time_s = time_s

    def _steps(self, start_s: float, end_s: float, turn: Turn) -> tuple[Step, Step]:
        """How the models move from one time to another; the vehicle's own motion is taken off."""
        (x, y, z), (vx, vy, vz) = self._motion.moved(start_s, end_s)
        dt_s = end_s - start_s
        plane = self._plane.step(dt_s, turn.rate_rad_s, turn.variance, turn.acceleration_m_s2)
        moved = np.array([-x, -y, -vx, -vy, 0.0, 0.0])
        return plane._replace(moved=moved), self._climb.step(dt_s)._replace(moved=np.array([-z, -vz, 0.0, 0.0]))

    def _heading_step(self, dt_s: float) -> tuple[FloatArray, FloatArray]:
        s = self._config.heading_acceleration_rad_s2_rthz**2
        square, cube = 0.5 * s * dt_s**2, s * dt_s**3 / 3.0
        return np.array([[1.0, dt_s], [0.0, 1.0]]), np.array([[cube, square], [square, s * dt_s]])

    # ------------------------------------------------------------ measurements

    def _take_sighting(self, time_s: float, fix: PadFix) -> None:
        R = self._config.sighting_noise_scale**2 * fix.covariance_ned_m2
        R = R + self._config.sighting_noise_floor_m**2 * _EYE3
        if not self.started:
            self._start(time_s, fix, R)
        elif self._passes_sighting(fix, R):
            z = np.array(fix.position_ned_m)
            self._horizontal.update(z[:2], R[:2, :2])
            self._vertical.update(z[2:], R[2:, 2:])
            self._take_heading(fix)
            self._turn = self._turned(fix)
            self._slow_share = _slow_share(fix)
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
        z = fix.height_m + fix.sensor_offset_ned_m[2]
        mean, covariance = self._vertical.expected()
        variance = float(covariance[0, 0]) + fix.noise_m**2
        passed = (z - float(mean[0])) ** 2 / variance <= CHI_SQUARE_999[1]
        self._record("range", passed)
        if passed:
            self._vertical.update(np.array([z]), np.array([[fix.noise_m**2]]))

    def _over_the_board(self, fix: HeightFix) -> bool:
        across, vertical = self._horizontal.expected(), self._vertical.expected()
        north, east = (float(value) for value in across.mean)
        offset = math.hypot(north - fix.sensor_offset_ned_m[0], east - fix.sensor_offset_ned_m[1])
        spread = math.sqrt(float(np.trace(across.covariance)))
        low = float(vertical.mean[0]) < self._config.range_maximum_height_m
        return low and offset + spread < self._half_width_m

    def _passes_sighting(self, fix: PadFix, R: FloatArray) -> bool:
        across, vertical = self._horizontal.expected(), self._vertical.expected()
        S = R.copy()
        S[ACROSS, ACROSS] += across.covariance
        S[2, 2] += vertical.covariance[0, 0]
        expected = np.array([across.mean[0], across.mean[1], vertical.mean[0]])
        distance = normalised_innovation_squared(np.array(fix.position_ned_m) - expected, S)
        passed = distance <= CHI_SQUARE_999[3]
        self._record("sighting", passed)
        return passed

    def _record(self, kind: str, passed: bool) -> None:
        self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}

    def _turned(self, fix: PadFix) -> Turn:
        """The course's turn rate: from velocity and acceleration, from the heading's rate, weighed."""
        across = blend(self._horizontal.state)
        vn, ve, an, ae = (float(value) for value in across.mean[2:6])
        vn, ve = vn + fix.vehicle_velocity_ned_m_s[0], ve + fix.vehicle_velocity_ned_m_s[1]
        speed_squared = vn * vn + ve * ve + MINIMUM_SPEED_M_S**2
        course_rate = (vn * ae - ve * an) / speed_squared
        course_variance = 0.5 * float(across.covariance[4, 4] + across.covariance[5, 5]) / speed_squared
        heading_variance = float(self._heading.P[1, 1]) + HEADING_IS_COURSE_RAD_S**2
        weights = (1.0 / max(course_variance, 1e-4), 1.0 / heading_variance, 1.0 / STRAIGHT_ON_RAD_S**2)
        total = sum(weights)
        rate = (weights[0] * course_rate + weights[1] * float(self._heading.x[1, 0])) / total
        return Turn(rate, 1.0 / total, math.hypot(an, ae))

    # ------------------------------------------------------------ starting

    def _start(self, time_s: float, fix: PadFix, R: FloatArray) -> None:
        """From one sighting: the pad may stand still or drive at a few m/s, the vehicle's speed is known."""
        vn, ve, vd = fix.vehicle_velocity_ned_m_s
        north, east, down = fix.position_ned_m
        across = np.zeros((len(HORIZONTAL), 6, 6))
        across[:, :2, :2] = R[:2, :2]
        across[:, [2, 3], [2, 3]] = self._config.first_speed_std_m_s**2
        across[:, [4, 5], [4, 5]] = self._plane.acceleration_variance[:, None]
        self._horizontal.start(np.array([north, east, -vn, -ve, 0.0, 0.0]), across)
        up = np.zeros((self._climb.count, 4, 4))
        up[:, 0, 0] = R[2, 2]
        up[:, 1, 1] = self._config.first_climb_std_m_s**2
        up[:, 2, 2], up[:, 3, 3] = self._climb.acceleration_variance, self._climb.jerk_variance
        self._vertical.start(np.array([down, -vd, 0.0, 0.0]), up)
        self._turn, self._slow_share = Turn(), _slow_share(fix)
        self.time_s = self.seen_time_s = time_s
        self.started = True
        self._start_heading(fix)
        self._record("sighting", True)

    def _start_heading(self, fix: PadFix) -> None:
        self._heading.x = np.array([[fix.heading_rad], [0.0]])
        self._heading.P = np.diag([fix.heading_std_rad**2 + math.radians(1.0) ** 2, 0.5**2])
        self._record("heading", True)


def _slow_share(fix: PadFix) -> float:
    x, y, z = fix.position_ned_m
    return math.sqrt(fix.slow_variance_m2 / max(x * x + y * y + z * z, 1e-6))


def _lever(place: FloatArray) -> FloatArray:
    """The matrix (3, 3) that makes of a small rotation what it moves a place by: rotation x place."""
    x, y, z = place.tolist()
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def _joined(horizontal: Blend, vertical: Blend) -> tuple[FloatArray, FloatArray]:
    """The two banks' moments as those of one state: x (9,), P (9, 9)."""
    x, P = np.zeros(9), np.zeros((9, 9))
    x[_HORIZONTAL_ROWS], x[_VERTICAL_ROWS] = horizontal.mean, vertical.mean[:3]
    P[np.ix_(_HORIZONTAL_ROWS, _HORIZONTAL_ROWS)] = horizontal.covariance
    P[np.ix_(_VERTICAL_ROWS, _VERTICAL_ROWS)] = vertical.covariance[:3, :3]
    return x, P
