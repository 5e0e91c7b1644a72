"""Contact with the pad: what heights show, and whether a vehicle that stands may be disarmed.

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
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Quaternion, norm, tilt_from_quat
from companion.base.messages import LandedState, PadState, RangeSample, VehicleState
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import TouchdownConfig, VehicleConfig
from companion.plan.debounce import Debounce
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs

FRESH_S = 0.3  # of IMU and echoes
RESPONDS_S: Final = 0.2  # from a decision until the vehicle tilts: command, dead time, the gate of jerk
UNSEEN_S = 0.2  # five frames lost in a row at 30 Hz; a slower vision's every frame
# What is older is no sign, and no estimate to fly by. A pad's age counts from the exposure, and vision may
# take 0.2 s of it: so old the pad is off its predicted place by 0.4 m at most, if it brakes with 3 m/s².
KNOWN_S: Final = 0.5
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
_ATTITUDE_FRESH_S: Final = 1.0
# No deck that is landed on tilts so far (24 deg is refused for a ship's), and legs that stand do not either.
_UPRIGHT_RAD: Final = math.radians(30.0)
# No flight of ours tilts so far. What flies like that, or falls, accelerates by g or nearly so, or is so fast
# that its drag is 1.7 g.
_LIES_RAD: Final = math.radians(60.0)
_DRAGGED_M_S: Final = 10.0


def echo_height_m(echo: RangeSample | None, vehicle: VehicleConfig, now_s: float) -> float | None:
    """Height of the reference point by a fresh echo."""
    if echo is None or now_s - echo.time_s > FRESH_S:
        return None
    return echo.distance_m + vehicle.range_position_body_m[2]


def imu_fresh(vehicle: VehicleState | None, now_s: float) -> bool:
    return vehicle is not None and now_s - vehicle.sensed_time_s <= FRESH_S


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

    @property
    def begun(self) -> bool:
        return bool(self._row)

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

        An autopilot that no setpoint reaches, for the link is silent or we stood still, flies by itself: it
        levels and holds its height, over a pad that moves on. That makes the contact `doubted`, until rest is
        proven anew or the autopilot has landed. Then only a pad that is seen, where it was seen while we were
        heard, shows the feet down: an echo tells a hand's breadth over it from standing on it no better than
        the leg height is known.
        While the IMU is silent too (it may come by the same link), an unseen pad does not show that it left.
        """
        able = self._held.held_s("able", imu_fresh(inputs.vehicle, now_s), now_s) >= FRESH_S
        landed = inputs.autopilot.landed is LandedState.ON_GROUND
        self.doubted = not landed and (self.doubted or inputs.unheard)
        seen = sight if sight is not None and sight.unseen_s <= UNSEEN_S else None
        if not self.doubted:
            self._stood_m = self._stood_m if seen is None else min(seen.clearance_m, self._feet_m)
            return ""
        if seen is None:
            return "setpoints stopped, contact not confirmed" if able else ""
        surely_m = seen.clearance_m - SIGMA_THRESHOLD * seen.height_std_m
        # the camera sees a millimetre: from half the margin it falls with 0.4 m/s, from 3 cm with 0.8
        risen = surely_m > self._stood_m + 0.5 * self._config.contact_margin_m
        again = self._held.held_s("risen", risen, seen.seen_time_s) > 0.0  # in one sighting more
        return "setpoints stopped: the vehicle left the pad" if again else ""

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
        echo_m = echo_height_m(echo, self._vehicle, now_s)
        return seen or (echo_m is not None and echo_m <= self._feet_m)

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
    met: PadState | None,
    inputs: PlanInputs,
    vehicle: VehicleConfig,
    pad_reach_m: float,
    now_s: float,
    *,
    surface_m: float | None,
    touched: bool,
) -> str:
    """Why it does not stand upright on the pad, in words; "" when it does.

    Both attitudes count, ours and the autopilot's, as long as they are fresh. `met`: the pad as the feet met
    it, or as it was seen since. `pad_reach_m`: from the pad's middle to its corner. `surface_m`: the height
    over what several echoes agree on. `touched`: the feet have been shown down.
    """
    tilt_rad = max(map(tilt_from_quat, _attitudes(inputs, now_s)), default=None)
    if tilt_rad is None:
        return "attitude unknown"
    if tilt_rad > _UPRIGHT_RAD:
        return f"tilted by {math.degrees(tilt_rad):.0f} deg"
    if met is None or now_s - met.seen_time_s > _ATTITUDE_FRESH_S:
        deepest_m = vehicle.leg_height_m + AWAY_M
        if surface_m is not None and surface_m > deepest_m:
            return f"surface {surface_m:.1f} m below"
    if why := _elsewhere(met, vehicle.leg_height_m, pad_reach_m):
        return why
    if not touched and inputs.autopilot.landed is not LandedState.ON_GROUND:
        return "contact never confirmed"
    return ""


def unshown(met: PadState | None) -> str:
    """Why the feet are not shown to be on the pad, though its track has it there; "" when they are.

    The track's covariance is that of a pad that drives on as its models have it; one that stops as soon as
    the camera sees nothing may be elsewhere by then.
    """
    if met is not None and met.age_s <= KNOWN_S:
        return ""
    unseen = "" if met is None else f" for {met.age_s:.1f} s"
    return f"not shown to be on the pad, unseen{unseen} at contact"


def accelerates(vehicle: VehicleState | None) -> bool:
    """Whether it accelerates as what rests on something does not, or nothing tells."""
    return vehicle is None or norm(vehicle.acceleration_ned_m_s2) > _FALLS_M_S2


def lying_rad(inputs: PlanInputs, now_s: float) -> float:
    """How far it is tilted where both attitudes have it on its side, at no speed of a flight; else 0."""
    tilts_rad = [tilt_from_quat(attitude) for attitude in _attitudes(inputs, now_s)]
    if len(tilts_rad) < 2 or min(tilts_rad) <= _LIES_RAD or inputs.vehicle is None:
        return 0.0
    return 0.0 if norm(inputs.vehicle.velocity_ned_m_s) > _DRAGGED_M_S else min(tilts_rad)


def _elsewhere(met: PadState | None, leg_height_m: float, pad_reach_m: float) -> str:
    """Where the pad is, or may be, instead of at the feet; "" where its track has it there.

    By its height it is refuted, where that is known. Aside it has to be shown: the root mean square of what
    the offset may be lies within the reach, or nothing has seen the pad for too long.
    """
    if met is None:
        return "the pad was out of view for too long"
    deeper_m = met.height_m - leg_height_m
    if abs(deeper_m) - SIGMA_THRESHOLD * met.height_std_m > AWAY_M:
        return f"the pad is {abs(met.height_m):.1f} m {'below' if deeper_m > 0.0 else 'above'}"
    aside_m = math.hypot(met.lateral_m, math.sqrt(2.0) * met.lateral_std_m())
    if aside_m <= pad_reach_m:
        return ""
    unseen = f", unseen for {met.unseen_s:.1f} s" if met.unseen_s > UNSEEN_S else ""
    return f"{aside_m:.1f} m beside the pad's centre{unseen}"


def _attitudes(inputs: PlanInputs, now_s: float) -> Iterator[Quaternion]:
    ours = inputs.vehicle
    if ours is not None and ours.aligned and now_s - ours.sensed_time_s <= _ATTITUDE_FRESH_S:
        yield ours.attitude
    autopilot = inputs.autopilot
    if autopilot.attitude is not None and now_s - autopilot.attitude_time_s <= _ATTITUDE_FRESH_S:
        yield autopilot.attitude
