"""Those of the autopilot's parameters on which our loop depends: read, never written. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import AutopilotSetup
from companion.link.parameters import ParameterRequest, ParameterRequests, all_names, value_of

NAMES: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "px4": ("MPC_TILTMAX_AIR", "MPC_THR_HOVER", "COM_OF_LOSS_T", "COM_OBL_RC_ACT"),
    "ardupilot": ("ANGLE_MAX", "WPNAV_ACCEL", "PSC_JERK_XY", "MOT_THST_HOVER", "GUID_TIMEOUT"),
}
_CENTI: Final = 0.01
# how long an autopilot should fly on without setpoints; what PX4's COM_OBL_RC_ACT then asks for
SHORTEST_TIMEOUT_S, LONGEST_TIMEOUT_S = 0.3, 1.0
STICK_ACTIONS: Final = {0: "Position", 1: "Altitude", 2: "Stabilized"}
MOTOR_STOP_ACTIONS: Final = {6: "Terminate", 7: "Disarm"}


class SetupReader:
    """Asks for them all at once; `setup` is None until each has been answered or given up."""

    def __init__(self, requests: ParameterRequests) -> None:
        self._requests = requests
        self._autopilot_kind: AutopilotKind | None = None
        self._asked: dict[str, ParameterRequest] = {}
        self._known: AutopilotSetup | None = None
        self._final: AutopilotSetup | None = None  # once every request has ended: nothing changes any more

    def begin(self, autopilot_kind: AutopilotKind | None) -> None:
        """An autopilot has been received; another one is asked again."""
        if autopilot_kind is None or autopilot_kind == self._autopilot_kind:
            return
        self._autopilot_kind, self._known, self._final, self._asked = autopilot_kind, None, None, {}
        self.renew()

    def renew(self) -> None:
        """Ask afresh: an operator may have changed them. What is known counts until all are answered."""
        if self._autopilot_kind is None:
            return
        self._known, self._final = self.setup, None
        kind = self._autopilot_kind
        names = [name for first in NAMES[kind] for name in all_names(kind, first)]
        self._asked = {name: ParameterRequest(name) for name in names}
        for request in self._asked.values():
            self._requests.submit(request)

    def _open(self, kind: AutopilotKind, first: str) -> bool:
        """Whether a parameter may still be answered; once it is under one name, the others are no matter."""
        requests = [self._asked[name] for name in all_names(kind, first)]
        answered = any(request.value is not None for request in requests)
        return not answered and any(request.outcome is None for request in requests)

    @property
    def setup(self) -> AutopilotSetup | None:
        """What is known of it; a parameter that it does not have is unknown."""
        if self._final is not None:
            return self._final
        kind = self._autopilot_kind
        if kind is None or not self._asked or any(self._open(kind, name) for name in NAMES[kind]):
            return self._known
        reported = {name: request.value for name, request in self._asked.items()}
        found = _setup_of(kind, {name: value_of(kind, name, reported) for name in NAMES[kind]})
        if all(request.outcome is not None for request in self._asked.values()):
            self._final = found
        return found


def _setup_of(kind: AutopilotKind, value: Mapping[str, float | None]) -> AutopilotSetup:
    """What the parameters of `NAMES` say, by their first names."""
    if kind == "px4":
        action = value["COM_OBL_RC_ACT"]
        return AutopilotSetup(
            tilt_deg=value["MPC_TILTMAX_AIR"],
            hover_thrust=value["MPC_THR_HOVER"],
            setpoint_timeout_s=value["COM_OF_LOSS_T"],
            setpoints_lost_action=None if action is None else round(action),
        )
    return AutopilotSetup(
        tilt_deg=_scaled(value["ANGLE_MAX"]),
        hover_thrust=value["MOT_THST_HOVER"],
        acceleration_m_s2=_scaled(value["WPNAV_ACCEL"]),
        jerk_m_s3=value["PSC_JERK_XY"],
        setpoint_timeout_s=value["GUID_TIMEOUT"],
    )


def motors_stop(setup: AutopilotSetup) -> str:
    """Why the loss of setpoints would stop the motors in the air; empty when it would not."""
    action = setup.setpoints_lost_action
    title = MOTOR_STOP_ACTIONS.get(-1 if action is None else action)
    if title is None:
        return ""
    return (
        f"COM_OBL_RC_ACT is {action} ({title}): the motors stop in the air when setpoints do; "
        "expected 5 (Hold) or 4 (Land)"
    )


def loss_warnings(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> list[str]:
    """What is not safe about the loss of setpoints, as of the link, by the autopilot's parameters."""
    found = []
    action, timeout_s = setup.setpoints_lost_action, setup.setpoint_timeout_s
    timeout_name = "COM_OF_LOSS_T" if autopilot_kind == "px4" else "GUID_TIMEOUT"
    unknown = [timeout_name] if timeout_s is None else []
    if action is None and autopilot_kind == "px4":
        unknown.append("COM_OBL_RC_ACT")
    if unknown:
        found.append(
            f"link loss: the autopilot does not report {' and '.join(unknown)}: "
            "what it does when setpoints stop is not known"
        )
    if action is not None and action in STICK_ACTIONS:
        found.append(
            f"link loss: COM_OBL_RC_ACT is {action} ({STICK_ACTIONS[action]}): with nobody at the sticks it "
            "comes down with the speed over ground it has; expected 5 (Hold) or 4 (Land)"
        )
    if timeout_s is not None and timeout_s > LONGEST_TIMEOUT_S:
        found.append(
            f"link loss: {timeout_name} is {timeout_s:g}: so long the last setpoint is kept; expected "
            f"{SHORTEST_TIMEOUT_S:g} to {LONGEST_TIMEOUT_S:g} s"
        )
    return found


def _scaled(hundredths: float | None) -> float | None:
    return None if hundredths is None else _CENTI * hundredths
