"""The failsafe monitor: detects what may happen in any state. The table says what follows.

Control is ours from the moment the autopilot granted it and says that it obeys setpoints. When it then
leaves that mode and we did not ask for it, a pilot (or a failsafe of the autopilot) has taken over, and
that is final. Before that, a change into one of a pilot's modes means the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import AutopilotState, VehicleState
from companion.config import MissionConfig
from companion.plan.mission.inputs import PlanInputs
from companion.plan.mission.machine import StateMachine
from companion.plan.mission.states import Authority, DetectedEvent, MissionEvent, State
from companion.plan.mission.table import FINAL, ON_GROUND

_STALE_ESTIMATE_S = 0.5
# Modes that we never request in flight, by the autopilots' names without their prefixes.
_PILOT_MODES: Final[dict[AutopilotKind, frozenset[str]]] = {
    "px4": frozenset(
        {"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE", "RTL", "RTGS", "LAND", "POSITION"}
    ),
    "ardupilot": frozenset(
        {"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "POSHOLD", "SPORT", "DRIFT", "FLIP", "RTL", "SMART_RTL"}
        | {"BRAKE", "LAND", "THROW", "AUTO", "CIRCLE", "FLOWHOLD"}
    ),
}


def is_pilots(mode: str, autopilot_kind: AutopilotKind | None) -> bool:
    """Whether a mode is one that a pilot or a failsafe chooses, never we in flight."""
    name = mode.upper().rsplit(".", 1)[-1].replace(" ", "_")
    return autopilot_kind is not None and name in _PILOT_MODES[autopilot_kind]


class FailsafeMonitor:
    """Looks at every cycle's inputs before the phase does."""

    def __init__(self, config: MissionConfig, machine: StateMachine) -> None:
        self._config, self._machine = config, machine
        self._in_pilots_mode = False
        self._took_off_s: float | None = None
        self._phase_since_s: float | None = None

    def phase_begins(self, now_s: float) -> None:
        """Count the new phase's time from now; the mission's own from take-off."""
        self._phase_since_s = now_s
        if self._took_off_s is None and self._machine.state not in ON_GROUND:
            self._took_off_s = now_s

    def detect(self, inputs: PlanInputs, control_granted: bool, now_s: float) -> tuple[DetectedEvent, ...]:
        """All that holds in this cycle, the gravest first; nothing any more once the mission has ended."""
        if self._phase_since_s is None:
            self._phase_since_s = now_s
        autopilot = inputs.autopilot
        obeyed = control_granted and autopilot.offboard
        taken_over = self._taken_over(autopilot, obeyed)
        if self._machine.state in FINAL:
            return ()
        heard = autopilot.connected
        signs = (
            (obeyed, MissionEvent.CONTROL_GRANTED, "the autopilot follows setpoints"),
            (heard and not autopilot.armed, MissionEvent.DISARMED, "motors off"),
            (
                heard and taken_over,
                MissionEvent.PILOT_TOOK_OVER,
                f"mode {autopilot.mode or 'unknown'} was not requested",
            ),
            (inputs.stop_requested, MissionEvent.STOP, "by the operator"),
            (not heard, MissionEvent.LINK_LOST, "no heartbeat from the autopilot"),
        )
        found = [(event, reason) for holds, event, reason in signs if holds]
        found += [*self._estimate(inputs.vehicle, now_s), *self._time(now_s)]
        if heard:
            found.append((MissionEvent.LINK_UP, "heartbeat again"))
        return tuple(found)

    def _taken_over(self, autopilot: AutopilotState, obeyed: bool) -> bool:
        """Whether a pilot took over with this; call once a cycle."""
        in_pilots_mode = is_pilots(autopilot.mode, autopilot.autopilot_kind)
        entered = in_pilots_mode and not self._in_pilots_mode
        self._in_pilots_mode = in_pilots_mode
        if self._machine.authority is Authority.RELEASED or self._machine.state is State.AUTO_LAND:
            # LAND may be our own request; any other mode is a pilot's
            return entered and not autopilot.mode.upper().endswith("LAND")
        if self._machine.authority is Authority.OURS:
            return not autopilot.offboard
        return entered and not obeyed

    def _estimate(self, vehicle: VehicleState | None, now_s: float) -> Iterator[DetectedEvent]:
        if vehicle is None or not vehicle.aligned or now_s - vehicle.time_s > _STALE_ESTIMATE_S:
            yield MissionEvent.ESTIMATE_LOST, "no fresh estimate of the vehicle"
        elif not vehicle.velocity_std_m_s <= self._config.largest_speed_std_m_s:
            yield MissionEvent.VELOCITY_UNKNOWN, f"standard deviation {vehicle.velocity_std_m_s:.1f} m/s"

    def _time(self, now_s: float) -> Iterator[DetectedEvent]:
        assert self._phase_since_s is not None
        total_s, phase = self._config.total_timeout_s, self._machine.phase
        if self._took_off_s is not None and now_s - self._took_off_s > total_s:
            yield MissionEvent.OVERTIME, f"{total_s:.0f} s since take-off"
        limit_s: float = getattr(self._config.phases, f"{phase.value}_s")
        if now_s - self._phase_since_s > limit_s:
            yield MissionEvent.TIMEOUT, f"{limit_s:.0f} s in {phase.value.replace('_', ' ')}"
