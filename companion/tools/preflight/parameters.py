"""The autopilot's parameters on which a precision landing depends: what is expected, and why. Pure.

Names and meanings after PX4 1.16 (commander_params.c, multicopter_position_control_*_params.c), PX4 after
1.17, ArduCopter 4.6 (Parameters.cpp, AP_MotorsMulticopter.cpp) and 4.7 (its list of renamed parameters);
docs/reference/autopilot-parameters.md has the same table.
Values keep the autopilot's units. Nothing here is ever written to an autopilot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotSetup
from companion.config import CompanionConfig, VehicleConfig
from companion.control.response.fitting import HOVER_DIFFERS
from companion.control.setpoints import resolved
from companion.link.autopilot_setup import (
    CIRCLE_FENCE,
    MOTOR_STOP_ACTIONS,
    STICK_ACTIONS,
    endless_drift,
    expected_timeout,
    long_timeout,
    setup_of,
    short_timeout,
)
from companion.link.parameters import GUIDED_OPTIONS, THRUST_IS_THRUST, all_names, value_of
from companion.tools.preflight.findings import Finding, FindingGroup, FindingState

GROUP: Final = "autopilot's parameters"
_GROUP: Final = FindingGroup(GROUP)
_CENTI: Final = 0.01
_OVERRIDE_OFFBOARD: Final = 2  # COM_RC_OVERRIDE bit 1
_EXCEPT_OFFBOARD: Final = 4  # COM_RCL_EXCEPT bit 2
_CONTINUE_GUIDED: Final = 4  # FS_OPTIONS bit 2
_FASTEST_LAND_CM_S: Final = 70.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the settings and the vehicle's file want of the autopilot, whose system id is `system_id`.

    `setup`: what its parameters say together.
    """

    tilt_deg: float
    descent_m_s: float
    climb_m_s: float
    hover_thrust: float
    sends_attitude: bool
    sends_velocity: bool
    may_set: bool  # link.set_parameters
    system_id: int = 1
    setup: AutopilotSetup = field(default_factory=AutopilotSetup)

    @classmethod
    def of(
        cls,
        config: CompanionConfig,
        vehicle: VehicleConfig,
        autopilot_kind: AutopilotKind,
        system_id: int = 1,
    ) -> Wanted:
        """From the settings, for that autopilot."""
        setpoint = resolved(config.control, autopilot_kind).setpoint
        limits = config.control.limits
        return cls(
            limits.tilt_deg,
            limits.descent_speed_m_s,
            limits.climb_speed_m_s,
            vehicle.hover_thrust,
            setpoint == "attitude",
            setpoint == "velocity",
            config.link.set_parameters,
            system_id,
        )


# (state, what was expected and why it matters); None: all is well
Verdict = tuple[FindingState, str] | None
_Judge = Callable[[float, Wanted], Verdict]


def _fail(text: str) -> Verdict:
    return FindingState.FAIL, text


def _warn(text: str) -> Verdict:
    return FindingState.WARNING, text


def _timeout(autopilot_kind: AutopilotKind) -> _Judge:
    """How long an autopilot flies on without setpoints."""

    def judge(_value: float, wanted: Wanted) -> Verdict:
        expected = expected_timeout(wanted.setup, autopilot_kind)
        if why := short_timeout(wanted.setup, autopilot_kind) or long_timeout(wanted.setup):
            return _fail(f"{expected}: {why}; control is refused")
        return None

    return judge


def _fence(off: Callable[[float], bool]) -> _Judge:
    """A part of the fence that ends what nothing else would; `off`: the part is missing."""

    def judge(value: float, wanted: Wanted) -> Verdict:
        if not wanted.sends_attitude or wanted.setup.drift_ends is not False or not off(value):
            return None
        return _warn(
            f"when setpoints stop it drifts level with the wind, and {endless_drift(wanted.system_id)}"
        )

    return judge


