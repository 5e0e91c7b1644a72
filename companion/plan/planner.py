"""The planner: estimates to reference, one step each cycle (Algorithm 1).

`Planner.step(inputs, now_s)` turns the inputs into events. They act in order of severity until one changes
the state; the mission's table decides what follows. The phase steers the reference, which is returned with
the actions and notices of the cycle. Pure: no I/O, no clock. NED, m, s, rad; references are relative to the
pad as soon as the vehicle flies to the pad.
"""

import math
from dataclasses import replace
from typing import Final

from companion.base.geometry import ned_from_geodetic
from companion.base.messages import (
    Action,
    ActionKind,
    AutopilotState,
    Conditions,
    LandedState,
    PadState,
    Phase,
    PlanStep,
    Refusal,
)
from companion.config import PlanConfig, VehicleConfig
from companion.plan.events import Announcements, DetectedEvent, MissionEvent, NoticeSeverity
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import not_standing, unshown
from companion.plan.landing.height_above_ground import EchoCheck, HeightAboveGround
from companion.plan.landing.relative_state import PadTrack
from companion.plan.landing.standing_height import StandingHeight
from companion.plan.mission.failsafe_monitor import FailsafeMonitor
from companion.plan.mission.mode_monitor import in_land, in_offboard
from companion.plan.mission.readiness import estimate_problems, not_ready
from companion.plan.mission.requests import Requests
from companion.plan.mission.shared import Shared
from companion.plan.mission.states import Authority, Branch, Circumstances, Effect, State
from companion.plan.mission.table import (
    BY_THE_PAD,
    COMMITTED,
    FINAL,
    ON_PAD,
    TABLE,
    WITHDRAWS,
    StateMachine,
    impossible,
)
from companion.plan.speed.conditions import ConditionMonitor, PaceLaw, constant_pace
from companion.plan.steering import PhaseSteering
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.reference_generator import ReferenceGenerator, SpeedLaw
from companion.plan.trajectory.waypoints import check_places

PACED: Final = frozenset({Phase.APPROACH, Phase.DESCEND})  # flown at the pace of the conditions
NEAR_M: Final = 1.0  # lower, the autopilot's hold, good to 0.5 m, may drift onto what is below
GAP_S: Final = 10.0  # a link that is silent for longer has gone for good

__all__ = ["PlanInputs", "Planner"]

# while one of these is acted upon no other event of the cycle counts
_NOTHING_ELSE: Final = frozenset({MissionEvent.REFUSED, MissionEvent.TIPPED_OVER})


