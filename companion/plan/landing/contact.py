"""Contact with the pad: the signs of it, and whether a vehicle that stands may be disarmed.

Contact is felt: the vehicle stops sinking although its reference goes on down, as PX4's and ArduPilot's land
detectors have it. A height says only where that may be, and by the same number, `leg_height_m`, whether the
camera or an echo measures it: one that is 8 cm wrong would cut the thrust 8 cm up.
A motor that stops is no landing by itself: a kill switch, a crash detected and a vehicle that has toppled
over the pad's edge end in the same word.
Heights count from the vehicle's reference point: with the feet on the pad it is leg_height over it. m, s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Quaternion, norm, tilt_from_quat
from companion.base.messages import LandedState, PadState, RangeSample, VehicleState
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.debounce import Debounce
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import LONGEST_CYCLE_S, PlanInputs

FRESH_S = 0.3  # of IMU and echoes
RESPONDS_S: Final = 0.2  # from a decision until the vehicle tilts: command, dead time, the gate of jerk
UNSEEN_S = 0.2  # five frames lost in a row at 30 Hz; a slower vision's every frame
# What is older is no sign, and no estimate to fly by. A pad's age counts from the exposure, and vision may
# take 0.2 s of it: so old the pad is off its predicted place by 0.4 m at most, if it brakes with 3 m/s².
KNOWN_S: Final = 0.5
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
# Over the standing height that the file says, the feet may stand: legs may be longer than that.
WITHIN_HAND_M: Final = 0.1
# A pad this far below the feet is not under them: a bounce, a soft pad and an echo's error are less.
AWAY_M = 0.25
_BOUNCES_S = 0.3  # a bounce is shorter; so long after the contact the feet may slide
# Without thrust it falls at g; a third of that is no deck's motion.
_FALLS_M_S2 = GRAVITY_M_S2 / 3.0
BUMP_S: Final = 0.15  # a bump of the pad is over sooner, or a spike of an echo; a fall is 11 cm by then
# Nothing stays up without thrust for so long: rest lasts so much longer without the IMU; and what nothing has
# shown down for so long, and as long again since the contact, is not proven to have landed.
_UNPROVEN_S = 2.0
# Tilting more than this it is not about to stand, whatever is near.
_MOST_FOOT_TILT_RAD = math.radians(15.0)
_ATTITUDE_FRESH_S: Final = 1.0
# No deck that is landed on tilts so far (24 deg is refused for a ship's), and legs that stand do not either.
_UPRIGHT_RAD: Final = math.radians(30.0)
# No flight of ours tilts so far. What flies like that, or falls, accelerates by g or nearly so, or is so fast
# that its drag is 1.7 g.
_LIES_RAD: Final = math.radians(60.0)
_DRAGGED_M_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class FeetMotion:
    """How high the lowest foot is over what it is to stand on (m), and how fast it sinks (m/s).

    By the leg height of vehicle file and measurements. None where nothing tells; standard deviations beside.
    `asked_m_s` is the sink that is asked for.
    """

    over_m: float | None
    over_std_m: float
    sink_m_s: float | None
    sink_std_m_s: float
    asked_m_s: float

    def low(self, margin_m: float) -> bool:
        """Whether the foot is down by its height."""
        return self.over_m is not None and self.over_m <= margin_m


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
    hangs_m: float = 0.0,
    state: VehicleState | None = None,
) -> FeetMotion:
    """The feet's motion over the pad by camera and IMU, or by the echo where that is surer.

    A sink is `felt` while the IMU is heard; else it is predicted, and tells nothing. Nor does one that stops
    tell anything of an autopilot that does not obey: it may hold its height by itself. The pad's own motion
    is known for `blind_s`; after that the vehicle's is taken, `state`, if it is given.
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
    elif state is not None:
        # an axis of three
        sink_m_s, sink_std_m_s = state.velocity_ned_m_s[2], state.velocity_std_m_s / math.sqrt(3.0)
    known = math.isfinite(height_m + std_m)
    tells = felt and obeys and math.isfinite(sink_m_s) and sink_std_m_s <= _HIT_M_S
    return FeetMotion(
        height_m - vehicle.leg_height_m - hangs_m if known else None,
        std_m,
        sink_m_s if tells else None,
        sink_std_m_s,
        asked_m_s,
    )


