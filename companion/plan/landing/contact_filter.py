"""The probability of contact with the pad, by camera, rangefinder and IMU with their uncertainties. m, s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

from companion.base.messages import PadState, RangeSample
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.inputs import LONGEST_CYCLE_S
from companion.plan.landing.contact import KNOWN_S, WITHIN_HAND_M, echo_height_m

# In the air the sink comes back to the one asked for within this (the vertical loop); what gusts make of it
# in a cycle is learnt over `_LEARNS_S`, and taken for no less than `_GUST_M_S`.
_SINK_TAU_S: Final = 0.25
_GUST_M_S: Final = 0.05
_LEARNS_S: Final = 1.0
# Standing: the sink after the blow, how fast what the legs give dies out, and what is left; how long it
# stands where gusts and a deck lift it again.
_HIT_M_S: Final = 0.1
_LEGS_TAU_S: Final = 0.03
_REST_M_S: Final = 0.04
_STANDS_FOR_S: Final = 10.0
# One sink in a hundred is anything: an estimate jumps.
_OUTLIERS: Final = 0.01
_OUTLIER_M_S: Final = 0.3
# The share of files that are wrong about the legs, and by how much; by more than `WITHIN_HAND_M` none is.
_LEGS_WRONG: Final = 0.05
_WRONG_LEGS_M: Final = 0.05
_ECHO_STD_M: Final = 0.02
_LANDED_RATIO: Final = 2.0  # a cycle: false reports of standing are rare, but last
_SUREST: Final = 1.0 - 1e-6
_TINY: Final = 1e-12
_NORMAL: Final = NormalDist()


@dataclass(frozen=True, slots=True)
class FeetMotion:
    """How high the feet are over what they are to stand on (m), and how fast it sinks (m/s).

    By the leg height of vehicle file and measurements. None where nothing tells; standard deviations beside.
    `asked_m_s` is the sink that is asked for.
    """

    over_m: float | None
    over_std_m: float
    sink_m_s: float | None
    sink_std_m_s: float
    asked_m_s: float


def feet_motion(
    sight: PadState | None,
    asked_m_s: float,
    echo: RangeSample | None,
    now_s: float,
    *,
    config: TouchdownConfig,
    vehicle: VehicleConfig,
    obeys: bool,
    felt: bool,
) -> FeetMotion:
    """The feet's motion over the pad by camera and IMU, or by the echo where that is surer.

    A sink is `felt` while the IMU is heard; else it is predicted, and tells nothing. Nor does one that stops
    tell anything of an autopilot that does not obey: it may hold its height by itself. The pad's own motion
    is known for `blind_s`.
    """
    height_m, std_m = math.nan, math.inf
    if sight is not None and sight.age_s <= KNOWN_S:
        height_m, std_m = sight.height_m, sight.height_std_m
    echo_m = echo_height_m(echo, vehicle, now_s)
    if echo_m is not None and not std_m <= _ECHO_STD_M:
        height_m, std_m = echo_m, _ECHO_STD_M
    sink_m_s, sink_std_m_s = math.nan, math.inf
    if sight is not None and sight.age_s <= config.blind_s:
        sink_m_s, sink_std_m_s = sight.sink_m_s, sight.sink_std_m_s
    known = math.isfinite(height_m + std_m)
    tells = felt and obeys and math.isfinite(sink_m_s) and sink_std_m_s <= _HIT_M_S
    return FeetMotion(
        height_m - vehicle.leg_height_m if known else None,
        std_m,
        sink_m_s if tells else None,
        sink_std_m_s,
        asked_m_s,
    )


class ContactFilter:
    """The probability that the feet stand on the pad: the forward filter of a hidden Markov model, two modes.

    In the air the sink comes back to the one asked for, and scatters as it has done on the way down.
    Standing, what the legs give dies out. The feet meet the pad with the hazard of the leg height's error: no
    height alone shows contact, since camera and echo go by the same leg height; where they may meet it, a
    sink that stops tells within two cycles. Where no sink tells (`sink_m_s` None) it stays as it is.

    In shadow: it is logged beside the signs of contact that decide (decision 89).
    """

    def __init__(self, leg_std_m: float) -> None:
        """In the air; `leg_std_m`: standard deviation of the leg height."""
        self._leg_std_m = leg_std_m
        self._variance_m2_s2 = 0.0  # of a cycle's sink about the expected one, in the air
        self._sink_m_s: float | None = None
        self._updated_s = -math.inf
        self.probability = 0.0

    def update(self, feet: FeetMotion, now_s: float, *, landed: bool = False) -> None:
        """Take in a cycle's motion of the feet; `landed`: the autopilot says that it stands."""
        elapsed_s = min(LONGEST_CYCLE_S, now_s - self._updated_s)
        self._updated_s = now_s
        before_m_s, self._sink_m_s = self._sink_m_s, feet.sink_m_s
        if before_m_s is not None and feet.sink_m_s is not None:
            self._compare(feet, before_m_s, feet.sink_m_s, elapsed_s, landed=landed)

    def _compare(
        self, feet: FeetMotion, before_m_s: float, sink_m_s: float, elapsed_s: float, *, landed: bool
    ) -> None:
        """Bayes' rule over a cycle: both modes' expectations against the sink that is felt."""
        expected_m_s = feet.asked_m_s + (before_m_s - feet.asked_m_s) * math.exp(-elapsed_s / _SINK_TAU_S)
        surprise_m_s, noise = sink_m_s - expected_m_s, feet.sink_std_m_s**2
        left_m_s = before_m_s * math.exp(-elapsed_s / _LEGS_TAU_S)
        flies = _likelihood(surprise_m_s, max(self._variance_m2_s2, _GUST_M_S**2) + noise)
        rests = _likelihood(sink_m_s - left_m_s, _REST_M_S**2 + noise)
        hits = _density(sink_m_s, _HIT_M_S**2 + noise)
        stood, flew = self.probability, 1.0 - self.probability
        way_m = max(feet.asked_m_s, before_m_s, 0.0) * elapsed_s
        # what is met makes nothing sink faster
        meets = -math.expm1(-self._hazard_m(feet) * way_m) if sink_m_s <= max(0.0, before_m_s) else 0.0
        leaves = elapsed_s / _STANDS_FOR_S
        stands = stood * (1.0 - leaves) * rests + flew * meets * hits
        in_air = (flew * (1.0 - meets) + stood * leaves) * flies
        if landed:
            stands *= _LANDED_RATIO
        self.probability = min(_SUREST, stands / (stands + in_air + _TINY))
        self._variance_m2_s2 += flew * elapsed_s / _LEARNS_S * (surprise_m_s**2 - self._variance_m2_s2)

    def _hazard_m(self, feet: FeetMotion) -> float:
        """Of meeting the pad in the next metre down, for feet that have not met it so far (1/m)."""
        if feet.over_m is None or feet.over_m > WITHIN_HAND_M:
            return 0.0
        density = not_yet = 0.0
        for weight, std_m in ((1.0 - _LEGS_WRONG, self._leg_std_m), (_LEGS_WRONG, _WRONG_LEGS_M)):
            spread_m = math.hypot(std_m, feet.over_std_m) + _TINY
            density += weight * _NORMAL.pdf(feet.over_m / spread_m) / spread_m
            not_yet += weight * _NORMAL.cdf(feet.over_m / spread_m)
        # so far below where the feet are told to be that neither is left: as the wider one goes on (Mills)
        return density / not_yet if not_yet > _TINY else -feet.over_m / _WRONG_LEGS_M**2


def _likelihood(difference: float, variance: float) -> float:
    """A normal distribution's density, outliers aside, but for a factor."""
    wide = _OUTLIERS * _density(difference, _OUTLIER_M_S**2)
    return (1.0 - _OUTLIERS) * _density(difference, variance) + wide


def _density(difference: float, variance: float) -> float:
    """A normal distribution's, but for a factor."""
    return math.exp(-0.5 * difference * difference / variance) / math.sqrt(variance)
