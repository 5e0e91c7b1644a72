"""The planner: from what is known now to where the vehicle should be next, one step a cycle (Algorithm 1).

`Planner.step(inputs, now_s)` turns the inputs into at most one event, looks up in the mission's table what
follows, lets the phase steer the reference, and returns it with the actions and notices of the cycle. Pure:
no I/O, no clock. NED, m, s, rad; references are relative to the pad as soon as the pad is what is flown to.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.geometry import ned_from_geodetic
from companion.base.messages import ActionKind, LandedState, Notice, Phase, PlanStep
from companion.config import PlanConfig, VehicleConfig
from companion.plan.flight import Flight
from companion.plan.landing.ground_contact import Ground
from companion.plan.landing.relative_state import PadKnowledge
from companion.plan.landing.touchdown import Finding
from companion.plan.mission.failsafe_monitor import Watch
from companion.plan.mission.inputs import PlanInputs
from companion.plan.mission.requests import Requests
from companion.plan.mission.table import FINAL, TAKES_CONTROL, Event, transition
from companion.plan.obstacles.avoidance import Avoidance
from companion.plan.obstacles.surroundings import Severity
from companion.plan.trajectory.guidance import Guide, SpeedLaw
from companion.plan.trajectory.waypoints import check_places

__all__ = ["PlanInputs", "Planner"]

_HANDED_BACK_BY: Final = frozenset({ActionKind.HOLD, ActionKind.LAND})


class Planner:
    """One mission, from connecting to standing on the pad."""

    def __init__(
        self, config: PlanConfig, vehicle: VehicleConfig, horizon_steps: int, step_s: float, law: SpeedLaw
    ) -> None:
        """Ready to connect.

        Raises:
            ConfigError: the take-off or a waypoint is too near to an obstacle.
        """
        check_places(config, vehicle.radius_m)
        mission, search = config.mission, config.search
        self.phase = Phase.CONNECT
        self._since_s = math.nan
        self._notices: list[Notice] = []
        self._fence_m, self._fence_told = mission.fence_m, False
        self._requests = Requests(mission.action_retry_s, mission.action_answer_s, mission.action_attempts)
        self._watch = Watch(mission)
        self._pad = PadKnowledge(search.sightings, search.sightings_window_s)
        self._ground = Ground(vehicle.range_position_body_m)
        avoidance = Avoidance(config, vehicle.radius_m)
        self._guide = Guide(config.guidance, law, horizon_steps, step_s, avoidance)
        self._flight = Flight(
            config,
            vehicle,
            guide=self._guide,
            pad=self._pad,
            ground=self._ground,
            requests=self._requests,
            watch=self._watch,
            say=self._say,
        )

    @property
    def waiting(self) -> bool:
        """Whether something asked of the autopilot is still open."""
        return self._requests.open

    def step(self, inputs: PlanInputs, now_s: float) -> PlanStep:
        """One cycle at now_s: at most one event, then the reference, actions and notices."""
        self._notices = []
        if math.isnan(self._since_s):
            self._since_s = now_s
        self._see(inputs, now_s)
        finding = self._find(inputs, now_s)
        if finding is not None and self._happen(*finding, inputs, now_s):
            # the new phase steers at once; what it finds waits for the next cycle
            self._flight.fly(inputs, now_s)
        self._flight.turn(now_s)
        return PlanStep(
            time_s=now_s,
            phase=self.phase,
            reference=self._guide.reference(
                now_s,
                self._flight.minimum_height_m(now_s),
                self._flight.cone(),
                self._flight.level_off(),
            ),
            actions=self._requests.due(now_s),
            notices=tuple(self._notices),
            speed_m_s=self._guide.speed_m_s,
            time_to_go_s=self._guide.time_to_go_s,
            on_ground=self._flight.on_pad,
        )

    def _see(self, inputs: PlanInputs, now_s: float) -> None:
        self._pad.update(inputs.pad, inputs.vehicle, now_s)
        self._ground.update(inputs.vehicle, inputs.autopilot, inputs.range, now_s)
        self._flight.surroundings.update(self._pad)
        if inputs.vehicle is None:
            return
        if self._within_fence(inputs):
            self._flight.search.hear(inputs.beacon, inputs.vehicle.origin)
        if self._pad.motion is not None and inputs.pad is not None:
            self._flight.search.whereabouts.remember(self._pad.motion, inputs.pad.seen_time_s, now_s)

    def _within_fence(self, inputs: PlanInputs) -> bool:
        """Whether the beacon lies where we may fly; one that does not is told once and not followed."""
        beacon, home = inputs.beacon, inputs.autopilot.home
        if beacon is None or home is None:
            return beacon is not None
        north, east, _ = ned_from_geodetic(beacon.latitude_deg, beacon.longitude_deg, beacon.altitude_m, home)
        distance_m, fence_m = math.hypot(north, east), self._fence_m
        if distance_m > fence_m and not self._fence_told:
            self._fence_told = True
            words = f"the pad's beacon lies {distance_m:.0f} m from home: not followed beyond {fence_m:.0f} m"
            self._say("fence", words, beacon.time_s, "warning")
        return distance_m <= fence_m

    def _find(self, inputs: PlanInputs, now_s: float) -> Finding:
        """The gravest thing that happened, else what the phase finds."""
        spent = self._requests.hear(inputs.results, now_s)
        for words in spent:
            self._say("refused", words, now_s, "error")
        for words in self._requests.news():
            self._say("refused", words, now_s, "warning")
        granted = self.phase in TAKES_CONTROL and self._requests.granted(ActionKind.TAKE_CONTROL)
        taken_over = self._watch.note(inputs.autopilot, granted)
        grave = self._watch.event(
            self.phase,
            self._since_s,
            inputs,
            now_s,
            taken_over=taken_over,
            on_pad=self._flight.on_pad,
            committed=self._flight.committed,
        )
        if grave is not None:
            return grave
        return (Event.REFUSED, spent[0]) if spent else self._flight.fly(inputs, now_s)

    def _happen(self, event: Event, words: str, inputs: PlanInputs, now_s: float) -> bool:
        """Go where the table says; returns whether that is another phase, still to be flown."""
        event = self._flight.count_tries(event)
        follows = transition(self.phase, event)
        if not follows.legal:
            self._say("unexpected", f"{event.value} in {self.phase.value}: holding", now_s, "error")
        if follows.phase is self.phase:
            if event is Event.CONTACT:
                self._say("contact", f"on the pad: {words}", now_s)
            return False
        was_on_pad = self._flight.on_pad
        self.phase, self._since_s = follows.phase, now_s
        self._watch.happened(event)
        severity: Severity = "warning" if self.phase in {Phase.ABORT, Phase.HOLD} else "info"
        self._say("phase", f"{self.phase.value}: {event.value}: {words}".replace("_", " "), now_s, severity)
        self._requests.forget()
        self._flight.enter(self.phase, inputs, now_s)
        for kind in follows.actions:
            self._ask(kind, inputs, was_on_pad, now_s)
        return self.phase not in FINAL

    def _ask(self, kind: ActionKind, inputs: PlanInputs, on_pad: bool, now_s: float) -> None:
        if kind is ActionKind.REQUEST_PAD_POSITION:
            self._flight.search.request_now()
            return
        if kind is ActionKind.HOLD:
            if self._watch.released:
                return  # handed back already; a pilot may have it by now
            if on_pad or inputs.autopilot.landed is LandedState.ON_GROUND:
                kind = ActionKind.LAND  # holding a position would lift off again
        if kind in _HANDED_BACK_BY:
            self._watch.let_go()
        self._requests.ask(self._flight.departure.action(kind, inputs.autopilot), now_s)

    def _say(self, kind: str, text: str, now_s: float, severity: Severity = "info") -> None:
        self._notices.append(Notice(now_s, kind, text, severity))
