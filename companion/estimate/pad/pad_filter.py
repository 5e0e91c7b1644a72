"""The pad's motion relative to the vehicle: interacting multiple models in NED, and two states of heading.

State: relative position (pad - vehicle's reference point, m), relative velocity (m/s), and the pad's own
acceleration (m/s²). Two groups of models (`pad_models`), one for the plane and one for the vertical, which
hardly depend on one another. The vehicle's acceleration, measured by the IMU, is a known input. GPS enters
the state by a beacon alone, and what it is off by as a state of its own (`CommonError`), so that neither its
noise nor its jumps reach the landing. The vehicle's velocity serves for a start and for the rate at which the
pad's course turns, and there an error does little. Every kind of measurement is fused at its exposure,
echoes at their time; `gating.Timeline` puts late ones in place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.base.geometry import EYE3, ZERO3, FloatArray, Vector3, add, scale, wrap_angle
from companion.config import PadFilterConfig
from companion.estimate.gating import CHI_SQUARE_999, Gate, passes
from companion.estimate.motion import MotionHistory
from companion.estimate.pad.frame_correction import frame_rotation_increment
from companion.estimate.pad.model_bank import (
    PLACE,
    SPEED,
    BankState,
    Innovation,
    ModelBank,
    ModelTransition,
    advance,
    innovation,
)
from companion.estimate.pad.observation import FIRST, NO_AXIS_M2, CommonError, RelativeFix, with_common
from companion.estimate.pad.pad_models import (
    HORIZONTAL,
    TURN,
    PadModels,
    Turn,
    course_turn,
    vertical_names,
)
from companion.estimate.pad.pad_types import (
    HIGHEST_ECHO_M,
    PAIRS_AT,
    STATES_AT,
    CombinedEstimate,
    HeightMeasurement,
    PadInput,
    PadMeasurement,
    PadSnapshot,
)
from companion.estimate.pad.tilt_filter import LEVEL, AngleState, TiltState
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
UNKNOWN_PLACE_M: Final = 1000.0  # of a pad before the first fix of it
FIX_TIMEOUT_S: Final = 5.0  # fixes of an unseen pad refused for so long: it starts again from the next
FIRST_CLIMB_STD_M_S: Final = 0.4  # at the first sighting: pads drive, but hardly rise

_NOISE_FLOOR_M2: Final = 0.0002**2 * EYE3  # of a sighting
_CLIMB: Final = 1  # the second of the bank's groups

# the models' innovations, the mixture's, and its covariance by the upper triangle
_Compared = tuple[Innovation, Vector3, tuple[float, ...]]
# of a measurement: the value, its variances, and the pairs of states of which it is the sum
_Part = tuple[Vector3, tuple[float, float, float, float], tuple[int, ...]]


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
        self._heading, self._tilt = AngleState(), LEVEL
        self.time_s = self.seen_time_s = self.observed_time_s = -math.inf
        self._common: tuple[CommonError, ...] = ()  # a pair of states each, after the pad's
        self._slow_share = 0.0
        self._refused: tuple[RefusedSighting, ...] = ()  # lately, since one was accepted
        self._before_step: PadSnapshot | None = None  # until a sighting confirms the step
        self.gates: dict[str, Gate] = {}

    # ------------------------------------------------------------ replayable

    def snapshot(self) -> PadSnapshot:
        """The whole state; cheap, since every step makes new arrays."""
        return PadSnapshot(
            self.time_s,
            self._bank.state if self._bank.started else None,
            self._turn,
            self._heading,
            self.gates,
            self.seen_time_s,
            self._slow_share,
            self._tilt,
            self._refused,
            self._before_step,
            self.observed_time_s,
            self._common,
        )

    def restore(self, snapshot: PadSnapshot) -> None:
        """Go on from a snapshot."""
        self.time_s, self.seen_time_s = snapshot.time_s, snapshot.seen_time_s
        self._turn, self.gates, self._slow_share = snapshot.turn, snapshot.gates, snapshot.slow_share
        self._heading, self._tilt = snapshot.heading, snapshot.tilt
        self._refused, self._before_step = snapshot.refused, snapshot.before_step
        self.observed_time_s, self._common = snapshot.observed_time_s, snapshot.common
        self._bank.restore(snapshot.models)

    def apply(self, time_s: float, item: PadInput) -> None:
        """Predict to time_s and take the input in."""
        if self._bank.started:
            self._predict(time_s)
        if isinstance(item, HeightMeasurement):
            self._take_height(item)
        elif isinstance(item, PadMeasurement):
            self._take_sighting(time_s, item)
        else:
            self._take_fix(time_s, item)

    # ------------------------------------------------------------ prediction

    def predicted(self, snapshot: PadSnapshot, time_s: float) -> CombinedEstimate | None:
        """The state at a time not before the snapshot's; None when there is no pad in the snapshot.

        Unseen, models go their own ways and are blended at the end: how they differ is part of the
        uncertainty.
        """
        if snapshot.models is None:
            return None
        dt_s = time_s - snapshot.time_s
        step, yaw = self._step(snapshot, time_s)
        moved = advance(snapshot.models, step)
        heading = snapshot.heading.after(dt_s, HEADING_ACCELERATION_RAD_S2_RTHZ, yaw)
        blend = self._bank.blend(moved)
        probabilities, (jerk_n, jerk_e) = moved.probabilities.tolist(), moved.means[TURN, 6:8].tolist()
        turning = probabilities[TURN]
        return CombinedEstimate(
            x=blend.mean[:, :FIRST].take(STATES_AT),
            P=blend.covariance[:, :FIRST, :FIRST].take(PAIRS_AT),
            heading_rad=wrap_angle(heading.angle_rad),
            heading_rate_rad_s=heading.rate_rad_s,
            seen_time_s=snapshot.seen_time_s,
            turn_rate_rad_s=snapshot.turn.rate_rad_s,
            slow_share=snapshot.slow_share,
            jerk_m_s3=(turning * jerk_n, turning * jerk_e),
            models=dict(zip(self._names, probabilities, strict=True)),
            tilt=snapshot.tilt.after(dt_s, self._config.tilt_acceleration_rad_s2_rthz),
            observed_time_s=snapshot.observed_time_s,
        )

    def _predict(self, time_s: float) -> None:
        if time_s <= self.time_s:
            return
        dt_s = time_s - self.time_s
        step, turned_rad = self._step(self.snapshot(), time_s)
        self._bank.predict(dt_s, step)
        self._heading = self._heading.after(dt_s, HEADING_ACCELERATION_RAD_S2_RTHZ, turned_rad)
        self._tilt = self._tilt.after(dt_s, self._config.tilt_acceleration_rad_s2_rthz)
        self.time_s = time_s

    def _step(self, since: PadSnapshot, end_s: float) -> tuple[ModelTransition, float]:
        """How the models move since a state, the vehicle's motion taken off; how north turns (rad).

        With a correction of the attitude turns what the camera has seen, not what a fix has said of NED.
        """
        assert since.models is not None
        start_s, dt_s = since.time_s, end_s - since.time_s
        correction, unseen_s = self._motion.corrected(start_s, end_s), end_s - since.seen_time_s
        turned = correction if unseen_s <= self._config.forget_s else ZERO3
        place, speed, unseen = self._motion.moved(start_s, end_s)
        added = frame_rotation_increment((place, speed), turned, since.models.means, dt_s, unseen_s)
        F, Q = self._models.step(dt_s, since.turn, self._motion.noise_density_m2_s3, unseen)
        group_of = self._bank.group_of
        step = ModelTransition(F, Q, added.take(group_of, axis=0))
        return with_common(step, since.common, dt_s, group_of), correction[2]

    # ------------------------------------------------------------ measurements

    def _take_sighting(self, time_s: float, sample: PadMeasurement) -> None:
        R = self._config.sighting_noise_scale**2 * sample.covariance_ned_m2 + _NOISE_FLOOR_M2
        if self._forgotten(time_s, self.observed_time_s):
            # of a pad that is forgotten nothing is expected, and the vehicle's way since then is, too
            self._start(time_s, sample, R)
            return
        seen, y, S = self._compared(sample, R)
        if self._forgotten(time_s, self.seen_time_s):
            # the first of a pad that something else has led to; where it is not there, that was wrong
            if passes(y, S):
                self._bank.update(seen)
                self._begin_view(time_s, sample)
            else:
                self._start(time_s, sample, R)
            return
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
        self.seen_time_s = self.observed_time_s = time_s

    def _forgotten(self, time_s: float, since_s: float) -> bool:
        return not self._bank.started or time_s - since_s > self._config.forget_s

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
        self,
        value_ned: Vector3,
        variances: tuple[float, float, float, float],
        pairs: Sequence[int] = (PLACE,),
    ) -> Innovation:
        """Of a relative position, or another sum of pairs; variances: north, with east, east, down."""
        north, east, down = value_ned
        a, b, d, f = variances
        groups = np.array([[north, east, a, b, b, d], [down, 0.0, f, 0.0, 0.0, NO_AXIS_M2]])
        models = groups.take(self._bank.group_of, axis=0)
        return innovation(self._bank.state, models[:, :2], models[:, 2:].reshape(-1, 2, 2), pairs)

    def _mixture(self, seen: Innovation) -> tuple[Vector3, tuple[float, float, float, float]]:
        """The mixture's innovation, and its variances as above."""
        mean, covariance = self._bank.blend(BankState(seen.y, seen.S, self._bank.state.probabilities))
        (north, east), (down, _) = mean.tolist()
        ((a, b), (_, d)), ((f, _), _) = covariance.tolist()
        return (north, east, down), (a, b, d, f)

    def _take_heading(self, sample: PadMeasurement) -> None:
        innovation = wrap_angle(sample.heading_rad - self._heading.angle_rad)
        noise = sample.heading_std_rad**2 + math.radians(HEADING_NOISE_DEG) ** 2
        passed = innovation * innovation <= CHI_SQUARE_999[1] * (self._heading.variance + noise)
        self._record("heading", passed)
        if passed:
            self._heading = self._heading.corrected(innovation, noise)
        elif self.gates["heading"].shut_out(self.time_s, self._config.sighting_timeout_s):
            self._start_heading(sample)

    def _take_height(self, sample: HeightMeasurement) -> None:
        """Height of the sensor over the board = relative position's z - the sensor's own offset."""
        if not self._bank.started:
            return
        north, east, down = sample.sensor_offset_ned_m
        z = sample.height_m + down
        seen = self._innovation((north, east, z), (0.0, 0.0, 0.0, sample.noise_m**2))
        (away_n, away_e, higher), (a, _, d, f) = self._mixture(seen)
        low = z - higher < HIGHEST_ECHO_M
        if not low or math.hypot(away_n, away_e) + math.sqrt(a + d) >= self._half_width_m:
            return  # the pad's middle is too far from under the sensor
        passed = higher * higher <= CHI_SQUARE_999[1] * f
        self._record("range", passed)
        if passed:
            self._bank.update(seen, _CLIMB)

    # ------------------------------------------------------------ what no camera made

    def _take_fix(self, time_s: float, fix: RelativeFix) -> None:
        """One whose source may be off for long: how far is estimated beside the pad."""
        if self._forgotten(time_s, self.observed_time_s):
            self._start_by_fix(time_s, fix)
            return
        parts = self._parts(fix)
        passed = not self._contradicted(time_s, fix.gate) and all(
            self._fits(self._innovation(*part)) for part in parts
        )
        self._record(fix.gate, passed)
        if passed:
            self._update(parts)
            self.observed_time_s = time_s
        elif self._forgotten(time_s, self.seen_time_s) and self.gates[fix.gate].shut_out(
            time_s, FIX_TIMEOUT_S
        ):
            self._start_by_fix(time_s, fix)

    def _contradicted(self, time_s: float, gate: str) -> bool:
        """Whether a source's last fix was refused, and the pad is out of sight since, or almost.

        What sightings contradicted does not come true as they end and the pad is known less well.
        """
        refused = self.gates.get(gate, Gate()).refused_in_a_row > 0
        unseen = time_s - self.seen_time_s > self._config.sighting_timeout_s
        return refused and unseen and not self._forgotten(time_s, self.seen_time_s)

    def _parts(self, fix: RelativeFix) -> tuple[_Part, ...]:
        """Its position, of which its source's error is a part, and its velocity."""
        (a, b, _), (_, d, _), (_, _, f) = fix.covariance_ned_m2.tolist()
        place = (fix.position_ned_m, (a, b, d, f), (PLACE, *self._pair_of(fix.common)))
        if fix.relative_velocity is None:
            return (place,)
        velocity, (north, east, down) = fix.relative_velocity
        return place, (velocity, (north**2, 0.0, east**2, down**2), (SPEED,))

    def _update(self, parts: Sequence[_Part]) -> None:
        """One after the other: the second expects what the first has told."""
        for part in parts:
            self._bank.update(self._innovation(*part))

    def _fits(self, seen: Innovation) -> bool:
        y, (a, b, d, f) = self._mixture(seen)
        return passes(y, (a, b, 0.0, d, 0.0, f))

    def _pair_of(self, error: CommonError | None) -> tuple[int, ...]:
        """The first of the pair of states that such an error is, from now on."""
        if error is None:
            return ()
        sources = [known.source for known in self._common]
        if error.source not in sources:
            self._bank.widen(error.variances_m2.take(self._bank.group_of, axis=0))
            self._common = (*self._common, error)
            return (FIRST + 2 * len(sources),)
        at = sources.index(error.source)
        self._common = (*self._common[:at], error, *self._common[at + 1 :])
        return (FIRST + 2 * at,)

    def _start_by_fix(self, time_s: float, fix: RelativeFix) -> None:
        """Of a pad of which nothing is known the first fix tells all, as every later one its part."""
        self._start_motion(time_s, fix, UNKNOWN_PLACE_M**2 * EYE3)
        self._update(self._parts(fix))
        self.seen_time_s, self.observed_time_s = -math.inf, time_s
        self._turn, self._heading, self._tilt = Turn(), AngleState(), LEVEL
        self._slow_share, self._refused, self._before_step = 0.0, (), None
        self._record(fix.gate, True)

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
        """From one sighting; see `_start_motion`."""
        self._start_motion(time_s, sample, R, velocity)
        if velocity is None:
            self._begin_view(time_s, sample)
            return
        self._begin_sight(time_s, sample)
        self._take_heading(sample)  # a stop says nothing of how it turns or tilts

    def _start_motion(
        self,
        time_s: float,
        sample: PadMeasurement | RelativeFix,
        R: FloatArray,
        velocity: VelocityEstimate | None = None,
    ) -> None:
        """From one place: the pad may stand or drive at a few m/s, the vehicle knows its own speed so far.

        Or with the relative velocity of its own that is given.
        """
        P, plane, climb = np.zeros((self._models.count, 8, 8)), *self._models.groups
        P[plane, :2, :2], P[climb, 0, 0] = R[:2, :2], R[2, 2]
        if velocity is None:
            vn, ve, vd = scale(sample.vehicle_velocity_ned_m_s, -1.0)
            first, (sn, se, sd) = self._config.first_speed_std_m_s**2, sample.vehicle_velocity_std_m_s
            P[plane, 2, 2], P[plane, 3, 3] = first + sn**2, first + se**2
            P[climb, 2, 2] = FIRST_CLIMB_STD_M_S**2 + sd**2
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
        self.time_s, self._common = time_s, ()

    def _begin_view(self, time_s: float, sample: PadMeasurement) -> None:
        """All that only a camera sees begins with this sighting."""
        self._begin_sight(time_s, sample)
        self._start_heading(sample)
        self._tilt = (
            LEVEL if sample.tilt_rad is None else TiltState.first(sample.tilt_rad, sample.tilt_std_rad)
        )

    def _begin_sight(self, time_s: float, sample: PadMeasurement) -> None:
        self._turn, self._slow_share = Turn(), sample.slow_share
        self._refused, self._before_step = (), None
        self.seen_time_s = self.observed_time_s = time_s
        self._record("sighting", True)

    def _start_heading(self, sample: PadMeasurement) -> None:
        variance = sample.heading_std_rad**2 + math.radians(1.0) ** 2
        self._heading = AngleState(sample.heading_rad, 0.0, variance, 0.0, 0.5**2)
        self._record("heading", True)
