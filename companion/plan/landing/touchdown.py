"""The last third of a metre: wait for the moment, commit, sink at a constant speed, know the contact.

Heights count from the vehicle's reference point: with the feet on the pad it is leg_height over it.
References count from the pad, relative quantities are pad minus vehicle; NED axes, m and s.

Why a moment is gentle when the pad's acceleration is small: the vehicle follows an acceleration with a lag
(about 0.2 s), so that its speed relative to the pad is off by acceleration x lag, whatever the pad's speed.
On the last way down the speed counts, not the height: what was lost while the pad fell away is not made up
for, since that would be a faster contact. Sinking too fast all the same, the vehicle rises and waits again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.base.geometry import GRAVITY_M_S2, Quaternion, horizontal_acceleration, norm, tilt_from_quat
from companion.base.messages import LandedState, LevelOff, PadState, RangeSample, VehicleState
from companion.base.motion import Motion
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.mission.table import Event
from companion.plan.trajectory.guidance import Guide

_HEIGHT_TOLERANCE_M = 0.10
_SINK_TOLERANCE_M_S = 0.15
_FRESH_S = 0.3
_STALLED_M_S = 0.06
_STALLED_BELOW_M = 0.08
_AWAY_M = 0.25
_AWAY_S = 0.3
_SIGNS_NEEDED = 2
# The reference gives way to the vehicle's height with this time constant, in its cycles of planning.
_GIVE_WAY_S = 0.3
_LONGEST_CYCLE_S = 0.1
_TOO_FAST_S = 0.1
# The lean is smoothed so; the attitude needs about so long to follow, and the contact comes that much off its
# time: level from so long before it is due, for so long.
_LEAN_S = 0.25
_LEVEL_BEFORE_S = 0.31
_LEVEL_FOR_S = 0.42
_FOOT_DROP_M = 0.02
_TOO_MUCH_LEAN = 1.3
# In units of the patience: until then nothing widens, from then on more is borne by and by.
_PATIENT_TIMES = 2.0
_BORNE_PER_TIME = 0.35
# However impatient, nobody goes on down from farther aside than this, unless the setting says so.
_FARTHEST_ASIDE_M = 0.12
# A gust that has just begun shows in the speed first; a correction takes about so long to tell. Of 69 random
# landings this told the four that ended more than 8 cm off, half a second before contact.
_DRIFT_S = 0.22
# A sink is stopped within this delay and at this rate: a break-off that would not do must not begin.
_STOPS_AFTER_S = 0.2
_STOPS_M_S2 = 2.5
# Without thrust it falls at g; a third of that is no deck's motion.
_FALLS_M_S2 = GRAVITY_M_S2 / 3.0
_FALLS_S = 0.15  # a bump of the pad is over sooner; a fall is 11 cm by then
# Further than this it is not about to stand, whatever is near.
_MOST_FOOT_LEAN_RAD = math.radians(15.0)
# It leans more while it corrects, by so much over what it has or may have at contact: a foot hangs lower.
_LEANS_MORE_RAD = math.radians(3.0)

Finding = tuple[Event, str] | None


class Held:
    """Whether a condition has held without a break for a time."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def for_s(self, condition: bool, now_s: float) -> float:
        """How long (s) the condition has held; negative when it does not."""
        if not condition:
            self._since_s = None
            return -1.0
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s


def gentle(sight: PadState, config: TouchdownConfig) -> bool:
    """Whether the pad accelerates little enough for a soft contact."""
    a = sight.acceleration_ned_m_s2
    return (
        math.hypot(a[0], a[1]) <= config.gentle_horizontal_m_s2 and abs(a[2]) <= config.gentle_vertical_m_s2
    )


