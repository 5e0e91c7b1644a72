"""The touchdown, over the last third of a metre: wait over the pad, sink at a constant speed, rise, stand.

Heights count from the vehicle's reference point: with the feet on the pad it is leg_height over it.
Relative to the pad, NED axes, m and s. What is detected says what may follow; the mission's table decides.

During the sink the speed counts, not the height: what was lost while the pad fell away is not made up for,
since that would be a faster contact.

It commits (`wait`, `rise`) when, for `settled_s`, it is no more than `WITHIN_HAND_M` below where it waits,
the pad is seen, the contact will probably be within the limits (`SuccessEstimate`; what is probable enough
falls with the time of the try, which goes on over a break-off) and no obstacle comes near on the way down;
and, by the mission's table, the pad is inside the fence until the landing ends.

`sink` checks in this order:
  1. about to slide off the pad, seen below `_low_m`, while the IMU is heard: MISALIGNED;
  2. contact, by its filter, or by echoes alone while the pad is unseen for `blind_s`: CONTACT;
  3. contact begins to show, or the IMU is silent: nothing else counts;
  4. the pad lost, unseen for `blind_s` or not below by the echoes: PAD_LOST with room to rise, else PAD_GONE;
  5. no contact in time: PAD_GONE if a height says that the feet are down, or, over a pad out of view, once no
     sink has been felt for as long; else, of a vehicle that sinks or hovers in view, MISALIGNED;
  6. it will probably not be within the limits, with room: BREAK_OFF;
  7. so far aside that a foot may miss the pad, above `_low_m`: MISALIGNED, even without room.
While the pad is unseen (`UNSEEN_S`) 1, 6 and 7 say nothing: it sinks on by the prediction.
"""

from __future__ import annotations

import math

from companion.base.geometry import GRAVITY_M_S2, subtract
from companion.base.messages import LandedState, PadState, RangeSample, VehicleState
from companion.base.motion import Motion
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import LandingConfig, TouchdownConfig
from companion.plan.debounce import Debounce, StepClock
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import LONGEST_CYCLE_S, PlanInputs
from companion.plan.landing.contact import (
    AWAY_M,
    BUMP_S,
    FRESH_S,
    RESPONDS_S,
    UNSEEN_S,
    WITHIN_HAND_M,
    LandDetector,
    ShortEchoes,
    echo_height_m,
    imu_fresh,
)
from companion.plan.landing.contact_filter import (
    SINK_TAU_S,
    ContactFilter,
    FeetMotion,
    feet_motion,
    lowest_foot_m,
)
from companion.plan.landing.drift import LEADS_S
from companion.plan.landing.levelling import SLOWEST_SINK, Levelling
from companion.plan.landing.relative_state import vehicle_motion
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.landing.success import SuccessEstimate
from companion.plan.trajectory.course import Course
from companion.plan.trajectory.reference_generator import ReferenceGenerator

# Time constant with which the reference's height follows the vehicle's.
_GIVE_WAY_S = 0.3
_HELD_UP = 1.0 / 3.0  # of the sink asked for: it goes on down without a vehicle that sinks less
_FASTER_M_S = 0.16  # a planned sink may be exceeded by this where nothing feels it
# Probability of a contact within the limits: it commits at once to what is so likely, after `giving_up_s` to
# what is likelier than not; what has been less likely than that for so long it breaks off.
_COMMITS = 0.9
_BREAKS_OFF = 0.5
_WRONG_S = 0.1
# A sink is stopped at this rate, after `RESPONDS_S`: without that room no break-off begins.
_STOPS_M_S2 = 2.5
# While it corrects it tilts this much more than now or at contact: a foot hangs lower.
_TILTS_MORE_RAD = math.radians(3.0)
# Sliding over the pad slows it down by so much, with half its weight on the feet (friction 0.6).
_SLIDES_M_S2 = 3.0
_SLIDES_M_S = 0.5  # slower it stays where it touches
# Where the last estimate has the feet within `WITHIN_HAND_M`, short echoes alone show them down, and an echo
# that agrees with it shows that the pad, unseen for long, is below all the same.
_AGREES_M = 0.05


