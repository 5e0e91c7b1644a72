"""How each state flies: what happens to the reference on entering the state and in each of its cycles.

The mission's table chooses the state; here the state steers the reference and detects events. In APPROACH,
DESCEND and the touchdown the reference is relative to the pad, in NED axes; in SET_DOWN, in the other states,
and in APPROACH and DESCEND while the pad is unseen, it is in the EKF's NED. m, s, rad.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Final

from companion.base.autopilots import PROFILES
from companion.base.messages import (
    Action,
    ActionKind,
    AutopilotState,
    PadState,
    Phase,
    RangeSample,
    Reference,
    Refusal,
    VehicleState,
)
from companion.base.motion import Motion
from companion.base.second_sources import SIGMA_THRESHOLD
from companion.config import PlanConfig, VehicleConfig
from companion.plan.debounce import Debounce
from companion.plan.estimate_steps import EstimateSteps
from companion.plan.events import NOTICE_THRESHOLD_M, DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.approach_descent import ApproachDescent
from companion.plan.landing.contact import AWAY_M, KNOWN_S, WITHIN_HAND_M, echo_height_m
from companion.plan.landing.contact_filter import ContactFilter
from companion.plan.landing.relative_state import misaligned_heading, vehicle_motion
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.landing.success import SuccessEstimate
from companion.plan.landing.touchdown import TouchdownSequence
from companion.plan.mission.departure import REMIND_S, Departure
from companion.plan.mission.hold import Hold
from companion.plan.mission.readiness import ORDER_EVENTS, refusal
from companion.plan.mission.shared import Shared
from companion.plan.mission.states import Authority, Branch, Effect, State
from companion.plan.mission.table import (
    BY_THE_PAD,
    COMMITTED,
    GOING_DOWN,
    ON_PAD,
    OVER_PAD_OR_DESCENDING,
)
from companion.plan.search.search import Search
from companion.plan.trajectory.waypoints import Waypoints

_LAST_TRY_SLACK: Final = 1.6  # wider limits aside in the last try: after it control is returned
_UNCONTRADICTED_S: Final = 2.0  # no echoes may contradict a pad for so long before it is flown to again
_TELL_S: Final = 5.0  # of a search
_STREAMING: Final = (MissionEvent.STREAMING, "setpoints are ready")


def enter_touchdown(
    touchdown: TouchdownSequence,
    state: State,
    sight: PadState | None,
    vehicle: VehicleState | None,
    now_s: float,
) -> None:
    """Begin with one of the states within a try."""
    match state:
        case State.SINK:
            touchdown.commit(now_s)
        case State.RISE:
            touchdown.break_off(now_s)
        case State.SET_DOWN:
            touchdown.begin_set_down(vehicle, now_s)
        case State.STAND:
            touchdown.begin_stand(sight, now_s)


def touch_down(
    touchdown: TouchdownSequence, state: State, sight: PadState | None, inputs: PlanInputs, now_s: float
) -> DetectedEvent | None:
    match state:
        case State.WAIT:
            return touchdown.wait(sight, now_s)
        case State.RISE:
            return touchdown.rise(sight, now_s)
        case State.SINK:
            return touchdown.sink(sight, inputs, now_s)
        case State.SET_DOWN:
            return touchdown.set_down(sight, inputs, now_s)
    return touchdown.stand(sight, inputs, now_s, in_land=state is State.AUTO_LAND)


class PhaseSteering:
    """Steers by the machine's state; shares the reference and the knowledge of the pad with the planner."""

    def __init__(
        self,
        config: PlanConfig,
        vehicle: VehicleConfig,
        shared: Shared,
        *,
        pad_half_width_m: float,
        standby: str | None,
        standing_height: StandingHeight,
    ) -> None:
        self.refused: Refusal | None = None  # this cycle's order
        self._config, self._vehicle, self._standby = config, vehicle, standby
        self._pad_half_width_m, self._success = pad_half_width_m, SuccessEstimate(config.touchdown)
        self._machine, self._requests, self._say = shared.machine, shared.requests, shared.say
        self._pad, self._ground, self._generator = shared.pad, shared.ground, shared.generator
        self.steps, generator = EstimateSteps(), shared.generator
        self._waypoints = Waypoints(config.mission, generator)
        self.departure = Departure(config.mission, shared)
        self.search = Search(config.search, generator, config.mission.pad_speed_m_s)
        self._new_approach = partial(ApproachDescent, config.landing, vehicle, generator, shared.say)
        self._approach = self._new_approach(0.0, 0.0)
        self._new_try = partial(
            TouchdownSequence,
            config.touchdown,
            config.landing,
            generator,
            standing_height,
            pad_half_width_m,
            self._success,
        )
        self.touchdown = self._new_try(0.0)
        self._hold = Hold(config, vehicle.leg_height_m, shared)
        self._contradicted_s, self._held = -math.inf, Debounce()
        self._steered_by: dict[Phase, Callable[[PlanInputs, float], DetectedEvent | None]] = {
            Phase.STANDBY: self._stand_by,
            Phase.CONNECT: self.departure.step,
            Phase.ARM: self.departure.step,
            Phase.TAKE_OFF: self.departure.step,
            Phase.WAYPOINT: self.departure.step,
            Phase.ROUTE: self._fly_route,
            Phase.SEARCH: self._look_for_pad,
            Phase.APPROACH: self._come_in,
            Phase.DESCEND: self._come_in,
            Phase.TOUCHDOWN: self._touch_down,
            Phase.HOLD: self._stay,
            Phase.ABORT: self._stay,
            Phase.LANDED: self._end,
        }

    @property
    def presses_down(self) -> bool:
        """Whether the vehicle is to be kept on the pad without thrust."""
        return self._machine.state in ON_PAD and not self.touchdown.unconfirmed(self._pad.sight)

    @property
    def contact(self) -> ContactFilter | None:
        """Whether the feet stand, on the way down."""
        return self.touchdown.contact if self._machine.state in GOING_DOWN else None

    def feet_near(self, echo: RangeSample | None, now_s: float) -> bool:
        """Whether the feet may stand on something; legs may be longer than told.

        They may where the thrust is taken away for them. Else sight and echo tell, and in the touchdown the
        height that is predicted, for as long as the contact goes by it; then it is unknown, and may be none.
        """
        state, contact = self._machine.state, self.contact
        if state not in BY_THE_PAD or (contact is not None and contact.unloading > 0.0):
            return state in BY_THE_PAD
        sight, near_m = self._pad.sight, self._vehicle.leg_height_m + WITHIN_HAND_M
        seen = sight is not None and sight.age_s <= KNOWN_S
        if sight is not None and seen:
            below = sight.height_m <= near_m and sight.lateral_m <= self._pad_half_width_m
            if below or sight.height_m > near_m + AWAY_M:
                return below  # whatever the echo says of a pad that is away: it is stuck
        echo_m = echo_height_m(echo, self._vehicle, now_s)
        if echo_m is not None or seen or state.phase is not Phase.TOUCHDOWN:
            return echo_m is not None and echo_m <= near_m
        if sight is None or sight.age_s > self._config.touchdown.blind_s:
            return True
        return sight.height_m - SIGMA_THRESHOLD * sight.height_std_m <= near_m

    def steer(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Steer the reference for this cycle; returns what is detected."""
        self.refused = None
        self._success.note(self._pad.sight, inputs.vehicle, self._generator, now_s)
        event = self._steered_by[self._machine.phase](inputs, now_s)
        self._generator.avoidance.tell(self._say, now_s)
        return event

    def reference(self, autopilot: AutopilotState, now_s: float) -> Reference | None:
        """Where the vehicle should be, with the bounds over the pad that the state asks for.

        None: no setpoint is to leave, as before the grant to an autopilot that needs none for it.
        """
        self._turn(now_s)
        kind = autopilot.autopilot_kind
        wanted = self._machine.in_control or (kind is not None and PROFILES[kind].needs_setpoints)
        if not wanted or not self._generator.active:
            return None
        by_pad, state = self._generator.origin == "pad", self._machine.state
        above = by_pad and state in {State.APPROACH, State.DESCEND}
        descends = by_pad and state in OVER_PAD_OR_DESCENDING
        level = state in COMMITTED or self.touchdown.leaving(now_s)
        return self._generator.reference(
            now_s,
            minimum_height_m=self._approach.minimum_height_m(now_s) if above else None,
            cone=self._approach.cone if descends else None,
            level_off=self.touchdown.levelling.window() if level else None,
        )

    # ------------------------------------------------------------ entering a state

    def enter(
        self, branch: Branch, previous: State, had: Authority, inputs: PlanInputs, now_s: float
    ) -> None:
        """Start the state that a branch led to; `had` is the authority before it."""
        state = self._machine.state
        if Effect.ASK_PAD_POSITION in branch.effects:
            self.search.request_now()
        if Effect.STOP_SETPOINTS in branch.effects:
            self._generator.stop()
        elif state is State.TAKE_OFF:
            self._ground.stands_here(inputs.vehicle)
        elif state is State.ROUTE:
            self._enter_route(previous, inputs, now_s)
        elif state is State.SEARCH:
            self.enter_search(previous, inputs, now_s)
        elif state is State.APPROACH:
            self._enter_approach(previous, now_s)
        elif state is State.WAIT and previous is State.DESCEND:
            self.touchdown = self._new_try(now_s)
        elif state.phase is Phase.TOUCHDOWN:
            self._tell_heading(inputs.vehicle, now_s)
            enter_touchdown(self.touchdown, state, self._pad.sight, inputs.vehicle, now_s)
        elif state.phase in {Phase.HOLD, Phase.ABORT}:
            self._enter_hold(previous, had, inputs, now_s)

    def _tell_heading(self, vehicle: VehicleState | None, now_s: float) -> None:
        """Of a final descent that begins; asked for in vain, as before a fence, it may be in every cycle."""
        if self._machine.state is State.SINK and self._config.mission.align_heading:
            words = misaligned_heading(self._pad.sight, vehicle)
            if words:
                self._say("heading", words, now_s, "warning")

    def _enter_route(self, previous: State, inputs: PlanInputs, now_s: float) -> None:
        if inputs.vehicle is None:
            return  # ESTIMATE_LOST ends this in the next cycle
        self._held.end("streams")
        self._hold.stand_still(inputs.vehicle, now_s)
        self._waypoints.begin(with_first=previous is State.TAKE_OFF)

    def enter_search(self, previous: State, inputs: PlanInputs, now_s: float) -> None:
        if inputs.vehicle is None:
            return  # ESTIMATE_LOST ends this in the next cycle
        self._hold.stand_still(inputs.vehicle, now_s)
        missing_m = 0.0 if previous in {State.WAYPOINT, State.ROUTE} else self._missing_m()
        climb_m = self.search.begin(missing_m, self._lowest_down_m(), now_s)
        if climb_m > NOTICE_THRESHOLD_M and previous is not State.STANDBY:
            self._say("climb", f"climbing {climb_m:.1f} m to look for the pad", now_s, "warning")

    def _missing_m(self) -> float:
        """How far (m) below the search height; the pad's estimate may be wrong."""
        clearance_m = self._ground.clearance_m
        if clearance_m is None:
            clearance_m = math.inf if self._pad.sight is None else self._pad.sight.height_m
        return self._config.mission.take_off_height_m - clearance_m

    def _lowest_down_m(self) -> float:
        """Down (m, EKF's NED) of the floor while no pad is in view; inf when no height is known."""
        return self._ground.floor_down_m(
            min(self._config.search.floor_m, self._config.mission.take_off_height_m)
        )

    def _enter_approach(self, previous: State, now_s: float) -> None:
        if self._pad.motion is not None:
            self._generator.change_frame("pad", self._pad.motion, now_s)
        again = previous in BY_THE_PAD
        self._approach = self._new_approach(-self._generator.at(now_s).position_m[2], now_s, again=again)
        if again:
            height_m = self._approach.goal_m - self._vehicle.leg_height_m
            self._say("climb", f"back to {height_m:.1f} m over the pad to try again", now_s, "warning")

    def _enter_hold(self, previous: State, had: Authority, inputs: PlanInputs, now_s: float) -> None:
        """Come to rest by our own setpoints, where they fly the vehicle."""
        self._hold.end()
        flown = had is Authority.OURS or (had is Authority.RELEASED and self._generator.active)
        if not flown or not inputs.autopilot.armed or inputs.vehicle is None:
            self._generator.stop()
            return
        low = self._machine.phase is Phase.HOLD and previous in BY_THE_PAD
        if not (low and self.touchdown.leaving(now_s)):  # it leaves the pad first, level, and begins then
            self._hold.begin(inputs.vehicle, now_s, over_pad=low)

    # ------------------------------------------------------------ the phases

    def _stand_by(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Wait for an order; standby with a reason follows none, and says so again and again."""
        if self._standby:
            self._say.again("standby", f"standby: {self._standby}", now_s, REMIND_S)
        if inputs.order is None:
            return None
        locked = Refusal(self._standby, lasting=True) if self._standby else None
        self.refused = locked or refusal(inputs.order, inputs, self._config, now_s)
        if self.refused is not None:
            return None
        return ORDER_EVENTS[inputs.order.kind], f"by {inputs.order.source}"

    def _fly_route(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        """Through the waypoints that are ours; the pad in view ends it."""
        home_ned_m = self._generator.avoidance.home_ned_m
        if inputs.vehicle is None or home_ned_m is None or not self._generator.active:
            return None
        if self._pad.steady(now_s):
            return MissionEvent.PAD_SEEN, "between the waypoints"
        actual = vehicle_motion(inputs.vehicle)
        self._keep_near(actual, now_s)
        if not self._machine.in_control:
            # PX4 changes to OFFBOARD only while setpoints stream; the headings are compared meanwhile
            streamed_s = self._held.held_s("streams", True, now_s)
            return _STREAMING if streamed_s >= self._config.search.stream_s else None
        return self._waypoints.step(actual, home_ned_m, now_s)

    def _look_for_pad(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        if inputs.vehicle is None or not self._generator.active:
            return None
        actual = vehicle_motion(inputs.vehicle)
        self._keep_near(actual, now_s)
        if self.steps.step_m is not None:
            self.search.go_along(self.steps.step_m)
        climb_m = self.search.keep_above(self._lowest_down_m())
        if climb_m > 0.0:
            self._say("climb", f"climbing {climb_m:.1f} m: ground near", now_s, "warning")
        if self._pad.steady(now_s):
            self._ground_near(now_s)
        # echoes that disagree for a moment do not end a contradiction
        believed = now_s - self._contradicted_s >= _UNCONTRADICTED_S
        step = self.search.step(actual, self._machine.in_control, self._pad, now_s, believed=believed)
        if step.streaming:
            return _STREAMING
        if step.request_pad:
            self._requests.tell(Action(ActionKind.REQUEST_PAD_POSITION))
            doing = "searching" if step.flying else "holding"
            words = f"pad not in view: {doing} ({self.search.locator.source(now_s)}), position requested"
            self._say.again("pad_lost", words, now_s, _TELL_S, "warning")
        if step.seen and (sight := self._pad.sight) is not None:
            words = f"lateral offset {sight.lateral_m:.1f} m, {sight.height_m:.1f} m below"
            return MissionEvent.PAD_SEEN, words
        return None

    def _come_in(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        wrong = self._ground_near(now_s)
        if wrong is not None:
            return wrong
        if self.touchdown.leaving(now_s):
            self.touchdown.leave(inputs, self._pad.sight, now_s)
            return None
        self._keep_near_pad(inputs, now_s)
        likely, descends = self.search.locator.likely(now_s), self._machine.state is State.DESCEND
        event = self._approach.step(self._pad, likely, self._lowest_down_m(), now_s, descends=descends)
        if self._pad.sight is not None and self.search.ask_again(self._pad.sight.age_s, now_s):
            self._requests.tell(Action(ActionKind.REQUEST_PAD_POSITION))
        return event

    def _ground_near(self, now_s: float) -> DetectedEvent | None:
        """Whether the echoes contradict the pad's estimated height."""
        sight = self._pad.sight
        surface_m = None if sight is None else self._ground.above(sight.height_m)
        if sight is None or surface_m is None:
            return None
        self._contradicted_s = now_s
        self._pad.distrust()
        self.search.locator.distrust()
        return (
            MissionEvent.GROUND_NEAR,
            f"range {surface_m:.1f} m, pad estimated {sight.height_m:.1f} m below",
        )

    def _touch_down(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        state = self._machine.state
        if state not in COMMITTED:
            wrong = self._ground_near(now_s)
            if wrong is not None:
                return wrong
            self._keep_near_pad(inputs, now_s)
        # a battery that gets low makes a try the last
        self.touchdown.slack = _LAST_TRY_SLACK if self._machine.last_try else 1.0
        return touch_down(self.touchdown, state, self._pad.sight, inputs, now_s)

    def _stay(self, inputs: PlanInputs, now_s: float) -> DetectedEvent | None:
        if self.touchdown.leaving(now_s):
            self.touchdown.leave(inputs, self._pad.sight, now_s)
            return None
        at_rest = self._hold.step(inputs.vehicle, self.steps.step_m, now_s)
        self._end(inputs, now_s)
        # what has been released already, or waits for the link, ends otherwise
        ours = self._machine.state is State.HOLD and self._machine.authority is Authority.OURS
        return at_rest if ours else None

    def _end(self, inputs: PlanInputs, _now_s: float) -> DetectedEvent | None:
        """Hold by our own setpoints until the autopilot has control."""
        returned = self._requests.granted(ActionKind.HOLD) or self._requests.granted(ActionKind.LAND)
        if self._machine.authority is Authority.RELEASED and (returned or not inputs.autopilot.offboard):
            self._generator.stop()
        return None

    def _keep_near_pad(self, inputs: PlanInputs, now_s: float) -> None:
        """Unseen, the reference is in the EKF's NED, and what moves there is the vehicle alone."""
        sight = self._pad.sight
        if self._generator.origin == "local" and inputs.vehicle is not None:
            self._keep_near(vehicle_motion(inputs.vehicle), now_s)
        elif sight is not None and sight.age_s <= self._config.landing.pause_unseen_s:
            self._keep_near(sight.vehicle_from_pad, now_s)

    def _keep_near(self, actual: Motion, now_s: float) -> None:
        distance_m = self._generator.keep_near(actual, now_s)
        if distance_m > 0.0 and self._machine.in_control:
            self._say("strayed", f"reference error {distance_m:.1f} m: replanned", now_s, "warning")

    def _turn(self, now_s: float) -> None:
        """Slew the heading to the pad's over the pad, if the settings say so."""
        over_pad = self._machine.state in BY_THE_PAD and self._config.mission.align_heading
        sight = self._pad.sight if over_pad else None
        if sight is None:
            self._generator.turn(None, now_s)
        else:
            self._generator.turn(sight.heading_rad, now_s, sight.heading_rate_rad_s)
