"""Those of the autopilot's parameters on which our loop depends: read, never written. Pure."""

from collections.abc import Mapping
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotSetup
from companion.link.commands import (
    GUIDED_OPTIONS,
    THRUST_IS_THRUST,
    ParameterRequest,
    ParameterRequests,
    all_names,
    value_of,
)

_CENTI: Final = 0.01
UNREAD: Final = "the autopilot's parameters are not read yet"
CIRCLE_FENCE: Final = 2  # FENCE_TYPE bit 1, about home
# How long an autopilot may fly on without setpoints. Shorter, whether it hears us is known too late to
# tell its failsafe from a pilot. A PX4 that holds then drags the vehicle over a pad that moves on (0.44 to
# 0.66 m/s with 0.3 and 0.5 s), unless the motors stop first, a second of proven rest after the contact.
# Longer, what is tilted on the pad, or over it, when the link is lost slides off by that tilt, which nothing
# on board can end: with 3 s, ArduPilot's default, at 0.81 m/s (the real one at 0.58), with 5 s at 2.9.
SHORTEST_TIMEOUT_S, LONGEST_TIMEOUT_S = 0.3, 1.0
# what PX4's COM_OBL_RC_ACT then asks for
_LAND_ACTION: Final = 4
STICK_ACTIONS: Final = {0: "Position", 1: "Altitude", 2: "Stabilized"}
MOTOR_STOP_ACTIONS: Final = {6: "Terminate", 7: "Disarm"}


class SetupReader:
    """Asks for them all at once; `setup` is None until each has been answered or given up."""

    def __init__(self, requests: ParameterRequests) -> None:
        self._requests = requests
        self._autopilot_kind: AutopilotKind | None = None
        self._system_id = 0
        self._asked: dict[str, ParameterRequest] = {}
        self._values: dict[str, float | None] = {}  # by first names, of all that was asked for before
        self._final: AutopilotSetup | None = None  # once every request has ended: nothing changes any more

    def begin(self, autopilot_kind: AutopilotKind | None, system_id: int = 1) -> None:
        """An autopilot, and its system id, has been received; another one is asked again."""
        if autopilot_kind is None or autopilot_kind == self._autopilot_kind:
            return
        self._autopilot_kind, self._system_id = autopilot_kind, system_id
        self._final, self._asked, self._values = None, {}, {}
        self.renew()

    def renew(self) -> None:
        """Ask afresh: an operator may have changed them. Each counts as it was known until it is answered."""
        kind = self._autopilot_kind
        if kind is None:
            return
        if self.setup is not None:
            self._values = self._reported(kind)
        self._final = None
        names = [name for first in PROFILES[kind].read_parameters for name in all_names(kind, first)]
        self._asked = {name: ParameterRequest(name) for name in names}
        for request in self._asked.values():
            self._requests.submit(request)

    @property
    def loss_is_fresh(self) -> bool:
        """Whether what decides about the loss of setpoints has been answered, or given up, since `renew`."""
        kind = self._autopilot_kind
        return kind is not None and not any(self._open(kind, name) for name in PROFILES[kind].loss_parameters)

    def _open(self, kind: AutopilotKind, first: str) -> bool:
        """Whether a parameter may still be answered; once it is under one name, the others are no matter."""
        requests = [self._asked[name] for name in all_names(kind, first)]
        answered = any(request.value is not None for request in requests)
        return not answered and any(request.outcome is None for request in requests)

    def _reported(self, kind: AutopilotKind) -> dict[str, float | None]:
        """The newest values; a request that a bad link has left unanswered takes none back."""
        reported = {name: request.value for name, request in self._asked.items()}
        newest = {first: value_of(kind, first, reported) for first in PROFILES[kind].read_parameters}
        return {first: self._values.get(first) if new is None else new for first, new in newest.items()}

    @property
    def setup(self) -> AutopilotSetup | None:
        """What is known of it; a parameter that it does not have is unknown."""
        if self._final is not None:
            return self._final
        kind = self._autopilot_kind
        if kind is None or not self._asked:
            return None
        if not self._values and any(self._open(kind, name) for name in PROFILES[kind].read_parameters):
            return None
        found = setup_of(kind, self._reported(kind), self._system_id)
        if all(request.outcome is not None for request in self._asked.values()):
            self._final = found
        return found


def setup_of(kind: AutopilotKind, value: Mapping[str, float | None], system_id: int) -> AutopilotSetup:
    """What the parameters say, by their first names and in their units; None: not reported."""
    if kind == "px4":
        action = value.get("COM_OBL_RC_ACT")
        return AutopilotSetup(
            tilt_deg=value.get("MPC_TILTMAX_AIR"),
            hover_thrust=value.get("MPC_THR_HOVER"),
            setpoint_timeout_s=value.get("COM_OF_LOSS_T"),
            setpoints_lost_action=None if action is None else round(action),
        )
    options = value.get(GUIDED_OPTIONS)
    return AutopilotSetup(
        tilt_deg=_scaled(value.get("ANGLE_MAX")),
        hover_thrust=value.get("MOT_THST_HOVER"),
        acceleration_m_s2=_scaled(value.get("WPNAV_ACCEL")),
        jerk_m_s3=value.get("PSC_JERK_XY"),
        setpoint_timeout_s=value.get("GUID_TIMEOUT"),
        drift_ends=_drift_ends({name: number or 0.0 for name, number in value.items()}, system_id),
        guided_options=None if options is None else round(options),
    )


