"""The planner: from what is known now to where the vehicle should be next, one step a cycle (Algorithm 1).

`Planner.step(inputs, now_s)` turns the inputs into at most one event, looks up in the mission's table what
follows, lets the phase steer the reference, and returns it with the actions and notices of the cycle. Pure:
no I/O, no clock. NED, m, s, rad; references are relative to the pad as soon as the pad is what is flown to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from companion.config import PlanConfig, VehicleConfig
from companion.geometry import yaw_from_quat
from companion.messages import (
    Action,
    ActionKind,
    ActionResult,
    AutopilotState,
    LandedState,
    Notice,
    PadBeacon,
    PadState,
    Phase,
    PlanStep,
    RangeSample,
    VehicleState,
)
from companion.plan.departure import Departure
from companion.plan.guidance import Guide, SpeedLaw
from companion.plan.landing import Landing
from companion.plan.min_jerk import Motion
from companion.plan.mission import BY_THE_PAD, FINAL, Event, transition
from companion.plan.requests import Requests
from companion.plan.search import Search
from companion.plan.sight import Sight, Sightings, look, pad_motion, vehicle_motion
from companion.plan.touchdown import Finding, Touchdown
from companion.plan.watch import Watch

_LAST_TRY_SLACK: Final = 1.6
_HANDED_BACK_BY: Final = frozenset({ActionKind.HOLD, ActionKind.LAND})


@dataclass(frozen=True, slots=True)
class PlanInputs:
    """The newest of everything the planner goes by; `results` holds each answer once."""

    vehicle: VehicleState | None
    pad: PadState | None
    autopilot: AutopilotState
    beacon: PadBeacon | None = None
    range: RangeSample | None = None
    results: tuple[ActionResult, ...] = ()
    stop_requested: bool = False


class Planner:
    """One mission, from connecting to standing on the pad."""

    def __init__(
        self, config: PlanConfig, vehicle: VehicleConfig, horizon_steps: int, step_s: float, fuzzy: SpeedLaw
    ) -> None:
        mission = config.mission
        self._config, self._vehicle = config, vehicle
        self.phase = Phase.CONNECT
        self._since_s: float | None = None
        self._requests = Requests(mission.action_retry_s, mission.action_answer_s, mission.action_attempts)
        self._watch = Watch(mission)
        self._guide = Guide(config.guidance, fuzzy, horizon_steps, step_s)
        self._departure = Departure(mission)
        self._search = Search(config.search)
        self._landing = Landing(config.landing, vehicle, self._guide)
        self._touchdown = Touchdown(config.touchdown, vehicle, config.landing.wait_height_m, self._guide)
        self._sightings = Sightings(config.search.sightings, config.search.sightings_window_s)
        self._pad: Motion | None = None
        self._sight: Sight | None = None
        self._tries = 0
        self._control_s: float | None = None
        self._next_request_s = 0.0
        self._notices: list[Notice] = []
        self._outbox: list[Action] = []

    # ------------------------------------------------------------ one cycle

    def step(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        """One cycle at now_s: at most one event, then the reference, actions and notices."""
        self._notices, self._outbox = [], []
        if self._since_s is None:
            self._since_s = now_s
        self._see(inputs, now_s)
        finding = self._find(inputs, now_s)
        if finding is not None and self._happen(*finding, inputs, now_s):
            self._fly(inputs, now_s)  # the new phase steers at once; what it finds waits for the next cycle
        self._turn(now_s)
        self._outbox += self._requests.due(now_s)
        return self._result(inputs, now_s)

    def _see(self, inputs: PlanInputs, now_s: float) -> None:
        vehicle = inputs.vehicle
        self._sight = look(inputs.pad, now_s)
        self._sightings.note(inputs.pad)
        if vehicle is not None:
            self._search.hear(inputs.beacon, vehicle.origin)
        if vehicle is not None and self._sight is not None and inputs.pad is not None:
            self._pad = pad_motion(vehicle, self._sight, now_s)
            self._search.remember(self._pad, inputs.pad.seen_time_s, now_s)

    def _find(self, inputs: PlanInputs, now_s: float) -> Finding:
        """The gravest thing that happened, else what the phase finds."""
        spent = self._requests.hear(inputs.results, now_s)
        taken_over = self._watch.note(
            inputs.autopilot, self._requests.granted(ActionKind.TAKE_CONTROL) and self.phase is Phase.SEARCH
        )
        grave = self._watch.event(
            self.phase,
            self._since_s or 0.0,
            inputs.autopilot,
            inputs.vehicle,
            taken_over,
            self._on_pad,
            now_s,
        )
        if grave is not None and grave[0] in {Event.PILOT_TOOK_OVER, Event.DISARMED}:
            return grave
        if inputs.stop_requested and self.phase not in FINAL:
            return Event.STOP, "asked for"
        if grave is not None:
            return grave
        return (Event.REFUSED, spent[0]) if spent else self._fly(inputs, now_s)

    @property
    def _on_pad(self) -> bool:
        return self.phase is Phase.TOUCHDOWN and self._touchdown.on_pad

    # ------------------------------------------------------------ what follows an event

    def _happen(self, event: Event, words: str, inputs: PlanInputs, now_s: float) -> bool:
        """Go where the table says; returns whether that is another phase, still to be flown."""
        event = self._count_tries(event)
        step = transition(self.phase, event)
        if not step.legal:
            self._say("unexpected", f"{event.value} in {self.phase.value}: holding", now_s, "error")
        previous, self.phase = self.phase, step.phase
        if self.phase is previous:
            if event is Event.CONTACT:
                self._say("contact", f"on the pad ({words})", now_s)
            return False
        self._since_s = now_s
        severity: Literal["info", "warning"] = (
            "warning" if self.phase in {Phase.ABORT, Phase.HOLD} else "info"
        )
        text = f"{self.phase.value}: {event.value.replace('_', ' ')}, {words}"
        self._say("phase", text.replace("_", " "), now_s, severity)
        on_pad = previous is Phase.TOUCHDOWN and self._touchdown.on_pad
        self._requests.forget()
        self._enter(previous, inputs, now_s)
        for kind in step.actions:
            self._ask(kind, inputs, on_pad, now_s)
        return self.phase not in FINAL

    def _count_tries(self, event: Event) -> Event:
        failed = (self.phase is Phase.TOUCHDOWN and event in {Event.MISALIGNED, Event.PAD_LOST}) or (
            self.phase is Phase.DESCEND and event is Event.TIMEOUT
        )
        if not failed:
            return event
        self._tries += 1
        return Event.OUT_OF_TRIES if self._tries > self._config.landing.retries else event

    def _ask(self, kind: ActionKind, inputs: PlanInputs, on_pad: bool, now_s: float) -> None:
        if kind is ActionKind.REQUEST_PAD_POSITION:
            self._request_pad(now_s)
            return
        if kind is ActionKind.HOLD:
            if self._watch.released:
                return  # handed back already; a pilot may have it by now
            if on_pad or inputs.autopilot.landed is LandedState.ON_GROUND:
                kind = ActionKind.LAND  # holding a position would lift off again
        if kind in _HANDED_BACK_BY:
            self._watch.let_go()
        self._requests.ask(self._departure.action(kind, inputs.autopilot), now_s)

    def _enter(self, previous: Phase, inputs: PlanInputs, now_s: float) -> None:
        if self.phase is Phase.SEARCH:
            self._enter_search(previous, inputs, now_s)
        elif self.phase is Phase.APPROACH:
            self._enter_approach(previous, now_s)
        elif self.phase is Phase.TOUCHDOWN:
            last = self._tries >= self._config.landing.retries
            self._touchdown.begin(now_s, _LAST_TRY_SLACK if last else 1.0)
        elif self.phase is Phase.TAKE_OFF:
            self._departure.lift_off(inputs.vehicle)
        elif self.phase in {Phase.HOLD, Phase.ABORT}:
            self._stand_still(inputs, now_s)
        elif self.phase is Phase.LANDED:
            self._guide.stop()

    def _enter_search(self, previous: Phase, inputs: PlanInputs, now_s: float) -> None:
        if inputs.vehicle is None:
            return  # the estimate's loss ends this in the next cycle
        if not self._guide.active:
            self._guide.heading_rad = yaw_from_quat(inputs.vehicle.attitude)
        self._stand_still(inputs, now_s)
        height_m = self._sight.height_m if self._sight is not None and previous in BY_THE_PAD else None
        wanted_m = 0.0 if height_m is None else self._config.mission.take_off_height_m - height_m
        climb_m = self._search.begin(self._guide.at(now_s).position_m, wanted_m, now_s)
        if climb_m > 0.2:
            self._say("climb", f"climbing {climb_m:.1f} m to look for the pad", now_s, "warning")

    def _enter_approach(self, previous: Phase, now_s: float) -> None:
        again = previous in {Phase.DESCEND, Phase.TOUCHDOWN}
        assert self._sight is not None or self._guide.origin == "pad"
        if self._guide.origin == "local" and self._pad is not None:
            self._guide.change_frame("pad", self._pad, now_s)
        self._landing.begin(-self._guide.at(now_s).position_m[2], again)
        if again:
            height_m = self._landing.goal_m - self._vehicle.leg_height_m
            self._say("climb", f"back to {height_m:.1f} m over the pad to try again", now_s, "warning")

    def _stand_still(self, inputs: PlanInputs, now_s: float) -> None:
        """Come to rest where the vehicle is, in its own frame; without an estimate there is no reference."""
        wanted = self.phase is Phase.SEARCH or self._watch.in_control
        if inputs.vehicle is None or not wanted or not inputs.autopilot.armed:
            self._guide.stop()
        elif not self._guide.active or (self._guide.origin == "pad" and self._pad is None):
            self._guide.start("local", vehicle_motion(inputs.vehicle, now_s), now_s)
        else:
            if self._pad is not None:
                self._guide.change_frame("local", self._pad, now_s)
            self._guide.rest(self._guide.at(now_s), now_s)

    # ------------------------------------------------------------ the phases

    def _fly(self, inputs: PlanInputs, now_s: float) -> Finding:
        """Let the phase steer the reference and see what it finds."""
        if self.phase in {Phase.CONNECT, Phase.ARM, Phase.TAKE_OFF, Phase.WAYPOINT}:
            return self._depart(inputs, now_s)
        if self.phase is Phase.SEARCH:
            return self._look_for_pad(inputs, now_s)
        if self.phase is Phase.HOLD:
            return self._hold(inputs)
        if self.phase is Phase.ABORT:
            return self._end(inputs)
        if self.phase is Phase.TOUCHDOWN:
            return self._touch_down(inputs, now_s)
        if self.phase in BY_THE_PAD:
            self._keep_near(now_s)
            fly = self._landing.approach if self.phase is Phase.APPROACH else self._landing.descend
            return fly(self._sight, now_s)
        return None

    def _depart(self, inputs: PlanInputs, now_s: float) -> Finding:
        if self.phase is Phase.WAYPOINT and self._sightings.steady(now_s):
            return Event.PAD_SEEN, "on the way to the waypoint"
        finding, wait = self._departure.step(self.phase, inputs.vehicle, inputs.autopilot, now_s)
        if wait:
            self._say("waiting", wait, now_s)
        return finding

    def _look_for_pad(self, inputs: PlanInputs, now_s: float) -> Finding:
        if inputs.vehicle is None or not self._guide.active:
            return None
        c, since_s = self._config.search, self._since_s or 0.0
        actual = vehicle_motion(inputs.vehicle, now_s)
        if not self._watch.in_control:
            # setpoints first, then the question: PX4 wants to see them before it obeys
            if now_s - since_s >= c.stream_s:
                self._requests.ask(Action(ActionKind.TAKE_CONTROL), now_s)
            self._take_up_if_strayed(actual, now_s)
            self._control_s = None
            return None
        if self._control_s is None:
            self._control_s = max(now_s, since_s)
            self._guide.take_up(actual, now_s)
        if self._sightings.steady(now_s) and self._pad is not None:
            return Event.PAD_SEEN, self._where_pad_is()
        if now_s >= self._next_request_s:
            self._request_pad(now_s)
        if now_s - max(since_s, self._control_s) >= c.hold_s:
            self._take_up_if_strayed(actual, now_s)
            self._guide.fly_to(self._search.target(self._guide.at(now_s).position_m, now_s), now_s)
        return None

    def _where_pad_is(self) -> str:
        if self._sight is None:
            return "in sight"
        return f"{self._sight.lateral_m:.1f} m aside, {self._sight.height_m:.1f} m below"

    def _touch_down(self, inputs: PlanInputs, now_s: float) -> Finding:
        if not self._touchdown.committed:
            self._keep_near(now_s)
        committed = self._touchdown.committed
        finding = self._touchdown.step(self._sight, inputs.range, inputs.autopilot.landed, now_s)
        if self._touchdown.committed and not committed:
            self._say("commit", "going down", now_s)
        if self._touchdown.on_pad and finding is None:
            self._shut_down(inputs, now_s)
        return finding

    def _shut_down(self, inputs: PlanInputs, now_s: float) -> None:
        """On the pad: disarm when the autopilot agrees that it stands, help it by landing when it does not."""
        assert self._touchdown.contact_s is not None
        stood_s = now_s - self._touchdown.contact_s
        after_s = self._config.touchdown.land_after_s
        if stood_s >= after_s and not self._requests.asked(ActionKind.DISARM):
            self._ask(ActionKind.LAND, inputs, True, now_s)
        if inputs.autopilot.landed is LandedState.ON_GROUND or stood_s >= 2.0 * after_s:
            self._requests.ask(Action(ActionKind.DISARM), now_s)

    def _hold(self, inputs: PlanInputs) -> Finding:
        if inputs.autopilot.connected and self._watch.in_control and not self._watch.released:
            return Event.CONNECTED, "the autopilot is heard again"
        return self._end(inputs)

    def _end(self, inputs: PlanInputs) -> Finding:
        """Hold on by our own setpoints until the autopilot has the vehicle."""
        handed_back = self._requests.granted(ActionKind.HOLD) or self._requests.granted(ActionKind.LAND)
        if self._watch.released and (handed_back or not inputs.autopilot.offboard):
            self._guide.stop()
        return None

    # ------------------------------------------------------------ helpers

    def _keep_near(self, now_s: float) -> None:
        sight = self._sight
        if sight is not None and sight.age_s <= self._config.landing.pause_unseen_s:
            self._take_up_if_strayed(sight.motion, now_s)

    def _take_up_if_strayed(self, actual: Motion, now_s: float) -> None:
        distance_m = self._guide.strayed(actual, now_s)
        if distance_m > 0.0:
            self._guide.take_up(actual, now_s)
            if self._watch.in_control:
                self._say("strayed", f"{distance_m:.1f} m off the reference: planned anew", now_s, "warning")

    def _request_pad(self, now_s: float) -> None:
        self._next_request_s = now_s + self._config.search.request_s
        self._outbox.append(Action(ActionKind.REQUEST_PAD_POSITION))
        text = f"pad not seen: holding, new position requested ({self._search.known(now_s)} so far)"
        self._say("pad_lost", text, now_s, "warning")

    def _turn(self, now_s: float) -> None:
        along = self._config.mission.align_heading and self.phase in BY_THE_PAD and self._sight is not None
        self._guide.turn(self._sight.pad_heading_rad if along and self._sight else None, now_s)

    def _say(
        self, kind: str, text: str, now_s: float, severity: Literal["info", "warning", "error"] = "info"
    ) -> None:
        self._notices.append(Notice(now_s, kind, text, severity))

    def _result(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        floor_m = None
        if self._guide.active and self.phase in {Phase.APPROACH, Phase.DESCEND}:
            floor_m = self._landing.minimum_height_m(now_s)
        return PlanStep(
            time_s=now_s,
            phase=self.phase,
            reference=self._guide.reference(now_s, floor_m),
            actions=tuple(self._outbox),
            notices=tuple(self._notices),
            speed_m_s=self._guide.speed_m_s,
            time_to_go_s=self._guide.time_to_go_s,
            on_ground=self._on_pad,
        )