def aligned(sight: PadState, wait_height_m: float, slack: float, config: TouchdownConfig) -> bool:
    """Whether the vehicle stands over the pad's centre closely and quietly enough to commit."""
    return (
        sight.age_s <= _FRESH_S
        and sight.lateral_m <= config.lateral_m * slack
        and sight.lateral_speed_m_s <= config.lateral_speed_m_s * slack
        and abs(sight.height_m - wait_height_m) <= _HEIGHT_TOLERANCE_M * slack
        and abs(sight.sink_m_s) <= _SINK_TOLERANCE_M_S * slack
    )


@dataclass(frozen=True, slots=True)
class ContactSigns:
    """What speaks for standing on the pad."""

    low: bool
    stalled: bool
    short_echo: bool
    landed: bool

    @property
    def count(self) -> int:
        """How many agree."""
        return self.low + self.stalled + self.short_echo + self.landed


def contact_signs(
    sight: PadState | None,
    reference: Motion,
    echo: RangeSample | None,
    landed: LandedState,
    now_s: float,
    *,
    config: TouchdownConfig,
    vehicle: VehicleConfig,
    lean_rad: float = 0.0,
) -> ContactSigns:
    """Read the signs; `reference` counts from the pad, `sight` is relative to the vehicle.

    The lowest foot counts: one that holds a leaning vehicle up is dragged over the pad by what that vehicle
    does to come back over the middle.
    """
    hangs_m = vehicle.foot_reach_m * math.sin(min(lean_rad, _MOST_FOOT_LEAN_RAD))
    feet_m = vehicle.leg_height_m + hangs_m + config.contact_margin_m
    low = sight is not None and sight.height_m <= feet_m
    # the reference goes on down and the vehicle does not
    stalled = (
        sight is not None
        and reference.velocity_m_s[2] >= 0.5 * config.contact_speed_m_s
        and reference.position_m[2] + sight.height_m >= _STALLED_BELOW_M
        and abs(sight.sink_m_s) <= _STALLED_M_S
    )
    short_echo = _echo_within(echo, feet_m - vehicle.range_position_body_m[2], now_s)
    return ContactSigns(low, stalled, short_echo, landed is LandedState.ON_GROUND)


def _echo_within(echo: RangeSample | None, distance_m: float, now_s: float) -> bool:
    """Whether a fresh echo came from no farther than that."""
    return echo is not None and now_s - echo.time_s <= _FRESH_S and echo.distance_m <= distance_m


def _stopping_m(sink_m_s: float, lean_rad: float, foot_reach_m: float) -> float:
    """How much lower the lowest foot of a vehicle that sinks and leans so gets before it rises."""
    sink = max(0.0, sink_m_s)
    below_m = foot_reach_m * math.sin(lean_rad + _LEANS_MORE_RAD)
    return sink * _STOPS_AFTER_S + sink * sink / (2.0 * _STOPS_M_S2) + below_m


