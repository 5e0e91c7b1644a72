"""The failsafe monitor detects events that can occur in any state. The mission's table decides what follows.

The app has control from the moment at which the autopilot grants it and reports that it obeys setpoints. A
mode that the app did not request was chosen by a pilot or by a failsafe of the autopilot, and ends the
mission (`mode_monitor`).
"""

import math
from collections.abc import Iterator, Sequence

from companion.base.messages import (
    IMU_TIMEOUT_S,
    ActionKind,
    AutopilotState,
    PadState,
    Phase,
    SourceComparison,
    VehicleState,
)
from companion.base.second_sources import TABLE, Reaction
from companion.config import PlanConfig
from companion.plan.debounce import Debounce
from companion.plan.events import DetectedEvent, MissionEvent
from companion.plan.inputs import PlanInputs
from companion.plan.landing.contact import BUMP_S, FRESH_S, KNOWN_S, accelerates, lying_rad
from companion.plan.mission.bounds import Bounds
from companion.plan.mission.mode_monitor import WITHOUT_STICKS, ModeMonitor, short_name
from companion.plan.mission.readiness import (
    OLDEST_S,
    late_words,
    refused_words,
    rival_words,
    velocity_words,
)
from companion.plan.mission.requests import Requests
from companion.plan.mission.states import Authority, State
from companion.plan.mission.table import BEFORE_TAKE_OFF, FINAL, StateMachine, by_severity

_RIVAL_S = 0.5  # setpoints come at 2 Hz or more
# What lasts longer does not pass: without a plan the stop is complete, and the vehicle drifts with the wind;
# a vehicle that is thrown over and comes back is not at rest meanwhile.
_PASSES_S = 1.0
# a wind that could not be held against leads out of the fence, and past every time limit
_LED_AWAY = frozenset({MissionEvent.OUT_OF_BOUNDS, MissionEvent.OVERTIME, MissionEvent.TIMEOUT})
_EVENTS: dict[Reaction | None, MissionEvent] = {
    Reaction.HAND_BACK: MissionEvent.ESTIMATE_DISPUTED,
    Reaction.HAND_BACK_AWAY: MissionEvent.VELOCITY_UNCERTAIN,
    Reaction.LEAVE_PAD: MissionEvent.PAD_DISPUTED,
}


def _mode_words(inputs: PlanInputs) -> str:
    """Whose the mode is, as far as the autopilot tells, and whether our setpoints had stopped."""
    autopilot = inputs.autopilot
    words = f"mode {autopilot.mode or 'unknown'} was not requested"
    # in a mode with sticks a pilot may fly, whatever was intended
    if autopilot.intended_mode not in {"", autopilot.mode} and short_name(autopilot.mode) in WITHOUT_STICKS:
        words = f"autopilot failsafe: {autopilot.mode} instead of {autopilot.intended_mode}"
    if inputs.computer.held_up_s >= inputs.link.keeps_setpoint_s:
        words += f": setpoints stopped for {inputs.computer.held_up_s:.1f} s"
    return words


def _signs(inputs: PlanInputs, *, control_granted: bool, taken_over: bool) -> Iterator[DetectedEvent]:
    """What the autopilot, its link and the operator say."""
    autopilot, E = inputs.autopilot, MissionEvent
    if control_granted and autopilot.offboard:
        yield E.CONTROL_GRANTED, "the autopilot follows setpoints"
    if autopilot.connected and not autopilot.armed:
        yield E.DISARMED, "motors off"
    if autopilot.connected and autopilot.motors_cut:
        yield E.TAKEN_OVER, "kill switch, emergency stop or flight termination"
    if taken_over:
        yield E.TAKEN_OVER, _mode_words(inputs)
    if inputs.stop_requested:
        yield E.STOP, "by the operator"
    if inputs.computer.woke:
        yield E.SUSPENDED, "this computer"
    if not autopilot.connected:
        yield E.LINK_LOST, f"no heartbeat from the autopilot{refused_words(autopilot)}"
    elif inputs.link.lost:
        words = f"no sign for {inputs.link.silent_s:.0f} s that the autopilot receives the app"
        yield E.LINK_LOST, words
    else:
        yield E.LINK_UP, "heartbeat again"