class TouchdownSequence:
    """One try: what the vehicle does in every cycle.

    Steers the reference in the pad's frame; each returns what is detected, and why.
    """

    def __init__(
        self,
        config: TouchdownConfig,
        landing: LandingConfig,
        generator: ReferenceGenerator,
        standing_height: StandingHeight,
        pad_half_width_m: float,
        success: SuccessEstimate,
        now_s: float,
    ) -> None:
        """Start a try with the leg height that is known by now."""
        self._config, self._landing, self._generator = config, landing, generator
        self._success, self._since_s = success, now_s
        self.slack = 1.0  # widens the limits aside; a low battery may change it within a try
        self._vehicle = vehicle = standing_height.vehicle
        self._leg_std_m = standing_height.std_m
        self._feet_on_pad_m = pad_half_width_m - vehicle.foot_reach_m
        self._wait_height_m = vehicle.leg_height_m + landing.wait_height_m
        # lower, a foot may touch: there the offset aside leads to no climb any more, and a slide does
        self._low_m = vehicle.leg_height_m + 2.0 * config.contact_margin_m
        self._standing = LandDetector(config, vehicle, now_s)
        self._gives_way, self._contact_due_s = StepClock(), now_s
        self._held = Debounce()
        self.contact = ContactFilter(config, self._leg_std_m)
        self.short_echoes = ShortEchoes(config.contact_speed_m_s)
        self.levelling = Levelling(config, vehicle, self._leg_std_m)
        self._left, self._lowest_m = False, math.inf
        self.met: PadState | None = None  # the pad as the feet met it, or as it was seen since

    def _meet(self, sight: PadState | None, *, down: bool) -> bool:
        """Note the pad, unless the feet may be down: then no prediction takes it away; whether it is seen."""
        seen = sight is not None and sight.unseen_s <= UNSEEN_S
        if seen or not down:
            self.met = sight
        return seen

    def unconfirmed(self, sight: PadState | None) -> bool:
        """Whether nothing shows the feet on the pad since our setpoints may not have arrived."""
        unseen = sight is None or sight.unseen_s > UNSEEN_S
        return unseen and self._standing.doubted

    # ------------------------------------------------------------ wait, and rise to where it waits

    def wait(self, sight: PadState | None, now_s: float) -> DetectedEvent | None:
        """Hover over the pad for a moment to land."""
        c, waited_s = self._config, now_s - self._since_s
        self._generator.fly_to(Motion((0.0, 0.0, -self._wait_height_m)), now_s)
        # as in the descent: an unseen pad's predicted height sinks or rises without end, and is soon a guess
        if sight is None or sight.unseen_s > self._landing.pause_unseen_s:
            unseen_s = self._landing.pause_unseen_s
            return MissionEvent.PAD_LOST, f"not seen for {unseen_s:.1f} s just above the pad"
        sinks_for_s = self._sinks_for_s(now_s)
        _, contact = self._lead(now_s + sinks_for_s, now_s)
        likely, worst = self._likely(sight, contact, sinks_for_s, now_s)
        if waited_s >= c.giving_up_s:
            return MissionEvent.MISALIGNED, f"not settled in {waited_s:.0f} s: {worst}"
        ready = (
            sight.unseen_s <= UNSEEN_S
            and sight.height_m >= self._wait_height_m - WITHIN_HAND_M
            and likely >= _COMMITS - (_COMMITS - _BREAKS_OFF) * waited_s / c.giving_up_s
            and self._generator.avoidance.free_for((0.0, 0.0, -self._vehicle.leg_height_m), self.way_down_s())
        )
        if self._held.held_s("settled", ready, now_s) >= c.settled_s:
            return MissionEvent.COMMIT, "committed to land: sinking"
        return None

    def rise(self, sight: PadState | None, now_s: float) -> DetectedEvent | None:
        event = self.wait(sight, now_s)
        risen = event is None and not self._generator.rising(now_s)
        return (MissionEvent.RISEN, "on the way back up") if risen else event

    def break_off(self, now_s: float) -> None:
        """Begin to rise, at once; waiting goes on from the reference's own state."""
        self._generator.rise(now_s)
        self.levelling.reset()
        self._held.end()

    def _likely(self, sight: PadState, contact: Motion, ahead_s: float, now_s: float) -> tuple[float, str]:
        """How likely a contact so much later is within the limits, and what speaks most against it.

        contact: how the reference itself touches.
        """
        success, tilt = self._success, self._success.tilt
        needed_m_s2 = abs(tilt.predicted_m_s2(ahead_s))
        factors = success.factors(
            sight,
            self._generator.at(now_s),
            ahead_s,
            sink_m_s=max(self.levelling.planned_m_s, self.levelling.sink_m_s(needed_m_s2)),
            contact=contact,
            drift=self.levelling.drift(needed_m_s2, tilt.scatter_m2_s4, success.sink_std_m_s, ahead_s),
            slack=self.slack,
        )
        worst = min(factors, key=lambda name: factors[name])
        return math.prod(factors.values()), f"{worst} within its limit with {100.0 * factors[worst]:.0f} %"

    def _lead(self, due_s: float, now_s: float) -> tuple[Course | None, Motion]:
        """The reference's way against the drift of a level vehicle, and how it touches, horizontally.

        None: it levels off or is about to.
        """
        drift = self.levelling.drift_of(self._success.tilt.predicted_m_s2(due_s - now_s), due_s)
        lead = None if self.levelling.begun else drift.lead(self._generator.at, self._generator.limits, now_s)
        if lead is not None:
            return lead, lead.at(due_s)
        from_s = max(now_s, drift.begins_s)
        return None, drift.contact(self._generator.at(from_s), from_s)

    def way_down_s(self) -> float:
        """How long from here until the feet stand and the motors are off, at most."""
        slowest_m_s = self._config.contact_speed_m_s
        way_s = self._way_s(self._wait_height_m, slowest_m_s)
        return self._config.settled_s + way_s + self._config.land_after_s

    def _sinks_for_s(self, now_s: float) -> float:
        """How long from a commit until the feet touch, by the sink that the tilt by then asks for."""
        height_m = -self._generator.at(now_s).position_m[2]
        slowest_s = self._way_s(height_m, self._config.contact_speed_m_s)
        needed_m_s2 = abs(self._success.tilt.predicted_m_s2(slowest_s))
        return self._way_s(height_m, self.levelling.sink_m_s(needed_m_s2))

    def _way_s(self, height_m: float, sink_m_s: float) -> float:
        """The way down at that speed; the blend covers half of what the speed would."""
        c = self._config
        return max(c.blend_s, 0.5 * c.blend_s + (height_m - self._vehicle.leg_height_m) / sink_m_s)

    # ------------------------------------------------------------ sink

    def commit(self, now_s: float) -> None:
        c = self._config
        self._gives_way.step_s(now_s)
        self._held.end()
        self._lowest_m = math.inf
        self.contact = ContactFilter(c, self._leg_std_m)
        speed_m_s = self.levelling.planned_m_s = self.levelling.sink_m_s(
            abs(self._success.tilt.predicted_m_s2(self._sinks_for_s(now_s)))
        )
        blended_m = self._generator.sink(speed_m_s, c.blend_s, now_s)
        left_m = self._generator.at(now_s).position_m[2] + blended_m + self._vehicle.leg_height_m
        self._contact_due_s = self.levelling.due_s = now_s + c.blend_s + max(0.0, -left_m) / speed_m_s

    def sink(self, sight: PadState | None, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Go down at a constant speed, until the feet touch or something is wrong."""
        seen = self._meet(sight, down=self.short_echoes.begun)
        unfelt_s = 0.0 if inputs.vehicle is None else now_s - inputs.vehicle.sensed_time_s
        silent = unfelt_s > FRESH_S
        if sight is not None and not silent and (slides := self._slides(sight)):
            self._lift_off(sight, now_s)
            return MissionEvent.MISALIGNED, slides
        # far aside it tilts because it flies back or escapes: it is not about to stand
        tilt_rad = 0.0 if sight is not None and self._escapes(sight, now_s) else self._success.tilt.tilt_rad
        hangs_m = lowest_foot_m(self._vehicle, tilt_rad)
        asked_m_s, obeys = self._generator.at(now_s).velocity_m_s[2], not inputs.link.silent
        feet = feet_motion(
            sight,
            asked_m_s,
            inputs.range if obeys else None,
            now_s,
            config=self._config,
            vehicle=self._vehicle,
            obeys=obeys,
            felt_s=now_s - unfelt_s,
            hangs_m=hangs_m,
        )
        self.contact.update(feet, now_s, landed=inputs.autopilot.landed is LandedState.ON_GROUND)
        blind = sight is not None and sight.age_s > self._config.blind_s
        # of a pad that is in view the filter knows better whether the feet stand on it
        stops = obeys and not seen and _stopped(feet, inputs.vehicle if blind else None)
        stands_s = self._held.held_s("stands", stops, feet.felt_s)
        echo_m = echo_height_m(inputs.range, self._vehicle, now_s)
        feet_m = self._vehicle.leg_height_m + hangs_m + self._config.contact_margin_m
        short = echo_m is not None and echo_m <= feet_m
        within_hand = obeys and sight is not None and self._within_hand(sight, unfelt_s)
        self.short_echoes.note(inputs.range if within_hand and short else None)
        if self.contact.contact:
            return MissionEvent.CONTACT, self.contact.in_words()
        if blind and self.short_echoes.standing(now_s):
            return MissionEvent.CONTACT, "echoes that shorten no more"
        if self.contact.touching:
            self.levelling.touching(now_s)
        if self.contact.touching or silent:
            return None  # without the IMU all else is only predicted
        if (lost := self._lost(sight, inputs.range, now_s)) is not None:
            return lost
        assert sight is not None
        down = feet.low(self._config.contact_margin_m) or stands_s >= self._config.overdue_s
        return self._go_down(sight, asked_m_s, now_s, down=down, stopped=stops)

    def _lost(self, sight: PadState | None, echo: RangeSample | None, now_s: float) -> DetectedEvent | None:
        """Whether the pad is lost: unseen for too long, or unseen and not below any more by the echoes.

        It rises at once while there is room, and otherwise goes straight down, without the pad's motion.
        """
        c = self._config
        unseen = sight is None or sight.unseen_s > UNSEEN_S
        echo_m = echo_height_m(echo, self._vehicle, now_s)
        below_m = math.inf if sight is None else sight.height_m
        deeper = unseen and echo_m is not None and echo_m > below_m + AWAY_M
        # by the echoes' own times: one alone, however long none follows it, is one
        gone = self._held.held_s("deeper", deeper, now_s if echo is None else echo.time_s) >= BUMP_S
        agrees = echo_m is not None and abs(echo_m - below_m) <= _AGREES_M
        believed = sight is not None and (sight.age_s <= c.blind_s or (agrees and self._within_hand(sight)))
        if believed and not gone:
            return None
        sink_m_s = self.levelling.planned_m_s if sight is None else sight.sink_m_s
        # an echo gives no room that the last sightings do not: no rangefinder shows less than its blind zone
        room_m = below_m if echo_m is None else echo_m if gone else min(echo_m, below_m)
        if not self._has_room(room_m, sink_m_s):
            return MissionEvent.PAD_GONE, "pad lost, no room to climb"
        self._generator.rise(now_s)
        why = "pad no longer below" if gone else f"not seen for {c.blind_s:.1f} s"
        return MissionEvent.PAD_LOST, f"{why} while sinking"

    def _within_hand(self, sight: PadState, unfelt_s: float = 0.0) -> bool:
        return sight.height_m - _FASTER_M_S * unfelt_s <= self._vehicle.leg_height_m + WITHIN_HAND_M

    def _go_down(
        self, sight: PadState, asked_m_s: float, now_s: float, *, down: bool, stopped: bool
    ) -> DetectedEvent | None:
        overdue_s = self._config.overdue_s
        if now_s > self._contact_due_s + overdue_s:
            overdue = f"no contact {overdue_s:.1f} s after the expected time"
            if down:
                return MissionEvent.PAD_GONE, overdue
            if not stopped:  # it may stand: that takes as long to be told
                self._lift_off(sight, now_s)
                return MissionEvent.MISALIGNED, overdue
        high = sight.height_m > self._low_m
        begun = asked_m_s >= 0.5 * self._config.contact_speed_m_s
        held_up = begun and sight.sink_m_s <= _HELD_UP * asked_m_s
        # A level vehicle drifts until it touches: from then on the reference goes down as planned. A vehicle
        # that the ground's cushion slows is pressed after it; one that stands is told by not following it.
        tilts_on = not self.levelling.begun
        self._give_way(sight if tilts_on and not held_up else None, now_s)
        tilt = self._success.tilt
        self.levelling.expect(sight, tilt, self._generator, now_s)
        if tilts_on and sight.unseen_s <= UNSEEN_S and self.levelling.due_s - now_s <= LEADS_S:
            self._sink_firmer(now_s)
        lead, contact = self._lead(self.levelling.due_s, now_s)
        if lead is not None and lead.start_s <= now_s:
            self._generator.lead(lead)
        if high and sight.unseen_s <= UNSEEN_S and sight.height_m < self._lowest_m:
            # a gust may have held it up: while it comes lower than before, the contact is due by what is seen
            self._lowest_m = sight.height_m
            self._contact_due_s = max(self._contact_due_s, self.levelling.due_s)
        wrong = self._wrong(sight, contact, now_s)
        if wrong and self._has_room(sight.height_m, sight.sink_m_s):
            return MissionEvent.BREAK_OFF, wrong
        if high and sight.unseen_s <= UNSEEN_S and self._escapes(sight, now_s):
            # even without room: a foot that touches on the way up is better than one beside a small pad
            self._generator.rise(now_s)
            return MissionEvent.MISALIGNED, f"lateral offset {100.0 * sight.lateral_m:.0f} cm while sinking"
        return None

    def _sink_firmer(self, now_s: float) -> None:
        """By what is needed now, which a gust may have changed, and by the tilt that is to be levelled off.

        Levelling off gains lift, which makes the contact late.
        """
        tilt = self._success.tilt
        tilt_m_s2 = GRAVITY_M_S2 * math.tan(tilt.tilt_rad)
        firm_m_s = self.levelling.sink_m_s(max(tilt_m_s2, abs(tilt.predicted_m_s2(0.0))))
        if firm_m_s > self.levelling.planned_m_s:
            self.levelling.planned_m_s = firm_m_s
            blend_s = max(SINK_TAU_S, self._generator.end_s - now_s)
            self._generator.sink(firm_m_s, blend_s, now_s, leads=True)

    def _escapes(self, sight: PadState, now_s: float) -> bool:
        """Whether it is so far aside that it would miss the pad: by itself, and not for a lead."""
        x, y, _ = subtract(sight.vehicle_from_pad.position_m, self._generator.at(now_s).position_m)
        return min(sight.lateral_m, math.hypot(x, y)) > self.slack * self._config.escape_lateral_m

    def _slides(self, sight: PadState) -> str:
        """Says so when feet that touch would slide off the pad, it having stopped, or escape; else "".

        By the speed that was seen: a vehicle that is stopped at the contact feels the same whether it slides
        over the pad from then on or the pad has stopped with it, and the next sightings tell.
        """
        (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.seen_velocity_ned_m_s
        speed_m_s = math.hypot(vx, vy)
        slides_s = 0.5 * speed_m_s / _SLIDES_M_S2
        farthest_m = max(self.slack * self._config.escape_lateral_m, self._feet_on_pad_m)
        # a filter that has just started says any speed, but not that it knows it
        known = sight.unseen_s <= UNSEEN_S and sight.height_m <= self._low_m
        fast = speed_m_s >= max(_SLIDES_M_S, SIGMA_THRESHOLD * sight.velocity_std_m_s)
        off = known and fast and math.hypot(x + slides_s * vx, y + slides_s * vy) > farthest_m
        return f"sliding over the pad at {speed_m_s:.1f} m/s" if off else ""

    def _wrong(self, sight: PadState, contact: Motion, now_s: float) -> str:
        """Why this landing would probably be hard or off the mark; "" while it is fine."""
        likely, worst = 1.0, ""
        if sight.unseen_s <= UNSEEN_S:  # else it may not be known yet when the contact is due
            ahead_s = max(0.0, self.levelling.due_s - now_s)
            likely, worst = self._likely(sight, contact, ahead_s, now_s)
        return worst if self._held.held_s("wrong", likely < _BREAKS_OFF, now_s) >= _WRONG_S else ""

    def _has_room(self, height_m: float, sink_m_s: float) -> bool:
        """Whether it can stop and rise before a foot touches what is so far below."""
        tilt_rad = (
            max(self._success.tilt.tilt_rad, math.radians(self._config.contact_tilt_deg)) + _TILTS_MORE_RAD
        )
        sink_m_s = max(0.0, sink_m_s)
        stops_m = sink_m_s * RESPONDS_S + sink_m_s * sink_m_s / (2.0 * _STOPS_M_S2)
        hangs_m = self._vehicle.foot_reach_m * math.sin(tilt_rad)
        room_m = max(self._config.break_off_above_m, stops_m + hangs_m)
        return height_m - self._vehicle.leg_height_m > room_m

    def _give_way(self, sight: PadState | None, now_s: float) -> None:
        """Let the reference's height follow the vehicle's; not near the pad, where the vehicle may stand."""
        share = min(LONGEST_CYCLE_S, self._gives_way.step_s(now_s)) / _GIVE_WAY_S
        if sight is not None and sight.unseen_s <= UNSEEN_S:
            self._generator.shift_down(share * (-sight.height_m - self._generator.at(now_s).position_m[2]))

    # ------------------------------------------------------------ set down, and stand

    def begin_set_down(self, vehicle: VehicleState | None, now_s: float) -> None:
        """Begin to go straight down, level: nothing shows the feet down but the pad at the legs' height."""
        self.contact = ContactFilter(self._config, self._leg_std_m)
        self._go_straight_down(vehicle, now_s)
        self._standing = LandDetector(self._config, self._vehicle, now_s)
        self.levelling.reset()
        self.levelling.stay(now_s)

    def begin_stand(self, sight: PadState | None, now_s: float) -> None:
        self._standing = LandDetector(self._config, self._vehicle, now_s, sight)
        self._stay_down(now_s)

    def _go_straight_down(self, vehicle: VehicleState | None, now_s: float) -> None:
        """In the EKF's NED, from the vehicle's own motion on, and no more sideways than that.

        Until the autopilot is in the LAND that is asked for, our own setpoints bring the vehicle down.
        """
        if vehicle is not None:
            actual = vehicle_motion(vehicle)
            down = Motion(actual.position_m, (0.0, 0.0, actual.velocity_m_s[2]))
            self._generator.start("local", down, now_s)
        self._generator.sink(self._config.contact_speed_m_s, self._config.blend_s, now_s)

    def set_down(self, sight: PadState | None, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Go straight down, without the pad, until something solid is below."""
        self._meet(sight, down=self.short_echoes.begun or self.contact.touching)
        vehicle, landed, fresh = inputs.vehicle, inputs.autopilot.landed, imu_fresh(inputs.vehicle, now_s)
        self.levelling.stay(now_s)
        if vehicle is not None:
            # A reference that the vehicle does not follow would pull it after it later: so far below two or
            # three times as fast as is planned. Without the IMU its height is a guess.
            ahead_m = self._generator.at(now_s).position_m[2] - vehicle.position_ned_m[2]
            unheard = inputs.link.silent or not inputs.autopilot.offboard
            if unheard or (fresh and ahead_m > WITHIN_HAND_M):
                self._go_straight_down(vehicle, now_s)
        if landed is LandedState.ON_GROUND:
            return MissionEvent.LANDING_DETECTED, "the autopilot reports landed"
        heard = not inputs.link.silent
        # it means to go down, though its reference begins anew with the vehicle's own speed
        feet = feet_motion(
            sight,
            self._config.contact_speed_m_s,
            inputs.range if heard else None,
            now_s,
            config=self._config,
            vehicle=self._vehicle,
            obeys=inputs.autopilot.offboard and heard,
            felt_s=-math.inf if vehicle is None else vehicle.sensed_time_s,
            state=vehicle,
        )
        self.contact.update(feet, now_s)
        return (MissionEvent.CONTACT, self.contact.in_words()) if self.contact.contact else None

    def stand(
        self, sight: PadState | None, inputs: PlanInputs, now_s: float, *, in_land: bool
    ) -> DetectedEvent | None:
        """Stay on the pad; `in_land`: the autopilot lands there."""
        self._stay_down(now_s)
        self._meet(sight, down=not self._standing.doubted)
        if why := self._leaves(sight, inputs, now_s, in_land=in_land):
            self._lift_off(sight, now_s)
            return MissionEvent.OFF_PAD, why
        return self._standing.step(sight, inputs, now_s)

    def leave(self, inputs: PlanInputs, sight: PadState | None, now_s: float) -> None:
        """Go on leaving the pad; while the link is silent the climb begins anew from where the vehicle is."""
        if inputs.link.silent:
            self._lift_off(sight, now_s)

    def leaving(self, now_s: float) -> bool:
        """Whether it has just left the pad, and its feet are over it by no more than a tilt drops them."""
        return self._left and self._generator.rising(now_s)

    def _lift_off(self, sight: PadState | None, now_s: float) -> None:
        """Up before anything else, and level: the tilt that follows the pad would drag a foot over it."""
        if sight is not None:
            self._generator.start("pad", sight.vehicle_from_pad, now_s)
        self._generator.rise(now_s)
        self._left = True
        self.levelling.reset()
        self.levelling.stay(now_s)

    def _leaves(self, sight: PadState | None, inputs: PlanInputs, now_s: float, *, in_land: bool) -> str:
        """Why it does not stay on the pad; "" while it does."""
        why = self._standing.off_by_itself(sight, inputs, now_s)
        # LAND is asked for just where nothing shows the feet down
        if why and not (in_land and self.unconfirmed(sight)):
            return why
        away = sight is not None and self._standing.off_pad(sight, now_s)
        slips = self._standing.arrives(now_s) or self._standing.doubted
        if sight is not None and slips and (slides := self._slides(sight)):
            return slides
        return "the pad is well below the feet" if away else ""

    def _stay_down(self, now_s: float) -> None:
        self._generator.start("pad", Motion((0.0, 0.0, -self._vehicle.leg_height_m)), now_s)


def _stopped(feet: FeetMotion, vehicle: VehicleState | None) -> bool:
    """Whether it neither sinks nor rises by half of the sink asked for, and no height has it surely higher.

    What is told to sink and does not stands on something. Of a pad that is unseen for long no motion is
    known: then the `vehicle`'s own counts.
    """
    sink_m_s = feet.sink_m_s if vehicle is None else vehicle.velocity_ned_m_s[2]
    slow = sink_m_s is not None and abs(sink_m_s) <= SLOWEST_SINK * feet.asked_m_s
    return slow and not feet.surely_high