def lowest_foot_m(vehicle: VehicleConfig, tilt_rad: float) -> float:
    """How much lower the lowest foot of a tilting vehicle is.

    One that holds such a vehicle up is dragged over the pad by what that does to come back over the middle.
    """
    return vehicle.foot_reach_m * math.sin(min(tilt_rad, _MOST_FOOT_TILT_RAD))


def echo_height_m(echo: RangeSample | None, vehicle: VehicleConfig, now_s: float) -> float | None:
    """Height of the reference point by a fresh echo."""
    if echo is None or now_s - echo.time_s > FRESH_S:
        return None
    return echo.distance_m + vehicle.range_position_body_m[2]


def _echo_within(echo: RangeSample | None, distance_m: float, now_s: float) -> bool:
    """Whether a fresh echo came from no farther than that."""
    return echo is not None and now_s - echo.time_s <= FRESH_S and echo.distance_m <= distance_m


def imu_fresh(vehicle: VehicleState | None, now_s: float) -> bool:
    """Whether our IMU is heard."""
    return vehicle is not None and now_s - vehicle.sensed_time_s <= FRESH_S


class ContactFilter:
    """The probability that the feet stand on the pad: the forward filter of a hidden Markov model, two modes.

    In the air the sink comes back to the one asked for, and scatters as it has done on the way down.
    Standing, what the legs give dies out. The feet meet the pad with the hazard of the leg height's error: no
    height alone shows contact, since camera and echo go by the same leg height; where they may meet it, a
    sink that stops tells within two cycles. Where no sink tells (`sink_m_s` None) it stays as it is.

    `share`, of the weight, is what the feet are given, within `contact_s`: it grows while they rather stand,
    else it shrinks. What only a gust holds up sinks without its thrust, and is told from what stands; feet
    that carry weight do not slide. All of it, for as long as a vehicle takes to respond, is contact.
    """

    def __init__(self, config: TouchdownConfig, leg_std_m: float) -> None:
        """In the air; `leg_std_m`: standard deviation of the leg height."""
        self._contact_s, self._leg_std_m = max(config.contact_s, 1e-3), leg_std_m
        self._variance_m2_s2 = 0.0  # of a cycle's sink about the expected one, in the air
        self._sink_m_s: float | None = None
        self._updated_s = -math.inf
        self._carried_s = 0.0  # how long the feet have had all of the weight
        self.probability = self.share = 0.0

    def update(self, feet: FeetMotion, now_s: float, *, landed: bool = False) -> None:
        """Take in a cycle's motion of the feet; `landed`: the autopilot says that it stands."""
        elapsed_s = min(LONGEST_CYCLE_S, now_s - self._updated_s)
        self._updated_s = now_s
        before_m_s, self._sink_m_s = self._sink_m_s, feet.sink_m_s
        if before_m_s is not None and feet.sink_m_s is not None:
            self._compare(feet, before_m_s, feet.sink_m_s, elapsed_s, landed=landed)
        self.share += (2.0 * self.probability - 1.0) * elapsed_s / self._contact_s
        self.share = max(0.0, min(1.0, self.share))
        self._carried_s = self._carried_s + elapsed_s if self.share == 1.0 else 0.0

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

    @property
    def touching(self) -> bool:
        """Whether it rather stands than not."""
        return self.probability >= 0.5

    @property
    def contact(self) -> bool:
        """Whether it stands and its feet carry it."""
        return self.touching and self._carried_s >= RESPONDS_S

    def in_words(self) -> str:
        """How sure that is."""
        return f"feet down with {100.0 * self.probability:.0f} %"


def _likelihood(difference: float, variance: float) -> float:
    """A normal distribution's density, outliers aside, but for a factor."""
    wide = _OUTLIERS * _density(difference, _OUTLIER_M_S**2)
    return (1.0 - _OUTLIERS) * _density(difference, variance) + wide


def _density(difference: float, variance: float) -> float:
    """A normal distribution's, but for a factor."""
    return math.exp(-0.5 * difference * difference / variance) / math.sqrt(variance)


