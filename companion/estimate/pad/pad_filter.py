"""The pad's motion relative to the vehicle: interacting multiple models in NED, and two states of heading.

State: relative position (pad - vehicle's reference point, m), relative velocity (m/s), and the pad's own
acceleration (m/s²). Two banks of models (`pad_models`), one for the plane and one for the vertical, which
hardly depend on one another. The vehicle's acceleration, measured by the IMU, is a known input; GPS never
enters the state, so that neither its noise nor its jumps reach the landing. The vehicle's velocity serves
for a start and for the rate at which the pad's course turns, and there an error does little.
Sightings are fused at their exposure, echoes at their time; `gating.Timeline` puts late ones in place.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, Vector3, wrap_angle
from companion.config import PadFilterConfig
from companion.estimate.gating import CHI_SQUARE_999, Gate
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.heading_filter import HeadingState
from companion.estimate.pad.lean_filter import LEVEL, LeanState
from companion.estimate.pad.model_bank import BankState, Blend, ModelBank, ModelTransition, advance, blend
from companion.estimate.pad.pad_models import (
    HORIZONTAL,
    TURN,
    HorizontalModels,
    Turn,
    VerticalModels,
    course_turn,
    vertical_names,
)
from companion.estimate.pad.pad_types import (
    CombinedEstimate,
    HeightMeasurement,
    PadInput,
    PadMeasurement,
    PadSnapshot,
)

MODEL_DWELL_S: Final = 5.0  # a motion keeps its model so long on average
HEADING_ACCELERATION_RAD_S2_RTHZ: Final = 0.3  # process noise of the pad's turn rate
HEADING_NOISE_DEG: Final = 0.5  # added to what a sighting says
SIGHTING_NOISE_FLOOR_M: Final = 0.0002
FIRST_CLIMB_STD_M_S: Final = 0.4  # at the first sighting: pads drive, but hardly rise
RANGE_MAXIMUM_HEIGHT_M: Final = 2.5  # an ultrasonic's cone of 30° is then 1.3 m wide, as a pad is

__all__ = ["CombinedEstimate", "HeightMeasurement", "PadFilter", "PadInput", "PadMeasurement", "PadSnapshot"]

_EYE3: Final = np.eye(3)
# where the banks' states are in (position, velocity, acceleration) of all three axes
_HORIZONTAL_ROWS: Final = np.array([0, 1, 3, 4, 6, 7])
_VERTICAL_ROWS: Final = np.array([2, 5, 8])


class PadFilter:
    """Two banks of linear Kalman filters and one of heading; see the module's text."""

    def __init__(self, config: PadFilterConfig, motion: MotionHistory, board_half_width_m: float) -> None:
        self._config = config
        self._motion = motion
        self._half_width_m = board_half_width_m
        self._plane, self._climb = HorizontalModels(config), VerticalModels(config)
        self._names = (*HORIZONTAL, *vertical_names(config))
        m, n = len(HORIZONTAL), self._climb.count
        self._horizontal = ModelBank(np.full(m, 1.0 / m), MODEL_DWELL_S, 8, seen=2)
        self._vertical = ModelBank(np.full(n, 1.0 / n), MODEL_DWELL_S, 4, seen=1)
        self._turn = Turn()
        self._heading, self._lean = HeadingState(), LEVEL
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
            self._heading,
            self.gates,
            self.seen_time_s,
            self._slow_share,
            self._lean,
        )

    def restore(self, snapshot: PadSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.seen_time_s = snapshot.time_s, snapshot.seen_time_s
        self._turn, self.gates, self._slow_share = snapshot.turn, snapshot.gates, snapshot.slow_share
        self._heading, self._lean = snapshot.heading, snapshot.lean
        self.started = snapshot.horizontal is not None
        if snapshot.horizontal is not None and snapshot.vertical is not None:
            self._horizontal.restore(snapshot.horizontal)
            self._vertical.restore(snapshot.vertical)

    def apply(self, time_s: float, item: PadInput) -> None:
        """Predict to time_s and take the input in."""
        if self.started:
            self._predict(time_s)
        if isinstance(item, HeightMeasurement):
            self._take_height(item)
        else:
            self._take_sighting(time_s, item)

    # ------------------------------------------------------------ prediction

    def predicted(self, snapshot: PadSnapshot, time_s: float) -> CombinedEstimate | None:
        """The state at a time not before the snapshot's; None when there is no pad in the snapshot.

        Unseen, models go their own ways and are blended at the end: how they differ is part of the
        uncertainty.
        """
        if snapshot.horizontal is None or snapshot.vertical is None:
            return None
        plane, climb = self._steps(snapshot.time_s, time_s, snapshot.turn)
        moved = advance(snapshot.horizontal, plane)
        horizontal = blend(moved)
        vertical = blend(advance(snapshot.vertical, climb))
        density = HEADING_ACCELERATION_RAD_S2_RTHZ
        heading = snapshot.heading.after(time_s - snapshot.time_s, density)
        x, P = _joined(horizontal, vertical)
        probabilities = (*snapshot.horizontal.probabilities, *snapshot.vertical.probabilities)
        return CombinedEstimate(
            x=x,
            P=P,
            heading_rad=wrap_angle(heading.heading_rad),
            heading_rate_rad_s=heading.rate_rad_s,
            heading_std_rad=math.sqrt(heading.heading_variance),
            seen_time_s=snapshot.seen_time_s,
            turn_rate_rad_s=snapshot.turn.rate_rad_s,
            slow_share=snapshot.slow_share,
            jerk_m_s3=tuple((moved.probabilities[TURN] * moved.means[TURN, 6:8]).tolist()),
            models=dict(zip(self._names, map(float, probabilities), strict=True)),
            lean=snapshot.lean.after(
                time_s - snapshot.time_s, self._config.lean_acceleration_rad_s2_rthz
            ).lean,
        )

    def _predict(self, time_s: float) -> None:
        if time_s <= self.time_s:
            return
        dt_s = time_s - self.time_s
        plane, climb = self._steps(self.time_s, time_s, self._turn)
        self._horizontal.predict(dt_s, plane)
        self._vertical.predict(dt_s, climb)
        self._heading = self._heading.after(dt_s, HEADING_ACCELERATION_RAD_S2_RTHZ)
        self._lean = self._lean.after(dt_s, self._config.lean_acceleration_rad_s2_rthz)
        self.time_s = time_s

    def _steps(self, start_s: float, end_s: float, turn: Turn) -> tuple[ModelTransition, ModelTransition]:
        """How the models move from one time to another; the vehicle's own motion is taken off."""
        (x, y, z), (vx, vy, vz) = self._motion.moved(start_s, end_s)
        dt_s = end_s - start_s
        plane = self._plane.step(dt_s, turn)
        moved = np.array([-x, -y, -vx, -vy, 0.0, 0.0, 0.0, 0.0])
        return plane._replace(moved=moved), self._climb.step(dt_s)._replace(
            moved=np.array([-z, -vz, 0.0, 0.0])
        )

    # ------------------------------------------------------------ measurements

    def _take_sighting(self, time_s: float, sample: PadMeasurement) -> None:
        R = self._config.sighting_noise_scale**2 * sample.covariance_ned_m2
        R = R + SIGHTING_NOISE_FLOOR_M**2 * _EYE3
        if not self.started or time_s - self.seen_time_s > self._config.forget_s:
            # of a pad that is forgotten nothing is expected, and the vehicle's way since then is, too
            self._start(time_s, sample, R)
        elif self._passes_sighting(sample, R):
            z = np.array(sample.position_ned_m)
            self._horizontal.update(z[:2], R[:2, :2])
            self._vertical.update(z[2:], R[2:, 2:])
            self._take_heading(sample)
            if sample.lean_rad is not None:
                since_s = time_s - self.seen_time_s
                self._lean = self._lean.corrected(sample.lean_rad, sample.lean_std_rad, since_s)
            self._turn = self._turned(sample)
            self._slow_share = sample.slow_share
            self.seen_time_s = time_s
        elif self.gates["sighting"].shut_out(time_s, self._config.patience_s):
            self._start(time_s, sample, R)

    def _take_heading(self, sample: PadMeasurement) -> None:
        innovation = wrap_angle(sample.heading_rad - self._heading.heading_rad)
        noise = sample.heading_std_rad**2 + math.radians(HEADING_NOISE_DEG) ** 2
        passed = innovation * innovation <= CHI_SQUARE_999[1] * (self._heading.heading_variance + noise)
        self._record("heading", passed)
        if passed:
            self._heading = self._heading.corrected(innovation, noise)
        elif self.gates["heading"].shut_out(self.time_s, self._config.patience_s):
            self._start_heading(sample)

    def _take_height(self, sample: HeightMeasurement) -> None:
        """Height of the sensor over the board = relative position's z - the sensor's own offset."""
        if not self.started or not self._over_the_board(sample):
            return
        z = sample.height_m + sample.sensor_offset_ned_m[2]
        expected, variance = _expected_height(self._vertical.state)
        passed = (z - expected) ** 2 <= CHI_SQUARE_999[1] * (variance + sample.noise_m**2)
        self._record("range", passed)
        if passed:
            self._vertical.update(np.array([z]), np.array([[sample.noise_m**2]]))

    def _over_the_board(self, sample: HeightMeasurement) -> bool:
        north, east, north_variance, _, east_variance = _expected_place(self._horizontal.state)
        offset = math.hypot(north - sample.sensor_offset_ned_m[0], east - sample.sensor_offset_ned_m[1])
        spread = math.sqrt(north_variance + east_variance)
        low = _expected_height(self._vertical.state)[0] < RANGE_MAXIMUM_HEIGHT_M
        return low and offset + spread < self._half_width_m

    def _passes_sighting(self, sample: PadMeasurement, R: FloatArray) -> bool:
        north, east, a, b, d = _expected_place(self._horizontal.state)
        down, f = _expected_height(self._vertical.state)
        (ra, rb, rc), (_, rd, re), (_, _, rf) = R.tolist()
        x, y, z = sample.position_ned_m
        S = (a + ra, b + rb, rc, d + rd, re, f + rf)
        distance = _normalised_squared((x - north, y - east, z - down), S)
        passed = distance <= CHI_SQUARE_999[3]
        self._record("sighting", passed)
        return passed

    def _record(self, kind: str, passed: bool) -> None:
        self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}

    def _turned(self, sample: PadMeasurement) -> Turn:
        means, covariances, probabilities = self._horizontal.state
        vn, ve, an, ae = (probabilities @ means[:, 2:6]).tolist()
        spreads = covariances[:, 4, 4] + covariances[:, 5, 5] + (means[:, 4:6] ** 2).sum(axis=1)
        variance = 0.5 * (float(probabilities @ spreads) - an * an - ae * ae)
        north, east, _ = sample.vehicle_velocity_ned_m_s
        rate, rate_variance = self._heading.rate_rad_s, self._heading.rate_variance
        return course_turn((vn + north, ve + east), (an, ae), variance, rate, rate_variance)

    # ------------------------------------------------------------ starting

    def _start(self, time_s: float, sample: PadMeasurement, R: FloatArray) -> None:
        """From one sighting: the pad may stand still or drive at a few m/s, the vehicle's speed is known."""
        vn, ve, vd = sample.vehicle_velocity_ned_m_s
        north, east, down = sample.position_ned_m
        across = np.zeros((len(HORIZONTAL), 8, 8))
        across[:, :2, :2] = R[:2, :2]
        across[:, [2, 3], [2, 3]] = self._config.first_speed_std_m_s**2
        across[:, [4, 5], [4, 5]] = self._plane.acceleration_variance[:, None]
        across[:, [6, 7], [6, 7]] = self._plane.jerk_variance[:, None]
        self._horizontal.start(np.array([north, east, -vn, -ve, 0.0, 0.0, 0.0, 0.0]), across)
        up = np.zeros((self._climb.count, 4, 4))
        up[:, 0, 0] = R[2, 2]
        up[:, 1, 1] = FIRST_CLIMB_STD_M_S**2
        up[:, 2, 2], up[:, 3, 3] = self._climb.acceleration_variance, self._climb.jerk_variance
        self._vertical.start(np.array([down, -vd, 0.0, 0.0]), up)
        self._turn, self._slow_share = Turn(), sample.slow_share
        self.time_s = self.seen_time_s = time_s
        self.started = True
        self._start_heading(sample)
        self._lean = (
            LEVEL if sample.lean_rad is None else LeanState.first(sample.lean_rad, sample.lean_std_rad)
        )
        self._record("sighting", True)

    def _start_heading(self, sample: PadMeasurement) -> None:
        variance = sample.heading_std_rad**2 + math.radians(1.0) ** 2
        self._heading = HeadingState(sample.heading_rad, 0.0, variance, 0.0, 0.5**2)
        self._record("heading", True)