class Touchdown:
    """One attempt after another; `begin` at each. Steers the guide in the pad's frame."""

    def __init__(
        self, config: TouchdownConfig, vehicle: VehicleConfig, wait_height_m: float, guide: Guide
    ) -> None:
        self._config, self._vehicle, self._guide = config, vehicle, guide
        self._wait_height_m = vehicle.leg_height_m + wait_height_m
        self.begin(0.0, slack=1.0)

    def begin(self, now_s: float, slack: float) -> None:
        """Start waiting for the moment; `slack` widens what counts as aligned."""
        self._since_s, self._slack = now_s, slack
        self._contact_due_s: float | None = None
        self.contact_s: float | None = None
        self._settled, self._touching, self._away = Held(), Held(), Held()
        self._resting, self._falling, self._unshown = Held(), Held(), Held()
        self._too_fast, self._far_aside = Held(), Held()
        self._sunk_s = now_s
        self._lean_m_s2, self._tilt_rad = (0.0, 0.0), 0.0
        self.broken_off_by = ""
        self._felt_s: float | None = None
        self._level_due_s: float | None = None
        self._level_from_s: float | None = None

    @property
    def committed(self) -> bool:
        """Whether the vehicle is on its last way down."""
        return self._contact_due_s is not None

    @property
    def on_pad(self) -> bool:
        """Whether the feet stand on the pad."""
        return self.contact_s is not None

    def still_down(self, sight: PadState | None, echo: RangeSample | None, now_s: float) -> bool:
        """Whether a fresh sight or echo shows the feet on the pad now."""
        feet_m = self._vehicle.leg_height_m + self._config.contact_margin_m
        seen = sight is not None and sight.age_s <= _FRESH_S and sight.height_m <= feet_m
        return seen or _echo_within(echo, feet_m - self._vehicle.range_position_body_m[2], now_s)

    def rested_s(self, vehicle: VehicleState | None, now_s: float, *, down: bool) -> float:
        """How long (s) it has stood without a break, pressed down; negative when it does not, or may not.

        What is pressed down without thrust, with its feet shown down (`down`), and does not fall, stands.
        """
        jolted = vehicle is None or norm(vehicle.acceleration_ned_m_s2) > _FALLS_M_S2
        falls = self._falling.for_s(jolted, now_s) >= _FALLS_S
        return self._resting.for_s(down and not falls, now_s)

    def unshown_s(self, now_s: float, *, down: bool) -> float:
        """How long (s) nothing has shown the feet down, without a break; negative when something does."""
        return self._unshown.for_s(not down, now_s)

    def feel(self, attitude: Quaternion, now_s: float) -> None:
        """Take in how the vehicle leans: what it takes to go with the pad and against the wind."""
        x, y = horizontal_acceleration(attitude)
        self._tilt_rad = tilt_from_quat(attitude)
        share = 1.0 if self._felt_s is None else -math.expm1(-max(0.0, now_s - self._felt_s) / _LEAN_S)
        self._felt_s = now_s
        lx, ly = self._lean_m_s2
        self._lean_m_s2 = (lx + share * (x - lx), ly + share * (y - ly))

    def level_off(self) -> LevelOff | None:
        """When the vehicle may lean no further than it may at contact; None before it is committed.

        It goes level shortly before the contact is due, whatever the pad and the wind do meanwhile, and not
        for long: what the level vehicle cannot follow becomes speed over the pad.
        """
        from_s = self._level_from_s
        if from_s is None and self._level_due_s is not None:
            from_s = self._level_due_s - _LEVEL_BEFORE_S
        if from_s is None:
            return None
        return LevelOff(from_s, from_s + _LEVEL_FOR_S, math.radians(self._config.contact_tilt_deg))

    def step(
        self, sight: PadState | None, echo: RangeSample | None, landed: LandedState, now_s: float
    ) -> Finding:
        """Move on by one cycle; returns what happened, with words for it."""
        if self.on_pad:
            return self._stand(sight, now_s)
        if self.committed:
            return self._sink(sight, echo, landed, now_s)
        return self._wait(sight, now_s)

    def _wait(self, sight: PadState | None, now_s: float) -> Finding:
        c = self._config
        waited_s = now_s - self._since_s
        self._guide.fly_to(Motion((0.0, 0.0, -self._wait_height_m)), now_s)
        if sight is None or sight.age_s > c.blind_s:
            return Event.PAD_LOST, f"not seen for {c.blind_s:.1f} s just above it"
        impatience = self._impatience(now_s)
        slack = self._slack_by_now(now_s)
        ready = (
            aligned(sight, self._wait_height_m, slack, c)
            and not self._aside(sight, now_s)
            and (impatience >= 1.0 or gentle(sight, c))
            and self._lean_m_s2_now() <= self._most_lean_m_s2(now_s)
            and self._guide.stays_clear((0.0, 0.0, -self._vehicle.leg_height_m), self._way_down_s())
        )
        if waited_s >= c.giving_up_s:
            return (
                Event.MISALIGNED,
                f"no moment to land in {waited_s:.0f} s, {100.0 * sight.lateral_m:.0f} cm aside at last",
            )
        if self._settled.for_s(ready, now_s) >= c.settled_s:
            self._commit(now_s)
        return None

    def _way_down_s(self) -> float:
        """How long from here until the feet stand and the motors are off."""
        c = self._config
        sinking_s = (self._wait_height_m - self._vehicle.leg_height_m) / c.contact_speed_m_s
        return c.settled_s + c.blend_s + sinking_s + c.land_after_s

    def _commit(self, now_s: float) -> None:
        c = self._config
        self._sunk_s = now_s
        blended_m = self._guide.sink(c.contact_speed_m_s, c.blend_s, now_s)
        left_m = self._guide.at(now_s).position_m[2] + blended_m + self._vehicle.leg_height_m
        self._contact_due_s = now_s + c.blend_s + max(0.0, -left_m) / c.contact_speed_m_s

    def _sink(
        self, sight: PadState | None, echo: RangeSample | None, landed: LandedState, now_s: float
    ) -> Finding:
        c, v = self._config, self._vehicle
        assert self._contact_due_s is not None
        # one that leans so far aside is on its way back, or will escape: it is not about to stand
        far_aside = sight is not None and sight.lateral_m > c.escape_lateral_m * self._slack
        signs = contact_signs(
            sight,
            self._guide.at(now_s),
            echo,
            landed,
            now_s,
            config=c,
            vehicle=v,
            lean_rad=0.0 if far_aside else self._tilt_rad,
        )
        if self._touching.for_s(signs.count >= _SIGNS_NEEDED, now_s) >= c.contact_s:
            self.contact_s = now_s
            self._stay_down(now_s)
            names = [name for name in ("low", "stalled", "short_echo", "landed") if getattr(signs, name)]
            return Event.CONTACT, ", ".join(names).replace("_", " ")
        if signs.count >= _SIGNS_NEEDED:
            return None
        if sight is None or sight.age_s > c.blind_s:
            return Event.PAD_LOST, f"not seen for {c.blind_s:.1f} s on the last way down"
        if now_s > self._contact_due_s + c.overdue_s:
            self._guide.rise(now_s)
            return Event.MISALIGNED, f"no contact {c.overdue_s:.1f} s after it was due"
        # with the feet nearly down, climbing away would drag them over the pad
        high = sight.height_m > v.leg_height_m + 2.0 * c.contact_margin_m
        self._give_way(sight if high else None, now_s)
        self._expect_contact(sight, now_s)
        fast = sight.age_s <= _FRESH_S and sight.sink_m_s > c.fastest_contact_m_s
        sinks_fast = self._too_fast.for_s(fast, now_s) >= _TOO_FAST_S
        above_m = sight.height_m - v.leg_height_m
        wrong = "sinking too fast" if sinks_fast else self._off_the_mark(sight, now_s)
        lean_rad = max(self._tilt_rad, math.radians(c.contact_tilt_deg))
        room_m = _stopping_m(sight.sink_m_s, lean_rad, v.foot_reach_m)
        if wrong and above_m > max(c.break_off_above_m, room_m):
            self._break_off(wrong, now_s)
        elif high and sight.age_s <= _FRESH_S and sight.lateral_m > c.escape_lateral_m * self._slack:
            # without room for it: a foot that touches on the way up is better than one beside a small pad
            self._guide.rise(now_s)
            return Event.MISALIGNED, f"{100.0 * sight.lateral_m:.0f} cm aside on the last way down"
        return None

    def _break_off(self, reason: str, now_s: float) -> None:
        """Rise, at once, and wait again: `_wait` goes on from the reference's own state."""
        self._guide.rise(now_s)
        self.broken_off_by = reason
        self._contact_due_s = self._level_due_s = self._level_from_s = None
        self._settled, self._too_fast, self._far_aside = Held(), Held(), Held()

    def _off_the_mark(self, sight: PadState, now_s: float) -> str:
        """Why this will not be a landing on the mark; "" while it may be."""
        if self._lean_m_s2_now() > _TOO_MUCH_LEAN * self._most_lean_m_s2(now_s):
            return "leaning too far"
        far = sight.age_s <= _FRESH_S and self._aside(sight, now_s)
        if self._far_aside.for_s(far, now_s) >= _TOO_FAST_S:
            return f"{100.0 * sight.lateral_m:.0f} cm aside at {sight.lateral_speed_m_s:.2f} m/s"
        return ""

    def _aside(self, sight: PadState, now_s: float) -> bool:
        """Whether it is too far aside to start down or go on, or will be."""
        (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.relative_velocity_ned_m_s
        soon_m = math.hypot(x + _DRIFT_S * vx, y + _DRIFT_S * vy)
        farthest_m = self._farthest_aside_m(now_s)
        return sight.lateral_m > farthest_m or soon_m > farthest_m * self._borne(now_s)

    def _farthest_aside_m(self, now_s: float) -> float:
        """Farther aside than this it neither starts down nor goes on."""
        setting_m = self._config.break_off_lateral_m
        return min(max(setting_m, _FARTHEST_ASIDE_M), setting_m * self._slack_by_now(now_s))

    def _impatience(self, now_s: float) -> float:
        """How often the patience has run out in this try."""
        return (now_s - self._since_s) / self._config.patience_s

    def _slack_by_now(self, now_s: float) -> float:
        return self._slack * (1.0 if self._impatience(now_s) < _PATIENT_TIMES else 1.5)

    def _lean_m_s2_now(self) -> float:
        return math.hypot(*self._lean_m_s2)

    def _most_lean_m_s2(self, now_s: float) -> float:
        """How much lean can be levelled off, and by and by how much is borne."""
        return self._config.gentle_lean_m_s2 * self._borne(now_s)

    def _borne(self, now_s: float) -> float:
        """By how much more lean and drift are borne by and by, because they will not get less."""
        return 1.0 + _BORNE_PER_TIME * max(0.0, self._impatience(now_s) - _PATIENT_TIMES)

    def _expect_contact(self, sight: PadState, now_s: float) -> None:
        """When the feet will touch, by the height as seen and the speed as planned."""
        if self._level_from_s is not None or sight.age_s > _FRESH_S:
            return
        left_m = max(0.0, sight.height_m - self._vehicle.leg_height_m - _FOOT_DROP_M)
        self._level_due_s = now_s + left_m / max(self._config.contact_speed_m_s, sight.sink_m_s)
        if now_s >= self._level_due_s - _LEVEL_BEFORE_S:
            self._level_from_s = now_s

    def _give_way(self, sight: PadState | None, now_s: float) -> None:
        """Let the reference's height drift to the vehicle's; not near the pad, where it may stand."""
        share = min(_LONGEST_CYCLE_S, now_s - self._sunk_s) / _GIVE_WAY_S
        self._sunk_s = now_s
        if sight is not None and sight.age_s <= _FRESH_S:
            self._guide.shift_down(share * (-sight.height_m - self._guide.at(now_s).position_m[2]))

    def _stay_down(self, now_s: float) -> None:
        self._guide.start("pad", Motion((0.0, 0.0, -self._vehicle.leg_height_m)), now_s)

    def _stand(self, sight: PadState | None, now_s: float) -> Finding:
        """Standing; unless the pad is seen to be well below after all."""
        self._stay_down(now_s)
        away = (
            sight is not None
            and sight.age_s <= _FRESH_S
            and sight.height_m > self._vehicle.leg_height_m + _AWAY_M
        )
        if sight is not None and self._away.for_s(away, now_s) >= _AWAY_S:
            self._guide.start("pad", sight.vehicle_from_pad, now_s)
            return Event.MISALIGNED, "off the pad again"
        return None