def _offboard_loss(value: float, _: Wanted) -> Verdict:
    if value in MOTOR_STOP_ACTIONS:
        return _fail("expected 5 (Hold) or 4 (Land): the motors stop when the app does; control is refused")
    if value in STICK_ACTIONS:
        return _warn(
            f"expected 5 (Hold) or 4 (Land): {STICK_ACTIONS[round(value)]} is for a pilot at the sticks; "
            "with nobody there it comes down with the speed over ground it has"
        )
    return None


def _bit(mask: int, *, set_: bool, text: str) -> _Judge:
    def judge(value: float, _: Wanted) -> Verdict:
        return None if bool(int(value) & mask) is set_ else _warn(text)

    return judge


def _positive(text: str) -> _Judge:
    return lambda value, _: None if value > 0.0 else _warn(text)


def _tilt(scale: float) -> _Judge:
    def judge(value: float, wanted: Wanted) -> Verdict:
        if scale * value >= wanted.tilt_deg:
            return None
        return _warn(
            f"expected {wanted.tilt_deg / scale:g} or more (control.limits.tilt_deg): the app takes the "
            "smaller one, and follows fast pads less well in wind"
        )

    return judge


def _hover_thrust(value: float, wanted: Wanted) -> Verdict:
    if abs(value / wanted.hover_thrust - 1.0) <= HOVER_DIFFERS:
        return None
    return _warn(
        f"the vehicle's file says hover_thrust {wanted.hover_thrust:g}: one of the two is wrong, and "
        "control begins by sinking or climbing; hover once and compare"
    )


def _thrust_is_thrust(value: float, wanted: Wanted) -> Verdict:
    if not wanted.sends_attitude or int(value) & THRUST_IS_THRUST:
        return None
    needed = int(value) | THRUST_IS_THRUST
    why = f"expected {needed} (bit 3): without it our thrust is taken for a climb rate"
    if wanted.may_set:
        return _warn(f"{why}; link.set_parameters lets the app set it before it arms")
    return _fail(f"{why}, and control is refused")


def _speed(key: str, pick: Callable[[Wanted], float]) -> _Judge:
    def judge(value: float, wanted: Wanted) -> Verdict:
        if value >= pick(wanted):
            return None
        return _warn(f"expected {pick(wanted):g} or more (control.limits.{key}): setpoints are cut to it")

    return judge


def _land_speed(unit: float, name: str) -> _Judge:
    most = unit * _FASTEST_LAND_CM_S
    text = f"expected at most {most:g} {name}: LAND sets it down if the pad is lost low"
    return lambda value, _: None if value <= most else _warn(text)


def _velocity_shaping(value: float, wanted: Wanted) -> Verdict:
    if not wanted.sends_velocity or value > 0.0:
        return None
    return _warn("expected more than 0: velocity setpoints are shaped by it")