def _drift_ends(value: Mapping[str, float], system_id: int) -> bool:
    """Whether a fence about home, or the GCS failsafe, if that listens to our heartbeats, acts."""
    circle = int(value.get("FENCE_TYPE", 0.0)) & CIRCLE_FENCE
    fence = value.get("FENCE_ENABLE", 0.0) > 0.0 and circle and value.get("FENCE_ACTION", 0.0) > 0.0
    listens = value.get("SYSID_MYGCS") == system_id
    return bool(fence) or (value.get("FS_GCS_ENABLE", 0.0) > 0.0 and listens)


def _shortest_timeout_s(autopilot_kind: AutopilotKind, action: int | None) -> float:
    """The shortest time (s) without setpoints after which it may do what it does then."""
    stays = PROFILES[autopilot_kind].levels_without_setpoints or action == _LAND_ACTION
    return SHORTEST_TIMEOUT_S if stays else LONGEST_TIMEOUT_S


def expected_timeout(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> str:
    """What is expected, in words."""
    shortest_s = _shortest_timeout_s(autopilot_kind, setup.setpoints_lost_action)
    least = f"{shortest_s:g} to " if shortest_s < LONGEST_TIMEOUT_S else ""
    return f"expected {least}{LONGEST_TIMEOUT_S:g} s"


def short_timeout(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> str:
    """Why its time without setpoints is too short; empty when it is not, or not known."""
    least_s = _shortest_timeout_s(autopilot_kind, setup.setpoints_lost_action)
    if setup.setpoint_timeout_s is None or setup.setpoint_timeout_s >= least_s:
        return ""
    if least_s > SHORTEST_TIMEOUT_S:
        return "its Hold would drag the vehicle on a moving pad"
    return "too short to detect the lost link"


def long_timeout(setup: AutopilotSetup) -> str:
    """Why its time without setpoints is too long; empty when it is not, or not known."""
    if setup.setpoint_timeout_s is None or setup.setpoint_timeout_s <= LONGEST_TIMEOUT_S:
        return ""
    return "it keeps the last tilt this long when the link is lost"


def loss_refusal(setup: AutopilotSetup, autopilot_kind: AutopilotKind) -> str:
    """Why nobody flies with what it does without setpoints; empty when it can be flown with."""
    action, timeout_s = setup.setpoints_lost_action, setup.setpoint_timeout_s
    title = MOTOR_STOP_ACTIONS.get(-1 if action is None else action)
    if title is not None:
        return (
            f"COM_OBL_RC_ACT is {action} ({title}): the motors stop in the air when setpoints do; "
            "expected 5 (Hold) or 4 (Land)"
        )
    names = PROFILES[autopilot_kind].loss_parameters
    told = dict(zip(names, (timeout_s, action), strict=False))
    if unknown := [name for name, value in told.items() if value is None]:
        return (
            f"the autopilot does not report {' and '.join(unknown)}: its failsafe is "
            "unknown; expected an answer (a slow link, or another version's name)"
        )
    if why := short_timeout(setup, autopilot_kind) or long_timeout(setup):
        return f"{names[0]} is {timeout_s:g}: {why}; {expected_timeout(setup, autopilot_kind)}"
    return ""


def thrust_refusal(options: int | None, *, may_set: bool) -> str:
    """Why an ArduPilot is not flown by attitude; empty when its GUID_OPTIONS allow it, or may be set.

    An attitude setpoint's thrust is a climb rate to it by default.
    """
    if options is None:
        return f"the autopilot does not report its {GUIDED_OPTIONS}"
    if may_set or options & THRUST_IS_THRUST:
        return ""
    expected = options | THRUST_IS_THRUST
    return (
        f"{GUIDED_OPTIONS} is {options}: thrust is read as climb rate; expected {expected}, "
        "which link.set_parameters lets us set, or control.setpoint velocity"
    )


def setup_refusal(
    setup: AutopilotSetup | None, autopilot_kind: AutopilotKind, *, by_attitude: bool, may_set: bool
) -> str:
    """Why control is not taken with these parameters; empty when it is. None: they are not read yet.

    `by_attitude`: setpoints are attitudes; `may_set`: `link.set_parameters`.
    """
    if setup is None:
        return UNREAD
    if (lost := loss_refusal(setup, autopilot_kind)) or not by_attitude:
        return lost
    climbs = PROFILES[autopilot_kind].thrust_may_be_climb_rate
    return thrust_refusal(setup.guided_options, may_set=may_set) if climbs else ""


def loss_warnings(
    setup: AutopilotSetup, autopilot_kind: AutopilotKind, *, by_attitude: bool, system_id: int = 1
) -> list[str]:
    """What is not safe about the loss of setpoints, as of the link, by the autopilot's parameters.

    `by_attitude`: they are attitudes; `system_id`: the vehicle's, and ours.
    """
    action = setup.setpoints_lost_action
    found = [loss_refusal(setup, autopilot_kind)]
    if action is not None and action in STICK_ACTIONS:
        found.append(
            f"COM_OBL_RC_ACT is {action} ({STICK_ACTIONS[action]}): without sticks it "
            "lands at its speed over ground; expected 5 (Hold) or 4 (Land)"
        )
    if by_attitude and setup.drift_ends is False:
        found.append(f"level, it drifts with the wind, and {endless_drift(system_id)}")
    return [f"link loss: {text}" for text in found if text]


def endless_drift(system_id: int) -> str:
    """What an ArduPilot lacks that would end a flight by attitude without setpoints."""
    return (
        "nothing of the autopilot's ends it; expected FENCE_ENABLE 1 with a circle (FENCE_TYPE 2) and a "
        f"FENCE_ACTION, or FS_GCS_ENABLE 5 with SYSID_MYGCS {system_id}, who we are"
    )


def _scaled(hundredths: float | None) -> float | None:
    return None if hundredths is None else _CENTI * hundredths
