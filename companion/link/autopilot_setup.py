"""Those of the autopilot's parameters on which our loop depends: read, never written. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotSetup
from companion.link.parameters import ParameterRequest, ParameterRequests, all_names, value_of

_CENTI: Final = 0.01
# How long an autopilot should fly on without setpoints. Shorter, whether it hears us is known too late to
# tell its failsafe from a pilot. A PX4 that holds then drags the vehicle over a pad that moves on (0.44 to
# 0.66 m/s with 0.3 and 0.5 s), unless the motors stop first, a second of proven rest after the contact.
SHORTEST_TIMEOUT_S, SHORTEST_WITH_HOLD_S, LONGEST_TIMEOUT_S = 0.3, 1.0, 1.0
# what PX4's COM_OBL_RC_ACT then asks for
_LAND_ACTION: Final = 4
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
        names = [name for first in PROFILES[kind].read_parameters for name in all_names(kind, first)]
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
        if (
            kind is None
            or not self._asked
            or any(self._open(kind, name) for name in PROFILES[kind].read_parameters)
        ):
            return self._known
        reported = {name: request.value for name, request in self._asked.items()}
        found = _setup_of(
            kind, {name: value_of(kind, name, reported) for name in PROFILES[kind].read_parameters}
        )
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


def shortest_timeout_s(autopilot_kind: AutopilotKind, action: int | None) -> float:
    """The shortest time (s) without setpoints after which it may do what it does then."""
    lands = autopilot_kind == "ardupilot" or action == _LAND_ACTION  # ArduPilot levels, and obeys again
    return SHORTEST_TIMEOUT_S if lands else SHORTEST_WITH_HOLD_S


def expected_timeout(shortest_s: float) -> str:
    """What is expected, in words."""
    least = f"{shortest_s:g} to " if shortest_s < LONGEST_TIMEOUT_S else ""
    return f"expected {least}{LONGEST_TIMEOUT_S:g} s"


def loss_refusal(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> str:
    """Why nobody flies with what it does without setpoints; empty when it can be flown with."""
    action, timeout_s = setup.setpoints_lost_action, setup.setpoint_timeout_s
    title = MOTOR_STOP_ACTIONS.get(-1 if action is None else action)
    if title is not None:
        return (
            f"COM_OBL_RC_ACT is {action} ({title}): the motors stop in the air when setpoints do; "
            "expected 5 (Hold) or 4 (Land)"
        )
    least_s = shortest_timeout_s(autopilot_kind, action)
    if timeout_s is None or timeout_s >= least_s:
        return ""
    why = "too short to know that it does not hear us"
    if least_s > SHORTEST_TIMEOUT_S:
        why = "on a pad that moves its Hold drags the vehicle before the motors stop"
    return (
        f"{PROFILES[autopilot_kind].timeout_parameter} is {timeout_s:g}: {why}; {expected_timeout(least_s)}"
    )


def loss_warnings(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> list[str]:
    """What is not safe about the loss of setpoints, as of the link, by the autopilot's parameters."""
    found = []
    action, timeout_s = setup.setpoints_lost_action, setup.setpoint_timeout_s
    timeout_name = PROFILES[autopilot_kind].timeout_parameter
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
            f"link loss: {timeout_name} is {timeout_s:g}: so long the last setpoint is kept; "
            f"{expected_timeout(shortest_timeout_s(autopilot_kind, action))}"
        )
    return found


def _scaled(hundredths: float | None) -> float | None:
    return None if hundredths is None else _CENTI * hundredths