class ShortEchoes:
    """Short echoes in a row, of what the feet stand on: that they shorten no more shows the feet down.

    That is all that can be had without IMU and camera.
    """

    def __init__(self, sink_m_s: float) -> None:
        """None yet; `sink_m_s` is the slowest that is planned."""
        self._sink_m_s = sink_m_s
        self._row: list[RangeSample] = []

    def note(self, echo: RangeSample | None) -> None:
        """Take the newest echo, if it is short; None breaks the row."""
        if echo is None:
            self._row.clear()
        elif not self._row or echo.time_s > self._row[-1].time_s:
            self._row.append(echo)

    def standing(self, now_s: float) -> bool:
        """Whether they have shortened by less than half of a sink, over long enough, up to now."""
        if not self._row or now_s - self._row[-1].time_s > FRESH_S:
            return False
        newest = self._row[-1]
        # within it they would shorten by four times their noise at the slowest sink
        before = [echo for echo in self._row if newest.time_s - echo.time_s >= FRESH_S]
        if not before:
            return False
        lasted_s = newest.time_s - before[-1].time_s
        return before[-1].distance_m - newest.distance_m <= 0.5 * self._sink_m_s * lasted_s


class LandDetector:
    """A vehicle on the pad: detects that it rests there, and that it left."""

    def __init__(
        self, config: TouchdownConfig, vehicle: VehicleConfig, now_s: float, sight: PadState | None = None
    ) -> None:
        """The feet are on the pad from now on: where they were felt, if the file has shorter legs."""
        self._config, self._vehicle, self._since_s = config, vehicle, now_s
        felt_m = 0.0 if sight is None or sight.age_s > KNOWN_S else sight.height_m
        self._stood_m = max(self._vehicle.leg_height_m, felt_m)
        self._feet_m = self._stood_m + self._config.contact_margin_m
        self._held = Debounce()
        self.doubted = False

    def arrives(self, now_s: float) -> bool:
        """Whether the contact is so recent that the feet may still slide."""
        return now_s - self._since_s <= _BOUNCES_S

    def off_pad(self, sight: PadState, now_s: float) -> bool:
        """Whether the pad is seen well below the feet."""
        away = sight.unseen_s <= UNSEEN_S and sight.height_m > self._vehicle.leg_height_m + AWAY_M
        return self._held.held_s("away", away, now_s) >= _BOUNCES_S

    def off_by_itself(self, sight: PadState | None, inputs: PlanInputs, now_s: float) -> str:
        """Why it is not on the pad, though we had it pressed down; "" while it may be. Once a cycle.

        An autopilot that no setpoint reaches flies by itself: it levels and holds its height, over a pad that
        moves on. So a silence makes the contact `doubted`, until rest is proven anew or the autopilot has
        landed. Then only a pad that is seen, where it was seen while we were heard, shows the feet down: an
        echo tells a hand's breadth over it from standing on it no better than the leg height is known.
        While the IMU is silent too (it may come by the same link), an unseen pad does not show that it left.
        """
        able = self._held.held_s("able", imu_fresh(inputs.vehicle, now_s), now_s) >= FRESH_S
        landed = inputs.autopilot.landed is LandedState.ON_GROUND
        self.doubted = not landed and (self.doubted or inputs.link.silent)
        seen = sight if sight is not None and sight.unseen_s <= UNSEEN_S else None
        if not self.doubted:
            self._stood_m = self._stood_m if seen is None else min(seen.clearance_m, self._feet_m)
            return ""
        if seen is None:
            return "link silent, contact not confirmed" if able else ""
        surely_m = seen.clearance_m - SIGMA_THRESHOLD * seen.height_std_m
        # the camera sees a millimetre: from half the margin it falls with 0.4 m/s, from 3 cm with 0.8
        risen = surely_m > self._stood_m + 0.5 * self._config.contact_margin_m
        again = self._held.held_s("risen", risen, now_s) > 0.0  # in one sighting more
        return "link silent: the vehicle left the pad" if again else ""

    def step(self, sight: PadState | None, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Detect a landing: by the autopilot, by rest on the pad, or that nothing proves it."""
        agrees = inputs.autopilot.landed is LandedState.ON_GROUND
        down = self._shown_down(sight, None if self.doubted else inputs.range, now_s)
        rested_s = self._rested_s(inputs.vehicle, now_s, down=down)
        if agrees:
            return MissionEvent.LANDING_DETECTED, "the autopilot reports landed"
        if rested_s >= self._config.land_after_s:
            self.doubted = False
            return MissionEvent.AT_REST, f"for {rested_s:.1f} s on the pad"
        unshown_s = self._held.held_s("unshown", not down, now_s)
        if unshown_s >= _UNPROVEN_S and now_s - self._since_s >= 2.0 * _UNPROVEN_S:
            return MissionEvent.UNPROVEN, f"contact not confirmed for {unshown_s:.1f} s"
        return None

    def _shown_down(self, sight: PadState | None, echo: RangeSample | None, now_s: float) -> bool:
        """Whether a fresh sight or echo shows the feet on the pad now."""
        seen = sight is not None and sight.unseen_s <= UNSEEN_S and sight.height_m <= self._feet_m
        return seen or _echo_within(echo, self._feet_m - self._vehicle.range_position_body_m[2], now_s)

    def _rested_s(self, vehicle: VehicleState | None, now_s: float, *, down: bool) -> float:
        """How long (s) it has stood without a break, pressed down; negative when it does not, or may not.

        What is pressed down without thrust, with its feet shown down (`down`), and does not fall, stands. A
        silent IMU feels no fall: then it has to be shown down for longer.
        """
        silent = not imu_fresh(vehicle, now_s)
        falls = self._held.held_s("falls", accelerates(vehicle) and not silent, now_s) >= BUMP_S
        rested_s = self._held.held_s("rests", down and not falls, now_s)
        return rested_s - _UNPROVEN_S if silent else rested_s


def not_standing(
    sight: PadState | None,
    inputs: PlanInputs,
    vehicle: VehicleConfig,
    pad_reach_m: float,
    now_s: float,
    *,
    surface_m: float | None,
    touched: bool,
) -> str:
    """Why it does not stand upright on the pad, in words; "" when it does.

    Both attitudes count, ours and the autopilot's, as long as they are fresh. `pad_reach_m`: from the pad's
    middle to its corner. `surface_m`: the height over what several echoes agree on. `touched`: the feet have
    been shown down.
    """
    tilt_rad = max(map(tilt_from_quat, _attitudes(inputs, now_s)), default=None)
    if tilt_rad is None:
        return "attitude unknown"
    if tilt_rad > _UPRIGHT_RAD:
        return f"tilted by {math.degrees(tilt_rad):.0f} deg"
    if why := _elsewhere(sight, surface_m, vehicle.leg_height_m + AWAY_M, pad_reach_m):
        return why
    if not touched and inputs.autopilot.landed is not LandedState.ON_GROUND:
        return "contact never confirmed"
    return ""


def accelerates(vehicle: VehicleState | None) -> bool:
    """Whether it accelerates as what rests on something does not, or nothing tells."""
    return vehicle is None or norm(vehicle.acceleration_ned_m_s2) > _FALLS_M_S2


def lying_rad(inputs: PlanInputs, now_s: float) -> float:
    """How far it is tilted where both attitudes have it on its side, at no speed of a flight; else 0."""
    tilts_rad = [tilt_from_quat(attitude) for attitude in _attitudes(inputs, now_s)]
    if len(tilts_rad) < 2 or min(tilts_rad) <= _LIES_RAD or inputs.vehicle is None:
        return 0.0
    return 0.0 if norm(inputs.vehicle.velocity_ned_m_s) > _DRAGGED_M_S else min(tilts_rad)


def _elsewhere(sight: PadState | None, surface_m: float | None, deepest_m: float, pad_reach_m: float) -> str:
    """Where the pad is instead, by a fresh sight or else by the echoes; "" where neither says so."""
    if sight is None or sight.age_s > _ATTITUDE_FRESH_S:
        away = surface_m is not None and surface_m > deepest_m
        return f"surface {surface_m:.1f} m below" if away else ""
    if sight.lateral_m > pad_reach_m:
        return f"{sight.lateral_m:.1f} m beside the pad's centre"
    return f"the pad is {sight.height_m:.1f} m below" if sight.height_m > deepest_m else ""


def _attitudes(inputs: PlanInputs, now_s: float) -> Iterator[Quaternion]:
    ours = inputs.vehicle
    if ours is not None and ours.aligned and now_s - ours.sensed_time_s <= _ATTITUDE_FRESH_S:
        yield ours.attitude
    autopilot = inputs.autopilot
    if autopilot.attitude is not None and now_s - autopilot.attitude_time_s <= _ATTITUDE_FRESH_S:
        yield autopilot.attitude