def _expected_place(state: BankState) -> tuple[float, float, float, float, float]:
    """Of the plane's mixture: mean north and east, their variances with the covariance between; in floats."""
    means, covariances = state.means[:, :2].tolist(), state.covariances[:, :2, :2].tolist()
    x = y = xx = xy = yy = 0.0
    for p, (mx, my), ((vxx, vxy), (_, vyy)) in zip(
        state.probabilities.tolist(), means, covariances, strict=True
    ):
        x, y = x + p * mx, y + p * my
        xx, xy, yy = xx + p * (vxx + mx * mx), xy + p * (vxy + mx * my), yy + p * (vyy + my * my)
    return x, y, xx - x * x, xy - x * y, yy - y * y


def _expected_height(state: BankState) -> tuple[float, float]:
    """Of the vertical's mixture: mean and variance of the relative position."""
    p, z = state.probabilities, state.means[:, 0]
    mean = float(p @ z)
    return mean, float(p @ (state.covariances[:, 0, 0] + z * z)) - mean * mean


def _normalised_squared(y: Vector3, S: tuple[float, ...]) -> float:
    """y' S^-1 y, S by its upper triangle; Cramer's rule, for a call of a solver costs more than that."""
    a, b, c, d, e, f = S
    u, v, w = y
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    squares = p * u * u + (a * f - c * c) * v * v + (a * d - b * b) * w * w
    products = q * u * v + r * u * w + (b * c - a * e) * v * w
    return (squares + 2.0 * products) / (a * p + b * q + c * r)


def _joined(horizontal: Blend, vertical: Blend) -> tuple[FloatArray, FloatArray]:
    """The two banks' moments as those of one state: x (9,), P (9, 9)."""
    x, P = np.zeros(9), np.zeros((9, 9))
    x[_HORIZONTAL_ROWS], x[_VERTICAL_ROWS] = horizontal.mean[:6], vertical.mean[:3]
    P[np.ix_(_HORIZONTAL_ROWS, _HORIZONTAL_ROWS)] = horizontal.covariance[:6, :6]
    P[np.ix_(_VERTICAL_ROWS, _VERTICAL_ROWS)] = vertical.covariance[:3, :3]
    return x, P
