"""The probability of contact with the pad, by camera, rangefinder and IMU with their uncertainties. m, s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from companion.base.geometry import GRAVITY_M_S2
from companion.base.messages import PadState, RangeSample, VehicleState
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.debounce import StepClock
from companion.plan.inputs import LONGEST_CYCLE_S
from companion.plan.landing.contact import FRESH_S, RESPONDS_S, WITHIN_HAND_M, echo_height_m
from companion.plan.landing.levelling import NORMAL, SLOWEST_SINK

# In the air the sink comes back to the one asked for within this (the vertical loop); how gusts scatter it is
# learnt over `_LEARNS_S`, and taken for no less than 0.05 m/s in a thirtieth of a second. On springing legs
# it scatters by 0.04 m/s in as long. Both by time: shorter cycles are no more evidence.
SINK_TAU_S: Final = 0.25
_GUSTS_M2_S3: Final = 0.075
_RESTS_M2_S3: Final = 0.048
_LEARNS_S: Final = 1.0
# Standing: the sink after the blow; how fast what the legs give dies out; how long it stands where gusts and
# a deck lift it again.
_HIT_M_S: Final = 0.1
_LEGS_TAU_S: Final = 0.03
_STANDS_FOR_S: Final = 10.0
# One sink in a hundred is anything: an estimate jumps.
_OUTLIERS: Final = 0.01
_OUTLIER_M_S: Final = 0.3
# The share of files that are wrong about the legs, and by how much; by more than `WITHIN_HAND_M` none is.
_LEGS_WRONG: Final = 0.05
_WRONG_LEGS_M: Final = 0.05
_ECHO_STD_M: Final = 0.02
# Tilting more than this it is not about to stand, whatever is near.
_MOST_FOOT_TILT_RAD: Final = math.radians(15.0)
_SUREST: Final = 1.0 - 1e-6
_TINY: Final = 1e-12


@dataclass(frozen=True, slots=True)
class FeetMotion:
    """How high the lowest foot is over what they are to stand on (m), and how fast it sinks (m/s).

    By the leg height of vehicle file and measurements. None where nothing tells; standard deviations beside.
    `felt_s` is when the IMU last felt it, `asked_m_s` the sink that is asked for.
    """

    over_m: float | None
    over_std_m: float
    sink_m_s: float | None
    sink_std_m_s: float
    felt_s: float
    asked_m_s: float

    def low(self, margin_m: float) -> bool:
        """Whether the foot is down by its height."""
        return self.over_m is not None and self.over_m <= margin_m

    @property
    def surely_high(self) -> bool:
        """Higher than legs are wrong."""
        return self.over_m is not None and self.over_m - SIGMA_THRESHOLD * self.over_std_m > WITHIN_HAND_M


def feet_motion(
    sight: PadState | None,
    asked_m_s: float,
    echo: RangeSample | None,
    now_s: float,
    *,
    config: TouchdownConfig,
    vehicle: VehicleConfig,
    obeys: bool,
    felt_s: float,
    hangs_m: float = 0.0,
    state: VehicleState | None = None,
) -> FeetMotion:
    """The feet's motion over the pad by camera and IMU, or by the echo where that is surer and agrees.

    An autopilot that does not obey may hold its height by itself: its sink tells only where the height has
    the feet down. The pad's height and motion are known for `blind_s`, as surely as they say; after that the
    vehicle's motion is taken, `state`, if it is given.
    """
    height_m, std_m = math.nan, math.inf
    sink_m_s, sink_std_m_s = math.nan, math.inf
    if sight is not None and sight.age_s <= config.blind_s:
        height_m, std_m = sight.height_m, sight.height_std_m
        sink_m_s, sink_std_m_s = sight.sink_m_s, sight.sink_std_m_s
    elif state is not None:
        # an axis of three
        sink_m_s, sink_std_m_s = state.velocity_ned_m_s[2], state.velocity_std_m_s / math.sqrt(3.0)
    echo_m = echo_height_m(echo, vehicle, now_s)
    if echo_m is not None and not std_m <= _ECHO_STD_M:
        # an echo that the camera contradicts came from elsewhere, or is stuck
        apart_m = abs(echo_m - height_m)
        if math.isnan(height_m) or apart_m <= SIGMA_THRESHOLD * math.hypot(std_m, _ECHO_STD_M):
            height_m, std_m = echo_m, _ECHO_STD_M
    known = math.isfinite(height_m + std_m)
    over_m = height_m - vehicle.leg_height_m - hangs_m if known else None
    down = over_m is not None and over_m <= config.contact_margin_m
    tells = (obeys or down) and math.isfinite(sink_m_s + sink_std_m_s)
    return FeetMotion(over_m, std_m, sink_m_s if tells else None, sink_std_m_s, felt_s, asked_m_s)


def lowest_foot_m(vehicle: VehicleConfig, tilt_rad: float) -> float:
    """How much lower the lowest foot of a tilting vehicle is.

    One that holds such a vehicle up is dragged over the pad by what that does to come back over the middle.
    """
    return vehicle.foot_reach_m * math.sin(min(tilt_rad, _MOST_FOOT_TILT_RAD))


class ContactFilter:
    """The probability that the feet stand on the pad: the forward filter of a hidden Markov model, two modes.

    In the air the sink comes back to the one asked for, and scatters as it has done on the way down.
    Standing, what the legs give dies out. The feet meet the pad with the hazard of the leg height's error: no
    height alone shows contact, since camera and echo go by the same leg height; where they may meet it, a
    sink that stops tells within two cycles. What the IMU felt last counts for `FRESH_S`: a sink that is only
    predicted is no evidence, and without evidence it flies. Nor does it stand where the feet are surely
    higher than legs are wrong. It stands where the autopilot says so and a height has the feet down.

    `unloading`, of the weight, is what the feet are given, within `contact_s`: it grows while they rather
    stand, else it shrinks. What only a gust holds up sinks without its thrust, and is told from what stands;
    feet that carry weight do not slide. It is capped where the feet may be so high that they would fall too
    fast. Once the feet are given all that they may be, that is contact: at once where a height has the feet
    down, else once the IMU has felt no fall for as long as a vehicle takes to respond.
    """

    def __init__(self, config: TouchdownConfig, leg_std_m: float) -> None:
        """In the air; `leg_std_m`: standard deviation of the leg height."""
        self._config, self._leg_std_m = config, leg_std_m
        self._scatter_m2_s3 = 0.0  # of the sink about the expected one, in the air
        self._sink_m_s: float | None = None
        self._felt_s, self._clock = -math.inf, StepClock()
        self._share = self._bears_s = 0.0  # of the weight; how long the feet have had all they may
        self._most, self._low = 1.0, False
        self.probability = 0.0

    def update(self, feet: FeetMotion, now_s: float, *, landed: bool = False) -> None:
        """Take in a cycle's motion of the feet; `landed`: the autopilot says that it stands."""
        elapsed_s = min(LONGEST_CYCLE_S, self._clock.step_s(now_s))
        felt_for_s = 0.0
        if feet.sink_m_s is not None and feet.felt_s > self._felt_s:
            felt_for_s = min(LONGEST_CYCLE_S, feet.felt_s - self._felt_s)
            before_m_s, self._sink_m_s, self._felt_s = self._sink_m_s, feet.sink_m_s, feet.felt_s
            self._know_height(feet)
            if before_m_s is not None:
                self._compare(feet, before_m_s, feet.sink_m_s, felt_for_s)
        elif now_s - self._felt_s > FRESH_S:
            self._sink_m_s, self.probability = None, 0.0
        if feet.surely_high:
            self.probability = 0.0
        elif landed and feet.low(self._config.contact_margin_m):
            self.probability = _SUREST
            self._know_height(feet)
        gives = (2.0 * self.probability - 1.0) * elapsed_s / max(self._config.contact_s, 1e-3)
        self._share = max(0.0, min(1.0, self._share + gives))
        self._bears_s = self._bears_s + felt_for_s if self._share == 1.0 else 0.0

    def _know_height(self, feet: FeetMotion) -> None:
        """Whether the feet are down by it, and the most that may be unloaded; no prediction changes that."""
        self._low = feet.low(self._config.contact_margin_m)
        if feet.over_m is not None:
            falls_m = max(_TINY, feet.over_m - self._leg_std_m)
            self._most = min(1.0, self._config.fastest_contact_m_s**2 / (2.0 * GRAVITY_M_S2 * falls_m))

    @property
    def unloading(self) -> float:
        """The share of the thrust (0 to 1) that is taken away."""
        return min(self._share, self._most)

    @property
    def touching(self) -> bool:
        """Whether it rather stands than not."""
        return self.probability >= 0.5

    @property
    def contact(self) -> bool:
        """Whether it stands and its feet carry it."""
        return self.touching and self._share == 1.0 and (self._low or self._bears_s >= RESPONDS_S)

    def in_words(self) -> str:
        return f"feet down with {100.0 * self.probability:.0f} %"

    def _compare(self, feet: FeetMotion, before_m_s: float, sink_m_s: float, elapsed_s: float) -> None:
        """Bayes' rule over what was felt: both modes' expectations against the sink that is felt."""
        expected_m_s = feet.asked_m_s + (before_m_s - feet.asked_m_s) * math.exp(-elapsed_s / SINK_TAU_S)
        surprise_m_s, noise = sink_m_s - expected_m_s, feet.sink_std_m_s**2
        left_m_s = before_m_s * math.exp(-elapsed_s / _LEGS_TAU_S)
        flies = _likelihood(surprise_m_s, max(self._scatter_m2_s3, _GUSTS_M2_S3) * elapsed_s + noise)
        rests = _likelihood(sink_m_s - left_m_s, _RESTS_M2_S3 * elapsed_s + noise)
        hits = _density(sink_m_s, _HIT_M_S**2 + noise)
        stood, flew = self.probability, 1.0 - self.probability
        way_m = max(feet.asked_m_s, before_m_s, 0.0) * elapsed_s
        # a height alone shows no contact, however little is known of the sink: it has to stop
        stops = sink_m_s <= max(0.0, min(before_m_s, SLOWEST_SINK * feet.asked_m_s))
        meets = -math.expm1(-self._hazard_m(feet) * way_m) if stops else 0.0
        leaves = elapsed_s / _STANDS_FOR_S
        stands = stood * (1.0 - leaves) * rests + flew * meets * hits
        in_air = (flew * (1.0 - meets) + stood * leaves) * flies
        self.probability = min(_SUREST, stands / (stands + in_air + _TINY))
        scatter_m2_s3 = surprise_m_s**2 / elapsed_s
        self._scatter_m2_s3 += flew * elapsed_s / _LEARNS_S * (scatter_m2_s3 - self._scatter_m2_s3)

    def _hazard_m(self, feet: FeetMotion) -> float:
        """Of meeting the pad in the next metre down, for feet that have not met it so far (1/m)."""
        if feet.over_m is None or feet.over_m > WITHIN_HAND_M:
            return 0.0
        density = not_yet = 0.0
        for weight, std_m in ((1.0 - _LEGS_WRONG, self._leg_std_m), (_LEGS_WRONG, _WRONG_LEGS_M)):
            spread_m = math.hypot(std_m, feet.over_std_m) + _TINY
            density += weight * NORMAL.pdf(feet.over_m / spread_m) / spread_m
            not_yet += weight * NORMAL.cdf(feet.over_m / spread_m)
        # so far below where the feet are told to be that neither is left: as the wider one goes on (Mills)
        return density / not_yet if not_yet > _TINY else -feet.over_m / _WRONG_LEGS_M**2


def _likelihood(difference: float, variance: float) -> float:
    """A normal distribution's density, outliers aside, but for a factor."""
    wide = _OUTLIERS * _density(difference, _OUTLIER_M_S**2)
    return (1.0 - _OUTLIERS) * _density(difference, variance) + wide


def _density(difference: float, variance: float) -> float:
    """A normal distribution's, but for a factor."""
    return math.exp(-0.5 * difference * difference / variance) / math.sqrt(variance)