def _disputed(
    comparisons: Sequence[SourceComparison], bounds: Sequence[DetectedEvent]
) -> Iterator[DetectedEvent]:
    """Numbers that a second source contradicts.

    What is only announced of the pad's explains a pad that seems too fast: it feigns that.
    """
    seems_fast = any(event is MissionEvent.PAD_TOO_FAST for event, _ in bounds)
    for comparison in comparisons:
        row = TABLE[comparison.quantity]
        feigns = seems_fast and row.reaction is Reaction.LEAVE_PAD and row.announces(comparison)
        if (feigns or row.refuses(comparison)) and (event := _EVENTS.get(row.reaction)):
            yield event, row.words(comparison)


class FailsafeMonitor:
    """Looks at every cycle's inputs before the phase does."""

    def __init__(self, config: PlanConfig, machine: StateMachine, requests: Requests) -> None:
        self._config, self._machine, self._requests = config.mission, machine, requests
        self._modes = ModeMonitor(self._config.take_off_height_m)
        self.bounds = Bounds(config)
        self._held = Debounce()
        self.lies = False  # on its side, by all that tells

    def phase_begins(self, now_s: float) -> None:
        """Count the new phase's time from now; the mission's own from take-off."""
        self._held.end("phase")
        self._times_s(now_s)

    def _times_s(self, now_s: float) -> tuple[float, float]:
        """How long this phase and, since take-off, the mission have lasted; negative before that."""
        flies = self._machine.state not in BEFORE_TAKE_OFF
        return self._held.held_s("phase", True, now_s), self._held.held_s("mission", flies, now_s)

    def detect(
        self, inputs: PlanInputs, now_s: float, over_home_m: float | None = None
    ) -> tuple[DetectedEvent, ...]:
        """All that holds in this cycle, the gravest first; nothing any more once the mission has ended."""
        phase_s, mission_s = self._times_s(now_s)
        state, authority, autopilot = self._machine.state, self._machine.authority, inputs.autopilot
        if state in FINAL:
            return ()
        self._modes.listen(autopilot, inputs.link, now_s)
        control_granted = self._requests.granted(ActionKind.TAKE_CONTROL)
        taking_off = self._requests.granted(ActionKind.TAKE_OFF)
        taken_over = autopilot.connected and self._modes.taken_over(
            state,
            authority,
            autopilot,
            requested=control_granted if authority is Authority.PILOT else taking_off,
            over_home_m=over_home_m,
            now_s=now_s,
            asked=self._requests.asked_last,
        )
        found = [*_signs(inputs, control_granted=control_granted, taken_over=taken_over)]
        found += self._tipped_over(inputs, now_s)
        found += [*self._late(inputs, now_s), *self._estimate(inputs.vehicle, inputs.pad, now_s)]
        found += [*self._control(inputs.control_failure, now_s), *self._battery(autopilot)]
        bounds = [*self.bounds.detect(inputs.vehicle, inputs.pad, autopilot, now_s)]
        found += [*_disputed(inputs.comparisons, bounds), *bounds, *self._time(phase_s, mission_s)]
        cause = f"; {inputs.shortage}" if inputs.shortage else ""
        return by_severity([(e, words + cause if e in _LED_AWAY else words) for e, words in found])

    def after_end(self, autopilot: AutopilotState) -> tuple[DetectedEvent, ...]:
        """Whether somebody has taken the vehicle while the mission's end still asks for something."""
        asks = self._machine.state is State.ABORT and self._requests.open
        if not (asks and autopilot.connected):
            return ()
        if autopilot.motors_cut:
            return ((MissionEvent.TAKEN_OVER, "motors cut: no further requests"),)
        if self._modes.taken_since_end(autopilot, self._requests.asked_last):
            return ((MissionEvent.TAKEN_OVER, f"mode {autopilot.mode}: no further requests"),)
        return ()

    def _tipped_over(self, inputs: PlanInputs, now_s: float) -> Iterator[DetectedEvent]:
        tilt_rad = lying_rad(inputs, now_s)
        # what is dragged by its motors is jolted; what falls is not for so short a time
        falls = self._held.held_s("falls", accelerates(inputs.vehicle), now_s) >= BUMP_S
        rests = self.lies or not falls  # one that lies does so on, however hard it is dragged
        self.lies = self._held.held_s("lies", tilt_rad > 0.0 and rests, now_s) >= _PASSES_S
        if self.lies:
            yield MissionEvent.TIPPED_OVER, f"tilted by {math.degrees(tilt_rad):.0f} deg and at rest"

    def _late(self, inputs: PlanInputs, now_s: float) -> Iterator[DetectedEvent]:
        """Whether our computer or the link takes too long, or another program sends setpoints too.

        Without any answer there is no telling of the link, and LINK_LOST may follow.
        """
        autopilot = inputs.autopilot
        if inputs.computer.problem is not None:
            yield MissionEvent.COMPUTER_LATE, inputs.computer.problem
        if others := rival_words(autopilot, now_s, _RIVAL_S):
            yield MissionEvent.RIVAL, others
        known = autopilot.connected and now_s - autopilot.round_trip_time_s <= OLDEST_S
        if known and (late := late_words(autopilot, self._config)):
            yield MissionEvent.LINK_LATE, late

    def _control(self, failure: str, now_s: float) -> Iterator[DetectedEvent]:
        if self._held.held_s("no plan", bool(failure), now_s) >= _PASSES_S:
            yield MissionEvent.CONTROL_FAILED, failure

    def _battery(self, autopilot: AutopilotState) -> Iterator[DetectedEvent]:
        battery, share = self._config.battery, autopilot.battery_share
        for event, limit in (
            (MissionEvent.BATTERY_CRITICAL, battery.critical),
            (MissionEvent.BATTERY_LOW, battery.low),
        ):
            if share is not None and share <= limit:
                yield event, f"{100.0 * share:.0f} % left"

    def _estimate(
        self, vehicle: VehicleState | None, pad: PadState | None, now_s: float
    ) -> Iterator[DetectedEvent]:
        # In the final descent over a pad that was in view until then it is lost only when the estimator gives
        # none any more: LAND would brake the vehicle over a pad that drives on. Of a pad that was out of view
        # before, the motion is known from too long ago; no sighting is taken in without the IMU.
        sensed_s = -math.inf if vehicle is None else vehicle.sensed_time_s
        follows = (
            self._machine.state is State.SINK and pad is not None and sensed_s - pad.seen_time_s <= FRESH_S
        )
        longest_s = IMU_TIMEOUT_S if follows else KNOWN_S
        if vehicle is None or not vehicle.aligned or now_s - sensed_s > longest_s:
            yield MissionEvent.ESTIMATE_LOST, "no current vehicle estimate"
        elif uncertain := velocity_words(vehicle, self._config):
            yield MissionEvent.VELOCITY_UNCERTAIN, uncertain

    def _time(self, phase_s: float, mission_s: float) -> Iterator[DetectedEvent]:
        total_s, phase = self._config.total_timeout_s, self._machine.phase
        if phase is Phase.STANDBY:
            return
        if mission_s > total_s:
            yield MissionEvent.OVERTIME, f"{total_s:.0f} s since take-off"
        limit_s: float = getattr(self._config.phases, f"{phase.value}_s")
        if phase_s > limit_s:
            yield MissionEvent.TIMEOUT, f"{limit_s:.0f} s in {phase.value.replace('_', ' ')}"