class Planner:
    """One mission, from connecting to standing on the pad.

    `withdraws`: what was asked for before this cycle, and waits to be sent or is under way, is withdrawn.
    """

    withdraws = False

    def __init__(
        self,
        config: PlanConfig,
        vehicle: VehicleConfig,
        horizon_steps: int,
        step_s: float,
        law: SpeedLaw,
        *,
        pace: PaceLaw = constant_pace,
        standby: str | None = None,
        pad_half_width_m: float = 0.0,
        pad_reach_m: float = 0.5,
        standing_height: StandingHeight | None = None,
    ) -> None:
        """Ready to connect; with `standby`, in STANDBY: for good if that is a reason, else for an order.

        `pad_half_width_m` is from the pad's middle to its nearest edge, `pad_reach_m` to its corner.
        `standing_height` has watched the vehicle stand before this mission, too.

        Raises:
            ConfigError: the take-off or a waypoint is too near to an obstacle.
        """
        check_places(config, vehicle.radius_m)
        self._mission = mission = config.mission
        self._vehicle, self._pad_reach_m = vehicle, pad_reach_m
        self._machine = StateMachine(config.landing.retries, may_fly=standby is None)
        self._say = Announcements()
        self._heard_s = -math.inf
        self._requests = Requests(mission.action_retry_s, mission.action_answer_s, mission.action_attempts)
        self._monitor = FailsafeMonitor(config, self._machine, self._requests)
        self._pad = PadTrack(config.search.sightings)
        self._ground, self._echoes = HeightAboveGround(vehicle.range_position_body_m), EchoCheck()
        self._standing_height = standing_height or StandingHeight(vehicle)
        avoidance = Avoidance(config, vehicle.radius_m)
        self._generator = ReferenceGenerator(config.guidance, law, horizon_steps, step_s, avoidance)
        self._pace, self._monitored = pace, ConditionMonitor()
        self._steering = PhaseSteering(
            config,
            vehicle,
            Shared(self._machine, self._requests, self._say, self._pad, self._ground, self._generator),
            pad_half_width_m=pad_half_width_m,
            standby=standby,
            standing_height=self._standing_height,
        )

    @property
    def phase(self) -> Phase:
        return self._machine.phase

    @property
    def refused(self) -> Refusal | None:
        """Why this cycle's order is not followed; None when it is, and without one."""
        return self._steering.refused

    def last_request(self, autopilot: AutopilotState) -> Action | None:
        """What is asked for when control has failed: it flies by our word, or its return is asked for.

        None: somebody else flies it, and has not been asked to give it to us.
        """
        machine = self._machine
        ours = machine.authority is Authority.OURS or (machine.in_control and self.waiting)
        if not (autopilot.offboard and ours):
            asked = ActionKind.TAKE_CONTROL in self._requests.asked_last
            return Action(ActionKind.HOLD_IF_OBEYED) if asked else None
        # to hold a position a vehicle that stands would lift off
        stands = autopilot.landed is LandedState.ON_GROUND or machine.state in COMMITTED
        return Action(ActionKind.LAND if stands else ActionKind.HOLD)

    @property
    def waiting(self) -> bool:
        """Whether something asked of the autopilot is still open."""
        return self._requests.open

    def not_ready(self, inputs: PlanInputs, now_s: float) -> list[str]:
        """What stands against a landing, wherever the vehicle is: the next one, or the one under way."""
        machine = self._machine
        ours = machine.phase is not Phase.STANDBY and (
            machine.authority is not Authority.RELEASED or self.waiting
        )
        return list(not_ready(inputs, self._mission, now_s, ours=ours))

    def estimate_problem(self, inputs: PlanInputs, now_s: float) -> str | None:
        """What stands against flying by the estimate of the vehicle, as among `not_ready`."""
        return next(estimate_problems(inputs.vehicle, self._mission, now_s), None)

    def step(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        """One cycle at now_s: at most one change of state, then the reference, actions and notices."""
        pressed, before, self.withdraws = self._steering.presses_down, self.phase, False
        lay = self._monitor.lies
        self._standing_height.update(inputs, now_s)
        inputs = self._checked(inputs, now_s)
        self._see(inputs, now_s)
        conditions = self._set_pace(inputs, now_s)
        self._react(inputs, now_s)
        # a disarming asked for on the pad is none for a vehicle that left it; one on its side did not
        left_pad = pressed and not self._steering.presses_down and not self._monitor.lies
        rose = lay and not self._monitor.lies and self._machine.state not in ON_PAD
        if rose and self._requests.asked(ActionKind.DISARM):
            # it may fly now, and what is refused is asked for again, by force
            self._requests.withdraw(ActionKind.DISARM)
            self.withdraws = True
        contact = self._steering.contact
        if left_pad or (self._machine.state in WITHDRAWS and self.phase is not before):
            self.withdraws = True
        return PlanStep(
            time_s=now_s,
            phase=self.phase,
            reference=self._steering.reference(inputs.autopilot, now_s),
            actions=self._requests.due(now_s),
            notices=self._say.drain(),
            speed_m_s=self._generator.speed_m_s,
            time_to_go_s=self._generator.time_to_go_s,
            on_ground=self._steering.presses_down or (self._monitor.lies and self._generator.active),
            unloading=0.0 if contact is None else contact.unloading,
            contact_probability=0.0 if contact is None else contact.probability,
            feet_near=self._steering.feet_near(inputs.range, now_s),
            conditions=conditions if self.phase in PACED else None,
        )

    def _checked(self, inputs: PlanInputs, now_s: float) -> PlanInputs:
        """The inputs without a rangefinder that two others contradict, which is said once."""
        echo, position = inputs.range, inputs.autopilot.global_position
        if self._machine.state in BY_THE_PAD:  # a deck that heaves moves the vehicle, and no echo
            self._echoes.pause()
        else:
            ours_m = None if inputs.vehicle is None else -inputs.vehicle.position_ned_m[2]
            theirs_m = None if position is None else position[2]
            if self._echoes.update(echo, ours_m, theirs_m, now_s) and echo is not None:
                words = f"rangefinder stuck at {echo.distance_m:.2f} m: not used"
                self._say("rangefinder", words, now_s, "warning")
        return replace(inputs, range=None) if self._echoes.stuck else inputs

    def _see(self, inputs: PlanInputs, now_s: float) -> None:
        if inputs.autopilot.connected:
            self._heard_s = now_s
        self._pad.update(inputs.pad, inputs.vehicle, now_s)
        self._ground.update(inputs.vehicle, inputs.autopilot, inputs.range, now_s)
        self._steering.steps.update(inputs.vehicle)
        self._generator.see(self._ground.home_ned_m, self._pad.motion)
        if inputs.vehicle is None:
            return
        inside = self._within_fence(inputs)
        if inside:
            self._steering.search.hear(inputs.beacon, inputs.vehicle.origin)
        carried = inputs.carried if inside else None
        self._steering.search.locator.carry(carried, inputs.vehicle.position_ned_m)
        if self._pad.motion is not None and inputs.pad is not None:
            self._steering.search.locator.remember(self._pad.motion, inputs.pad.seen_time_s, now_s)

    def _set_pace(self, inputs: PlanInputs, now_s: float) -> Conditions | None:
        """By the conditions on the way to the pad; the final descent has its own speed."""
        generator = self._generator
        over_pad = generator.active and generator.origin == "pad"
        planned_m_s = generator.at(now_s).velocity_m_s if over_pad else None
        found = self._monitored.update(self._pad.sight, inputs.vehicle, planned_m_s, now_s)
        generator.pace = 1.0
        if found is None or self.phase not in PACED:
            return None
        generator.pace = self._pace(found)
        return replace(found, pace=generator.pace)

    def _within_fence(self, inputs: PlanInputs) -> bool:
        """Whether the beacon lies inside the fence; one outside is announced once and ignored.

        Without a home position the fence cannot be checked, so the beacon is ignored until there is one.
        """
        beacon, home = inputs.beacon, inputs.autopilot.home
        if beacon is None or home is None:
            return False
        north, east, _ = ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, home)
        distance_m, fence_m = math.hypot(north, east), self._mission.fence_m
        if distance_m > fence_m:
            words = f"pad beacon ignored: {distance_m:.0f} m from home, fence {fence_m:.0f} m"
            self._say.once("beacon", "fence", words, beacon.time_s)
        return distance_m <= fence_m

    def _react(self, inputs: PlanInputs, now_s: float) -> None:
        """Failsafes and refusals first, else the state steers and detects; then as the table says."""
        before = self._machine.state
        for event, reason in self._failsafes(inputs, now_s):
            self._take(event, reason, inputs, now_s)
            if self._machine.state is not before or event in _NOTHING_ELSE:
                break
        else:
            detected = self._steering.steer(inputs, now_s)
            if detected is not None:
                self._take(*detected, inputs, now_s)
        if self.phase is not before.phase and self._machine.state not in FINAL:
            # the new phase steers at once; what it detects waits for the next cycle
            self._steering.steer(inputs, now_s)

    def _failsafes(self, inputs: PlanInputs, now_s: float) -> tuple[DetectedEvent, ...]:
        if taken := self._monitor.after_end(inputs.autopilot):
            return taken
        spent = self._requests.hear(inputs.results, now_s)
        for words in spent:
            self._say("refused", words, now_s, "error")
        for words in self._requests.news():
            self._say("refused", words, now_s, "warning")
        refused = ((MissionEvent.REFUSED, spent[0]),) if spent else ()
        return (*self._monitor.detect(inputs, now_s, self._ground.over_home_m), *refused)

    def _circumstances(self, inputs: PlanInputs, now_s: float) -> Circumstances:
        landed, touchdown, sight = inputs.autopilot.landed, self._steering.touchdown, self._pad.sight
        heights_m = (self._ground.clearance_m, None if sight is None else sight.height_m)
        return Circumstances(
            on_surface=self._machine.state in ON_PAD or landed is LandedState.ON_GROUND,
            airborne=landed is LandedState.IN_AIR,
            disarm_asked=self._requests.asked(ActionKind.DISARM),
            heard=now_s - self._heard_s <= GAP_S,
            # a request that is asked afresh is not granted yet, while the autopilot lands all the same
            land_granted=self._requests.granted(ActionKind.LAND) or in_land(inputs.autopilot),
            may_finish=self._mission.battery.finish_descent,
            in_offboard=in_offboard(inputs.autopilot),
            ends_inside=self._monitor.bounds.inside_after(
                touchdown.way_down_s(),
                self._pad.motion,
                0.0 if inputs.pad is None else inputs.pad.turn_rate_rad_s,
                inputs.vehicle,
                inputs.autopilot,
            ),
            feet_down=touchdown.short_echoes.standing(now_s),
            standing=not self._not_standing(inputs, now_s),
            near=any(height_m is not None and height_m < NEAR_M for height_m in heights_m),
            may_obey=self._may_obey(inputs.autopilot),
        )

    def _may_obey(self, autopilot: AutopilotState) -> bool:
        """Whether the autopilot may have obeyed a request for control, whatever it has answered."""
        control, requests = ActionKind.TAKE_CONTROL, self._requests
        return requests.asked(control) and (control in requests.asked_last or autopilot.offboard)

    @property
    def _met(self) -> PadState | None:
        """The pad as the feet met it, or as it was seen since."""
        return self._steering.touchdown.met

    def _not_standing(self, inputs: PlanInputs, now_s: float) -> str:
        """Why a vehicle that was landing does not stand upright on the pad; "" when it does."""
        touchdown = self._steering.touchdown
        touched = self._machine.state in ON_PAD or touchdown.short_echoes.standing(now_s)
        return not_standing(
            self._met,
            inputs,
            self._vehicle,
            self._pad_reach_m,
            now_s,
            surface_m=self._ground.surface_m,
            touched=touched,
        )

    def _take(self, event: MissionEvent, reason: str, inputs: PlanInputs, now_s: float) -> None:
        """Take the table's branch for an event: change the state, send its requests."""
        machine, state, had = self._machine, self._machine.state, self._machine.authority
        if (
            event is MissionEvent.DISARMED
            and state in COMMITTED
            and (fell := self._not_standing(inputs, now_s))
        ):
            reason = f"{reason}, no landing: {fell}"
        elif event is MissionEvent.DISARMED and self._monitor.lies:
            reason = f"{reason}, tipped over"
        elif event is MissionEvent.DISARMED and state in COMMITTED and (why := unshown(self._met)):
            reason = f"{reason}, {why}"
        branch = machine.follows(event, self._circumstances(inputs, now_s)) if TABLE[state, event] else None
        if branch is None:
            if event is MissionEvent.COMMIT:
                words = f"waiting: the pad leaves the fence ({self._mission.fence_m:.0f} m) before contact"
                self._say.once(event, "fence", words, now_s)
            return
        if impossible(state, event):
            self._say("unexpected", f"{event.value} in {state.value}: holding", now_s, "error")
        machine.take(branch)
        if machine.state is not state:
            self._tell(state, event, reason, now_s)
            if machine.phase is not state.phase:
                self._requests.forget()
                self._monitor.phase_begins(now_s)
            self._steering.enter(branch, state, had, inputs, now_s)
        self._carry_out(branch, reason, inputs, now_s)
        if event is MissionEvent.TIPPED_OVER and machine.state is state:
            self._say.once(event, "tipped_over", f"tipped over: {reason}: motors off requested", now_s)
        for action in branch.actions:
            self._requests.ask(self._steering.departure.with_numbers(action, inputs.autopilot), now_s)

    def _carry_out(self, branch: Branch, reason: str, inputs: PlanInputs, now_s: float) -> None:
        if Effect.COUNT_AFRESH in branch.effects:
            self._monitor.phase_begins(now_s)
        if Effect.ASK_AFRESH in branch.effects:
            self._requests.forget()
            self._monitor.phase_begins(now_s)
        if Effect.ASK_NOTHING in branch.effects:
            self.withdraws = True
            self._requests.forget()
            self._generator.stop()
            self._say("pilot", reason, now_s, "warning")
        kinds = {action.kind for action in branch.actions}
        if Effect.ASK_AFRESH in branch.effects:
            on_pad = ActionKind.DISARM in kinds
            words = "landed, motors still on: LAND and disarm" if on_pad else "no contact yet: LAND"
            self._say("motors_on", f"{words} requested again", now_s, "error")
        if ActionKind.LEAVE_OFFBOARD in kinds:
            self._say("leave_offboard", "mode changed to Hold: PX4 does not arm in OFFBOARD", now_s)
        if ActionKind.HOLD_IF_OBEYED in kinds:
            self._say("hold_if_obeyed", "if the vehicle obeys setpoints: hold requested", now_s, "warning")
        if Effect.SEARCH_FROM_HERE in branch.effects:
            self._steering.enter_search(State.SEARCH, inputs, now_s)
        if Effect.NO_NEW_TRY in branch.effects:
            self._say.once(Effect.NO_NEW_TRY, "battery", f"battery low: {reason}, no new try", now_s)

    def _tell(self, before: State, event: MissionEvent, reason: str, now_s: float) -> None:
        """Announce a change of phase, and those within the touchdown that matter."""
        if self.phase is not before.phase:
            severity: NoticeSeverity = "warning" if self.phase in {Phase.ABORT, Phase.HOLD} else "info"
            words = f"{self.phase.value}: {event.value}".replace("_", " ") + f": {reason}"
            self._say("phase", words, now_s, severity)
        elif event is MissionEvent.COMMIT:
            self._say("commit", reason, now_s)
        elif event is MissionEvent.BREAK_OFF:
            self._say("break_off", f"{reason}: waiting again over the pad", now_s, "warning")
        elif event is MissionEvent.CONTACT:
            where = "on the pad" if before is State.SINK and not unshown(self._met) else "down"
            self._say("contact", f"{where}: {reason}", now_s)
        elif self._machine.state is State.SET_DOWN:
            self._say("set_down", f"{reason}: landing in LAND mode", now_s, "warning")