JUDGES: Final[dict[AutopilotKind, dict[str, _Judge]]] = {
    "px4": {
        "COM_OF_LOSS_T": _timeout("px4"),
        "COM_OBL_RC_ACT": _offboard_loss,
        "COM_RC_OVERRIDE": _bit(
            _OVERRIDE_OFFBOARD,
            set_=True,
            text="expected bit 1 (value 2): in Offboard only the mode switch takes over, the sticks do not",
        ),
        "COM_RCL_EXCEPT": _bit(
            _EXCEPT_OFFBOARD,
            set_=False,
            text="expected bit 2 (value 4) off: in Offboard the loss of the remote control is ignored",
        ),
        "COM_DISARM_LAND": _positive(
            "expected more than 0: on the pad it does not disarm by itself; the app has to"
        ),
        "MPC_TILTMAX_AIR": _tilt(1.0),
        "MPC_THR_HOVER": _hover_thrust,
        "MPC_USE_HTE": _positive(
            "expected 1: the hover thrust is not learnt; height and land detector suffer as the battery sinks"
        ),
        "MPC_Z_VEL_MAX_DN": _speed("descent_speed_m_s", lambda wanted: wanted.descent_m_s),
        "MPC_Z_VEL_MAX_UP": _speed("climb_speed_m_s", lambda wanted: wanted.climb_m_s),
    },
    "ardupilot": {
        "GUID_TIMEOUT": _timeout("ardupilot"),
        "FENCE_ENABLE": _fence(lambda value: value <= 0.0),
        "FENCE_TYPE": _fence(lambda value: not int(value) & CIRCLE_FENCE),
        "FENCE_ACTION": _fence(lambda value: value <= 0.0),
        GUIDED_OPTIONS: _thrust_is_thrust,
        "ANGLE_MAX": _tilt(_CENTI),
        "MOT_THST_HOVER": _hover_thrust,
        "FS_THR_ENABLE": _positive(
            "expected an action (1 RTL, 3 Land, ...): the loss of the remote control is not noticed"
        ),
        "FS_OPTIONS": _bit(
            _CONTINUE_GUIDED,
            set_=False,
            text="expected bit 2 (value 4) off: in GUIDED the loss of the remote control is ignored",
        ),
        "DISARM_DELAY": _positive(
            "expected more than 0: on the pad it does not disarm by itself; the app has to"
        ),
        "LAND_SPEED": _land_speed(1.0, "cm/s"),
        "WPNAV_ACCEL": _velocity_shaping,
        "PSC_JERK_XY": _velocity_shaping,
    },
}  # fmt: skip
# the same by the names and units of other versions (`AutopilotMake.other_names`)
OTHERS: Final[dict[AutopilotKind, dict[str, dict[str, _Judge]]]] = {
    "px4": {
        "COM_RC_OVERRIDE": {
            "COM_RC_OVR_SPEED": _positive(
                "expected more than 0: in Offboard only the mode switch takes over, the sticks do not"
            ),
        },
    },
    "ardupilot": {
        "ANGLE_MAX": {"ATC_ANGLE_MAX": _tilt(1.0)},
        "LAND_SPEED": {"LAND_SPD_MS": _land_speed(_CENTI, "m/s")},
        "WPNAV_ACCEL": {"WP_ACC": _velocity_shaping},
        "PSC_JERK_XY": {"PSC_NE_JERK": _velocity_shaping},
    },
}


def parameter_names(autopilot_kind: AutopilotKind) -> tuple[str, ...]:
    """Those to read, by the names of all versions: only one of each answers. A judge may need others, too."""
    judged = [name for first in JUDGES[autopilot_kind] for name in _names(autopilot_kind, first)]
    needed = [
        name
        for first in PROFILES[autopilot_kind].read_parameters
        for name in all_names(autopilot_kind, first)
    ]
    return tuple(dict.fromkeys(judged + needed))


def judge_parameters(
    autopilot_kind: AutopilotKind, values: Mapping[str, float | None], wanted: Wanted
) -> list[Finding]:
    """A finding each; None is a parameter that the autopilot did not report."""
    kind, found = autopilot_kind, []
    told = {first: value_of(kind, first, values) for first in PROFILES[kind].read_parameters}
    wanted = replace(wanted, setup=setup_of(kind, told, wanted.system_id))
    for first in JUDGES[kind]:
        names = _names(kind, first)
        reported = [name for name in names if values.get(name) is not None]
        if not reported and first in PROFILES[kind].loss_parameters:
            why = "an answer: what it does when setpoints stop is not known; control is refused"
            found.append(_GROUP.fail(first, "the autopilot does not report it", f"expected {why}"))
            continue
        found += [_finding(name, values.get(name), names[name], wanted) for name in reported or [first]]
    return found


def _names(autopilot_kind: AutopilotKind, first: str) -> dict[str, _Judge]:
    """What a parameter is called, with the judge of each name's unit."""
    return {first: JUDGES[autopilot_kind][first], **OTHERS[autopilot_kind].get(first, {})}


def _finding(name: str, value: float | None, judge: _Judge, wanted: Wanted) -> Finding:
    if value is None:
        return _GROUP.skip(name, "the autopilot does not report it: another version's name, or a slow link")
    verdict = judge(value, wanted)
    if verdict is None:
        return _GROUP.ok(name, f"{value:g}")
    return Finding(GROUP, name, verdict[0], f"{value:g}", verdict[1])
