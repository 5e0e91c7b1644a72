"""The pad's motion relative to the vehicle: interacting multiple models in NED, and two states of heading.

State: relative position (pad - vehicle's reference point, m), relative velocity (m/s), and the pad's own
acceleration (m/s²). Two groups of models (`pad_models`), one for the plane and one for the vertical, which
hardly depend on one another. The vehicle's acceleration, measured by the IMU, is a known input; GPS never
enters the state, so that neither its noise nor its jumps reach the landing. The vehicle's velocity serves
for a start and for the rate at which the pad's course turns, and there an error does little.
Sightings are fused at their exposure, echoes at their time; `gating.Timeline` puts late ones in place.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.base.geometry import FloatArray, Vector3, add, scale, wrap_angle
from companion.config import PadFilterConfig
from companion.estimate.gating import CHI_SQUARE_999, Gate, passes
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.frame_correction import frame_rotation_increment
from companion.estimate.pad.heading_filter import HeadingState
from companion.estimate.pad.model_bank import (
    BankState,
    Innovation,
    ModelBank,
    ModelTransition,
    advance,
    innovation,
)
from companion.estimate.pad.pad_models import (
    HORIZONTAL,
    TURN,
    PadModels,
    Turn,
    course_turn,
    vertical_names,
)
from companion.estimate.pad.pad_types import (
    PAIRS_AT,
    STATES_AT,
    CombinedEstimate,
    HeightMeasurement,
    PadInput,
    PadMeasurement,
    PadSnapshot,
)
from companion.estimate.pad.tilt_filter import LEVEL, TiltState
from companion.estimate.pad.velocity_step import (
    RefusedSighting,
    VelocityEstimate,
    believable,
    recent,
    velocity_step,
)

MODEL_DWELL_S: Final = 5.0  # a motion keeps its model so long on average
HEADING_ACCELERATION_RAD_S2_RTHZ: Final = 0.3  # process noise of the pad's turn rate
HEADING_NOISE_DEG: Final = 0.5  # added to what a sighting says
SIGHTING_NOISE_FLOOR_M: Final = 0.0002
FIRST_CLIMB_STD_M_S: Final = 0.4  # at the first sighting: pads drive, but hardly rise
RANGE_MAXIMUM_HEIGHT_M: Final = 2.5  # an ultrasonic's cone of 30° is then 1.3 m wide, as a pad is

__all__ = ["CombinedEstimate", "HeightMeasurement", "PadFilter", "PadInput", "PadMeasurement", "PadSnapshot"]

_NOISE_FLOOR_M2: Final = SIGHTING_NOISE_FLOOR_M**2 * np.eye(3)
_CLIMB: Final = 1  # the second of the bank's groups
_NO_AXIS_M2: Final = 1.0  # noise on the vertical models' second axis, where all expect the same

# the models' innovations, the mixture's, and its covariance by the upper triangle
_Compared = tuple[Innovation, Vector3, tuple[float, ...]]


class PadFilter:
    """A bank of linear Kalman filters, and filters of heading and tilt; see the module's text."""

    def __init__(self, config: PadFilterConfig, motion: MotionHistory, board_half_width_m: float) -> None:
        self._config = config
        self._motion = motion
        self._half_width_m = board_half_width_m
        self._models = PadModels(config)
        self._names = (*HORIZONTAL, *vertical_names(config))
        self._bank = ModelBank(self._models.groups, MODEL_DWELL_S)
        self._turn = Turn()
        self._heading, self._tilt = HeadingState(), LEVEL
        self.time_s = -math.inf
        self.seen_time_s = -math.inf
        self.started = False
        self._slow_share = 0.0
        self._refused: tuple[RefusedSighting, ...] = ()  # lately, since one was accepted
        self._before_step: PadSnapshot | None = None  # until a sighting confirms the step
        self.gates: dict[str, Gate] = {}

    # ------------------------------------------------------------ replayable

    def snapshot(self) -> PadSnapshot:
        """The whole state; cheap, since every step makes new arrays."""
        return PadSnapshot(
            self.time_s,
            self._bank.state if self.started else None,
            self._turn,
            self._heading,
            self.gates,
            self.seen_time_s,
            self._slow_share,
            self._tilt,
            self._refused,
            self._before_step,
        )

    def restore(self, snapshot: PadSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.seen_time_s = snapshot.time_s, snapshot.seen_time_s
        self._turn, self.gates, self._slow_share = snapshot.turn, snapshot.gates, snapshot.slow_share
        self._heading, self._tilt = snapshot.heading, snapshot.tilt
        self._refused, self._before_step = snapshot.refused, snapshot.before_step
        self.started = snapshot.models is not None
        if snapshot.models is not None:
            self._bank.restore(snapshot.models)

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
        if snapshot.models is None:
            return None
        dt_s = time_s - snapshot.time_s
        step, yaw = self._step(snapshot.time_s, time_s, snapshot.turn, snapshot.models, snapshot.seen_time_s)
        moved = advance(snapshot.models, step)
        heading = snapshot.heading.after(dt_s, HEADING_ACCELERATION_RAD_S2_RTHZ, yaw)
        blend = self._bank.blend(moved)
        return CombinedEstimate(
            x=blend.mean.take(STATES_AT),
            P=blend.covariance.take(PAIRS_AT),
            heading_rad=wrap_angle(heading.heading_rad),
            heading_rate_rad_s=heading.rate_rad_s,
            heading_std_rad=math.sqrt(heading.heading_variance),
            seen_time_s=snapshot.seen_time_s,
            turn_rate_rad_s=snapshot.turn.rate_rad_s,
            slow_share=snapshot.slow_share,
            jerk_m_s3=tuple((moved.probabilities[TURN] * moved.means[TURN, 6:8]).tolist()),
            models=dict(zip(self._names, moved.probabilities.tolist(), strict=True)),
            tilt=snapshot.tilt.after(dt_s, self._config.tilt_acceleration_rad_s2_rthz).tilt,
        )

    def _predict(self, time_s: float) -> None:
        if time_s <= self.time_s:
            return
        dt_s = time_s - self.time_s
        step, turned_rad = self._step(self.time_s, time_s, self._turn, self._bank.state, self.seen_time_s)
        self._bank.predict(dt_s, step)
        self._heading = self._heading.after(dt_s, HEADING_ACCELERATION_RAD_S2_RTHZ, turned_rad)
        self._tilt = self._tilt.after(dt_s, self._config.tilt_acceleration_rad_s2_rthz)
        self.time_s = time_s

    def _step(
        self, start_s: float, end_s: float, turn: Turn, models: BankState, seen_s: float
    ) -> tuple[ModelTransition, float]:
        """How the models move between two times, the vehicle's motion taken off; how north turns (rad)."""
        dt_s, correction = end_s - start_s, self._motion.corrected(start_s, end_s)
        added = frame_rotation_increment(
            self._motion.moved(start_s, end_s), correction, models.means, dt_s, end_s - seen_s
        )
        F, Q = self._models.step(dt_s, turn, self._motion.noise_density_m2_s3)
        return ModelTransition(F, Q, added.take(self._bank.group_of, axis=0)), correction[2]

    # ------------------------------------------------------------ measurements

    def _take_sighting(self, time_s: float, sample: PadMeasurement) -> None:
        R = self._config.sighting_noise_scale**2 * sample.covariance_ned_m2 + _NOISE_FLOOR_M2
        if not self.started or time_s - self.seen_time_s > self._config.forget_s:
            # of a pad that is forgotten nothing is expected, and the vehicle's way since then is, too
            self._start(time_s, sample, R)
            return
        seen, y, S = self._compared(sample, R)
        if not passes(y, S) and self._before_step is not None:
            seen, y, S = self._doubted(self._before_step, time_s, sample, R) or (seen, y, S)
        passed = passes(y, S)
        self._record("sighting", passed)
        if not passed:
            self._refuse(time_s, sample, RefusedSighting.of(time_s, y, S, R))
            return
        self._refused, self._before_step = (), None
        self._bank.update(seen)
        self._take_heading(sample)
        if sample.tilt_rad is not None:
            since_s = time_s - self.seen_time_s
            self._tilt = self._tilt.corrected(sample.tilt_rad, sample.tilt_std_rad, since_s)
        self._turn = self._turned(sample)
        self._slow_share = sample.slow_share
        self.seen_time_s = time_s

    def _refuse(self, time_s: float, sample: PadMeasurement, refused: RefusedSighting) -> None:
        """Start again where refused sightings show that the filter is wrong, or else remember this one."""
        step = velocity_step(self._refused, refused, self.seen_time_s)
        if step is not None:
            relative, vehicle = self._relative_velocity_ned_m_s, sample.vehicle_velocity_ned_m_s
            stepped = add(relative, step.velocity_m_s)
            if believable(add(relative, vehicle), add(stepped, vehicle)):
                before = self.snapshot()._replace(before_step=None)
                self._start(time_s, sample, refused.noise_m2, step._replace(velocity_m_s=stepped))
                self._before_step = before
                return
        if self.gates["sighting"].shut_out(time_s, self._config.sighting_timeout_s):
            self._start(time_s, sample, refused.noise_m2)
        else:
            self._refused = (*recent(self._refused, time_s), refused)

    def _doubted(
        self, before: PadSnapshot, time_s: float, sample: PadMeasurement, R: FloatArray
    ) -> _Compared | None:
        """Go back to the track before a step if that, unlike the step, expected this sighting; else None."""
        stepped = self.snapshot()
        self.restore(before)
        self._predict(time_s)
        compared = self._compared(sample, R)
        if passes(*compared[1:]):
            return compared
        self.restore(stepped)
        return None

    def _compared(self, sample: PadMeasurement, R: FloatArray) -> _Compared:
        """The innovations of the models; the mixture's with its covariance (upper triangle)."""
        (a, b, c), (_, d, e), (_, _, f) = R.tolist()
        seen = self._innovation(sample.position_ned_m, (a, b, d, f))
        y, (sa, sb, sd, sf) = self._mixture(seen)
        return seen, y, (sa, sb, c, sd, e, sf)

    @property
    def _relative_velocity_ned_m_s(self) -> Vector3:
        (north, east), (down, _) = self._bank.blend(self._bank.state).mean[:, 2:4].tolist()
        return (north, east, down)

    def _innovation(
        self, position_ned_m: Vector3, variances_m2: tuple[float, float, float, float]
    ) -> Innovation:
        """Of a relative position; variances: north, its covariance with east, east, down."""
        north, east, down = position_ned_m
        a, b, d, f = variances_m2
        groups = np.array([[north, east, a, b, b, d], [down, 0.0, f, 0.0, 0.0, _NO_AXIS_M2]])
        models = groups.take(self._bank.group_of, axis=0)
        return innovation(self._bank.state, models[:, :2], models[:, 2:].reshape(-1, 2, 2))

    def _mixture(self, seen: Innovation) -> tuple[Vector3, tuple[float, float, float, float]]:
        """The mixture's innovation, and its variances as above."""
        mean, covariance = self._bank.blend(BankState(seen.y, seen.S, self._bank.state.probabilities))
        (north, east), (down, _) = mean.tolist()
        ((a, b), (_, d)), ((f, _), _) = covariance.tolist()
        return (north, east, down), (a, b, d, f)

    def _take_heading(self, sample: PadMeasurement) -> None:
        innovation = wrap_angle(sample.heading_rad - self._heading.heading_rad)
        noise = sample.heading_std_rad**2 + math.radians(HEADING_NOISE_DEG) ** 2
        passed = innovation * innovation <= CHI_SQUARE_999[1] * (self._heading.heading_variance + noise)
        self._record("heading", passed)
        if passed:
            self._heading = self._heading.corrected(innovation, noise)
        elif self.gates["heading"].shut_out(self.time_s, self._config.sighting_timeout_s):
            self._start_heading(sample)

    def _take_height(self, sample: HeightMeasurement) -> None:
        """Height of the sensor over the board = relative position's z - the sensor's own offset."""
        if not self.started:
            return
        north, east, down = sample.sensor_offset_ned_m
        z = sample.height_m + down
        seen = self._innovation((north, east, z), (0.0, 0.0, 0.0, sample.noise_m**2))
        (away_n, away_e, higher), (a, _, d, f) = self._mixture(seen)
        low = z - higher < RANGE_MAXIMUM_HEIGHT_M
        if not low or math.hypot(away_n, away_e) + math.sqrt(a + d) >= self._half_width_m:
            return  # the pad's middle is too far from under the sensor
        passed = higher * higher <= CHI_SQUARE_999[1] * f
        self._record("range", passed)
        if passed:
            self._bank.update(seen, _CLIMB)

    def _record(self, kind: str, passed: bool) -> None:
        self.gates = {**self.gates, kind: self.gates.get(kind, Gate()).after(passed, self.time_s)}

    def _turned(self, sample: PadMeasurement) -> Turn:
        means, covariances, probabilities = self._bank.state
        plane, _ = self._models.groups
        spreads = covariances[plane, 4, 4] + covariances[plane, 5, 5]
        vn = ve = an = ae = square = 0.0
        for p, spread, (mvn, mve, man, mae) in zip(
            probabilities[plane].tolist(), spreads.tolist(), means[plane, 2:6].tolist(), strict=True
        ):
            vn, ve, an, ae = vn + p * mvn, ve + p * mve, an + p * man, ae + p * mae
            square += p * (spread + man * man + mae * mae)
        variance = 0.5 * (square - an * an - ae * ae)
        north, east, _ = sample.vehicle_velocity_ned_m_s
        rate, rate_variance = self._heading.rate_rad_s, self._heading.rate_variance
        return course_turn((vn + north, ve + east), (an, ae), variance, rate, rate_variance)

    # ------------------------------------------------------------ starting

    def _start(
        self, time_s: float, sample: PadMeasurement, R: FloatArray, velocity: VelocityEstimate | None = None
    ) -> None:
        """From one sighting: the pad may stand still or drive at a few m/s, the vehicle's speed is known.

        Or with the relative velocity of its own that is given.
        """
        P, plane, climb = np.zeros((self._models.count, 8, 8)), *self._models.groups
        P[plane, :2, :2], P[climb, 0, 0] = R[:2, :2], R[2, 2]
        if velocity is None:
            vn, ve, vd = scale(sample.vehicle_velocity_ned_m_s, -1.0)
            P[plane, 2, 2] = P[plane, 3, 3] = self._config.first_speed_std_m_s**2
            P[climb, 2, 2] = FIRST_CLIMB_STD_M_S**2
        else:
            (vn, ve, vd), covariance, shared = velocity
            P[plane, 2:4, 2:4], P[climb, 2, 2] = covariance[:2, :2], covariance[2, 2]
            P[plane, :2, 2:4], P[plane, 2:4, :2] = shared[:2, :2], shared[:2, :2].T
            P[climb, 0, 2] = P[climb, 2, 0] = shared[2, 2]
        for state, variance in ((4, self._models.acceleration_variance), (6, self._models.jerk_variance)):
            P[:, state, state] = variance
            P[plane, state + 1, state + 1] = variance[plane]
        north, east, down = sample.position_ned_m
        means = np.array([[north, east, vn, ve, 0.0, 0.0, 0.0, 0.0], [down, 0.0, vd, *[0.0] * 5]])
        self._bank.start(means, P)
        self._turn, self._slow_share = Turn(), sample.slow_share
        self._refused, self._before_step = (), None
        self.time_s = self.seen_time_s = time_s
        self.started = True
        self._record("sighting", True)
        if velocity is not None:
            self._take_heading(sample)  # a stop says nothing of how it turns or tilts
            return
        self._start_heading(sample)
        self._tilt = (
            LEVEL if sample.tilt_rad is None else TiltState.first(sample.tilt_rad, sample.tilt_std_rad)
        )

    def _start_heading(self, sample: PadMeasurement) -> None:
        variance = sample.heading_std_rad**2 + math.radians(1.0) ** 2
        self._heading = HeadingState(sample.heading_rad, 0.0, variance, 0.0, 0.5**2)
        self._record("heading", True)
