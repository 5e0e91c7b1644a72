"""What can befall a mission in any phase: stop, pilot, link, estimate, disarming, time.

Control is ours from the moment the autopilot granted it and says that it obeys setpoints. When it then
leaves that mode and we did not ask for it, a pilot (or a failsafe of the autopilot) has taken over, and
that is final. Before that, a change into one of a pilot's modes means the same.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.messages import AutopilotState, Manner, Phase, VehicleState
from companion.config import MissionConfig
from companion.plan.landing.touchdown import Finding
from companion.plan.mission.inputs import PlanInputs
from companion.plan.mission.table import BY_THE_PAD, FINAL, OUR_CONTROL, Event

_STALE_ESTIMATE_S = 0.5
# The modes that we never ask for while we fly, by the autopilots' own names without their prefixes.
_PILOT_MODES: Final[dict[Manner, frozenset[str]]] = {
    "px4": frozenset(
        {"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE", "RTL", "RTGS", "LAND", "POSITION"}
    ),
    "ardupilot": frozenset(
        {"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "POSHOLD", "SPORT", "DRIFT", "FLIP", "RTL", "SMART_RTL"}
        | {"BRAKE", "LAND", "THROW", "AUTO", "CIRCLE", "FLOWHOLD"}
    ),
}


def is_pilots(mode: str, manner: Manner | None) -> bool:
    """Whether a mode is one that a pilot or a failsafe chooses, never we in flight."""
    name = mode.upper().rsplit(".", 1)[-1].replace(" ", "_")
    return manner is not None and name in _PILOT_MODES[manner]


class Watch:
    """Looks at every cycle's inputs before the phase does."""

    def __init__(self, config: MissionConfig) -> None:
        self._config = config
        self.in_control = False
        self.released = False
        self._pilots_mode = False
        self._link_awaited = False
        self._started_s: float | None = None

    def note(self, autopilot: AutopilotState, control_granted: bool) -> bool:
        """Take in the mode; returns whether a pilot took over with this."""
        pilots = is_pilots(autopilot.mode, autopilot.manner)
        entered = pilots and not self._pilots_mode
        self._pilots_mode = pilots
        if control_granted and autopilot.offboard:
            self.in_control = True
        if self.released:
            # on the pad we have asked for LAND ourselves; any other mode is somebody's choice
            return entered and not autopilot.mode.upper().endswith("LAND")
        return not autopilot.offboard if self.in_control else entered

    def let_go(self) -> None:
        """The vehicle is being handed back for good: from here on a change of mode is no surprise."""
        self.released = True

    def happened(self, event: Event) -> None:
        """Take in what the mission made of a cycle: who has the vehicle, and whether the link is awaited."""
        self._link_awaited = event is Event.LINK_LOST
        if event in {Event.PILOT_TOOK_OVER, Event.DISARMED}:
            self.in_control = False
            self.released = True

    def link_back(self, autopilot: AutopilotState) -> bool:
        """Whether a link that was lost is there again while control is still ours."""
        return self._link_awaited and autopilot.connected and self.in_control and not self.released

    def event(
        self,
        phase: Phase,
        since_s: float,
        inputs: PlanInputs,
        now_s: float,
        *,
        taken_over: bool,
        on_pad: bool,
        committed: bool,
    ) -> Finding:
        """The gravest thing that happened, if any; nothing any more once the mission has ended."""
        autopilot = inputs.autopilot
        if self._started_s is None:
            self._started_s = now_s
        if phase in {Phase.CONNECT, Phase.ARM}:
            self._started_s = now_s  # waiting on the ground is not flying
        if phase in FINAL:
            return None
        heard, flying = autopilot.connected, _in_air(phase)
        signs = (
            _motors_off(phase, autopilot, flying, on_pad),
            (
                heard and taken_over and phase is not Phase.CONNECT,
                Event.PILOT_TOOK_OVER,
                f"mode {autopilot.mode or 'unknown'} was not asked for",
            ),
            (inputs.stop_requested and not committed, Event.STOP, "asked for"),
            (flying and not heard and not on_pad, Event.LINK_LOST, "nothing heard from the autopilot"),
            (
                phase in OUR_CONTROL
                and not on_pad
                and not _usable(inputs.vehicle, now_s, self._speed_std_m_s(phase)),
                Event.ESTIMATE_LOST,
                "the vehicle's own estimate is gone",
            ),
        )
        found = next(((event, words) for happened, event, words in signs if happened), None)
        return found or self._time(phase, since_s, now_s)

    def _speed_std_m_s(self, phase: Phase) -> float:
        """How uncertain our velocity may be: over the pad it is the camera that tells."""
        return math.inf if phase in BY_THE_PAD else self._config.largest_speed_std_m_s

    def _time(self, phase: Phase, since_s: float, now_s: float) -> Finding:
        assert self._started_s is not None
        if now_s - self._started_s > self._config.total_timeout_s:
            return Event.OVERTIME, f"{self._config.total_timeout_s:.0f} s since the start"
        limit_s: float = getattr(self._config.phases, f"{phase.value}_s")
        if now_s - since_s > limit_s:
            return Event.TIMEOUT, f"{limit_s:.0f} s in {phase.value.replace('_', ' ')}"
        return None


def _in_air(phase: Phase) -> bool:
    return phase not in FINAL | {Phase.CONNECT, Phase.ARM, Phase.HOLD}


def _motors_off(
    phase: Phase, autopilot: AutopilotState, flying: bool, on_pad: bool
) -> tuple[bool, Event, str]:
    off = autopilot.connected and (flying or phase is Phase.HOLD) and not autopilot.armed
    if phase is Phase.TOUCHDOWN and not on_pad:
        return off, Event.PILOT_TOOK_OVER, "motors off before the touchdown"
    return off, Event.DISARMED, "motors off"


def _usable(vehicle: VehicleState | None, now_s: float, speed_std_m_s: float) -> bool:
    return (
        vehicle is not None
        and vehicle.aligned
        and now_s - vehicle.time_s <= _STALE_ESTIMATE_S
        and vehicle.velocity_std_m_s <= speed_std_m_s
    )
