"""The autopilot's parameters on which a precision landing depends: what is expected, and why. Pure.

Names and meanings after PX4 1.16 (commander_params.c, multicopter_position_control_*_params.c), PX4 after
1.17, ArduCopter 4.6 (Parameters.cpp, AP_MotorsMulticopter.cpp) and 4.7 (its list of renamed parameters);
docs/reference/autopilot-parameters.md has the same table.
Values keep the autopilot's units. Nothing here is ever written to an autopilot.

Those that differ go into a file that both ground stations load. QGroundControl takes lines of five columns
between tabs (system, component, name, value, MAV_PARAM_TYPE) and skips others; Mission Planner takes lines of
a name and a value (`NAME,VALUE`) and skips others, so that each parameter stands in both forms. Both skip
what begins with '#'. Sources: QGroundControl, "Parameters, file format", and its ParameterManager; Mission
Planner, ParamFile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from companion import __version__
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
from companion.link.codec import AUTOPILOT_COMPONENT, mavlink
from companion.link.commands import GUIDED_OPTIONS, THRUST_IS_THRUST, all_names, value_of
from companion.tools.preflight.findings import Finding, FindingGroup, FindingState, ParameterChange

GROUP: Final = "autopilot's parameters"
_GROUP: Final = FindingGroup(GROUP)
_CENTI: Final = 0.01
_OVERRIDE_OFFBOARD: Final = 2  # COM_RC_OVERRIDE bit 1
_EXCEPT_OFFBOARD: Final = 4  # COM_RCL_EXCEPT bit 2
_CONTINUE_GUIDED: Final = 4  # FS_OPTIONS bit 2
_FASTEST_LAND_CM_S: Final = 70.0
_DEFAULT_LAG_S: Final = 0.02  # PLND_LAG
_MOVING_TARGET: Final = 1  # PLND_OPTIONS bit 0
# PX4's COM_OBL_RC_ACT, and how long it may fly on the last setpoint: docs/reference/autopilot-parameters.md
_HOLD, _LAND, _LAND_TIMEOUT_S, _HOLD_TIMEOUT_S = 5.0, 4, 0.5, 1.0


Output = Literal["setpoints", "landing_target"]  # control.output


@dataclass(frozen=True, slots=True)
class Wanted:
    """The settings and the vehicle's file, for an autopilot whose system id is `system_id`.

    `setpoints`: the kinds that it is sent; `setup`: what its parameters say together.
    """

    config: CompanionConfig
    vehicle: VehicleConfig
    setpoints: frozenset[str]
    system_id: int = 1
    setup: AutopilotSetup = field(default_factory=AutopilotSetup)

    @classmethod
    def of(
        cls, config: CompanionConfig, vehicle: VehicleConfig, kind: AutopilotKind, system_id: int = 1
    ) -> Wanted:
        return cls(config, vehicle, frozenset({resolved(config.control, kind).setpoint}), system_id)

    @property
    def tilt_deg(self) -> float:
        return self.config.control.limits.tilt_deg


@dataclass(frozen=True, slots=True)
class ParameterReadings:
    """What the autopilot reported: its system id; values and MAV_PARAM_TYPE by name."""

    system_id: int
    values: Mapping[str, float | None]
    types: Mapping[str, int]


# (state, what was expected and why it matters); None: all is well
Verdict = tuple[FindingState, str] | None
_Judge = Callable[[float, Wanted], Verdict]
_Target = Callable[[float, Wanted, ParameterReadings], float]


@dataclass(frozen=True, slots=True)
class _Rule:
    """How a parameter is judged, and what one that differs is set to.

    The target is the expected value nearest to the firmware's default. The hover thrust has none: either the
    autopilot's or the vehicle file's is wrong, and only a hover tells which.
    """

    judge: _Judge
    target: _Target | None = None


def _to(value: float) -> _Target:
    return lambda _value, _wanted, _read: value


def _bits(set_: int = 0, cleared: int = 0) -> _Target:
    return lambda value, _wanted, _read: float((int(value) | set_) & ~cleared)


def _offboard_timeout(_value: float, _wanted: Wanted, read: ParameterReadings) -> float:
    return _LAND_TIMEOUT_S if read.values.get("COM_OBL_RC_ACT") == _LAND else _HOLD_TIMEOUT_S


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
        if "attitude" not in wanted.setpoints or wanted.setup.drift_ends is not False or not off(value):
            return None
        return _warn(
            f"when setpoints stop, the vehicle drifts with the wind, and {endless_drift(wanted.system_id)}"
        )

    return judge


def _offboard_loss(value: float, _: Wanted) -> Verdict:
    if value in MOTOR_STOP_ACTIONS:
        return _fail(
            "expected 5 (Hold) or 4 (Land): with this value PX4 stops the motors when the app stops; "
            "control is refused"
        )
    if value in STICK_ACTIONS:
        return _warn(
            f"expected 5 (Hold) or 4 (Land): {STICK_ACTIONS[round(value)]} needs a pilot's sticks; "
            "without them the vehicle descends at its present speed over ground"
        )
    return None


def _bit(mask: int, *, set_: bool, text: str) -> _Judge:
    def judge(value: float, _: Wanted) -> Verdict:
        return None if bool(int(value) & mask) is set_ else _warn(text)

    return judge


def _positive(text: str) -> _Judge:
    return lambda value, _: None if value > 0.0 else _warn(text)


def _tilt(scale: float) -> _Rule:
    def judge(value: float, wanted: Wanted) -> Verdict:
        if scale * value >= wanted.tilt_deg:
            return None
        return _warn(
            f"expected {wanted.tilt_deg / scale:g} or more (control.limits.tilt_deg): the app uses the "
            "smaller limit and follows fast pads less well in wind"
        )

    def target(_value: float, wanted: Wanted, _read: ParameterReadings) -> float:
        return wanted.tilt_deg if scale == 1.0 else float(math.ceil(wanted.tilt_deg / scale - 1e-6))

    return _Rule(judge, target)


def _hover_thrust(value: float, wanted: Wanted) -> Verdict:
    if abs(value / wanted.vehicle.hover_thrust - 1.0) <= HOVER_DIFFERS:
        return None
    return _warn(
        f"the vehicle's file says hover_thrust {wanted.vehicle.hover_thrust:g}: one of the two is wrong, and "
        "the vehicle will sink or climb when the app takes control; hover once and compare"
    )


def _thrust_is_thrust(value: float, wanted: Wanted) -> Verdict:
    if "attitude" not in wanted.setpoints or int(value) & THRUST_IS_THRUST:
        return None
    needed = int(value) | THRUST_IS_THRUST
    why = f"expected {needed} (bit 3): without it ArduPilot takes the app's thrust for a climb rate"
    if wanted.config.link.set_parameters:
        return _warn(f"{why}; link.set_parameters lets the app set it before it arms")
    return _fail(f"{why}, and control is refused")


def _speed(key: str) -> _Rule:
    def target(_value: float, wanted: Wanted, _read: ParameterReadings | None = None) -> float:
        return float(getattr(wanted.config.control.limits, key))

    def judge(value: float, wanted: Wanted) -> Verdict:
        least = target(value, wanted)
        if value >= least:
            return None
        return _warn(f"expected {least:g} or more (control.limits.{key}): the autopilot limits setpoints")

    return _Rule(judge, target)


def _land_speed(unit: float, name: str) -> _Judge:
    most = unit * _FASTEST_LAND_CM_S
    text = f"expected at most {most:g} {name}: LAND finishes the landing if the pad is lost low"
    return lambda value, _: None if value <= most else _warn(text)


def _velocity_shaping(value: float, wanted: Wanted) -> Verdict:
    if "velocity" not in wanted.setpoints or value > 0.0:
        return None
    return _warn("expected more than 0: ArduPilot shapes velocity setpoints by this limit")


_STAYS_ARMED: Final = (
    "expected more than 0: with 0 the autopilot does not disarm by itself on the pad; the app has to"
)
_NO_STICKS: Final = "without it only the mode switch takes over in Offboard, not the sticks"


def _exactly(expected: float, why: str) -> _Rule:
    """One value, without which the target is not used, or is taken for another place."""
    text = f"expected {expected:g}: {why}"
    return _Rule(lambda value, _: None if value == expected else _fail(text), _to(expected))


def _lag(value: float, _: Wanted) -> Verdict:
    if value > _DEFAULT_LAG_S:
        return None
    return _warn("expected the latency that `companion status` shows: the default is too short")


def _moving_target(value: float, wanted: Wanted) -> Verdict:
    if wanted.config.sense.vision.pad_on == "fixed" or int(value) & _MOVING_TARGET:
        return None
    return _warn("expected bit 0 (value 1): sense.vision.pad_on says that the pad moves")


_BY_REFERENCE: Final = "the target is sent from the vehicle's reference point, in body axes"
# with `control.output: landing_target`, where no setpoint is sent
TARGET_RULES: Final[dict[AutopilotKind, dict[str, _Rule]]] = {
    "px4": {
        "RTL_PLD_MD": _Rule(
            _positive("expected 2: RTL lands beside the target; with 1 it lands on one that it sees at once"),
            _to(2.0),
        )
    },
    "ardupilot": {
        "PLND_ENABLED": _exactly(1.0, "the target is not used"),
        "PLND_TYPE": _exactly(1.0, "the target comes by MAVLink"),
        "PLND_LAG": _Rule(_lag),
        "PLND_OPTIONS": _Rule(_moving_target, _bits(set_=_MOVING_TARGET)),
        **{
            f"PLND_{name}": _exactly(0.0, _BY_REFERENCE)
            for name in ("YAW_ALIGN", "CAM_POS_X", "CAM_POS_Y", "CAM_POS_Z")
        },
    },
}
RULES: Final[dict[AutopilotKind, dict[str, _Rule]]] = {
    "px4": {
        "COM_OF_LOSS_T": _Rule(_timeout("px4"), _offboard_timeout),
        "COM_OBL_RC_ACT": _Rule(_offboard_loss, _to(_HOLD)),
        "COM_RC_OVERRIDE": _Rule(
            _bit(_OVERRIDE_OFFBOARD, set_=True, text=f"expected bit 1 (value 2): {_NO_STICKS}"),
            _bits(set_=_OVERRIDE_OFFBOARD),
        ),
        "COM_RCL_EXCEPT": _Rule(
            _bit(
                _EXCEPT_OFFBOARD,
                set_=False,
                text="expected bit 2 (value 4) off: in Offboard the loss of the remote control is ignored",
            ),
            _bits(cleared=_EXCEPT_OFFBOARD),
        ),
        "COM_DISARM_LAND": _Rule(_positive(_STAYS_ARMED), _to(2.0)),
        "MPC_TILTMAX_AIR": _tilt(1.0),
        "MPC_THR_HOVER": _Rule(_hover_thrust),
        "MPC_USE_HTE": _Rule(
            _positive(
                "expected 1: otherwise PX4 does not adapt the hover thrust as the battery voltage falls, and "
                "height and land detector get worse"
            ),
            _to(1.0),
        ),
        "MPC_Z_VEL_MAX_DN": _speed("descent_speed_m_s"),
        "MPC_Z_VEL_MAX_UP": _speed("climb_speed_m_s"),
    },
    "ardupilot": {
        "GUID_TIMEOUT": _Rule(_timeout("ardupilot"), _to(1.0)),
        "FENCE_ENABLE": _Rule(_fence(lambda value: value <= 0.0), _to(1.0)),
        "FENCE_TYPE": _Rule(_fence(lambda value: not int(value) & CIRCLE_FENCE), _bits(set_=CIRCLE_FENCE)),
        "FENCE_ACTION": _Rule(_fence(lambda value: value <= 0.0), _to(1.0)),
        GUIDED_OPTIONS: _Rule(_thrust_is_thrust, _bits(set_=THRUST_IS_THRUST)),
        "ANGLE_MAX": _tilt(_CENTI),
        "MOT_THST_HOVER": _Rule(_hover_thrust),
        "FS_THR_ENABLE": _Rule(
            _positive(
                "expected an action (1 RTL, 3 Land, ...): with 0 the loss of the remote control has no effect"
            ),
            _to(1.0),
        ),
        "FS_OPTIONS": _Rule(
            _bit(
                _CONTINUE_GUIDED,
                set_=False,
                text="expected bit 2 (value 4) off: in GUIDED the loss of the remote control is ignored",
            ),
            _bits(cleared=_CONTINUE_GUIDED),
        ),
        "DISARM_DELAY": _Rule(_positive(_STAYS_ARMED), _to(10.0)),
        "LAND_SPEED": _Rule(_land_speed(1.0, "cm/s"), _to(50.0)),
        "WPNAV_ACCEL": _Rule(_velocity_shaping, _to(250.0)),
        "PSC_JERK_XY": _Rule(_velocity_shaping, _to(5.0)),
    },
}
# the same by the names and units of other versions (`AutopilotMake.other_names`)
OTHERS: Final[dict[AutopilotKind, dict[str, dict[str, _Rule]]]] = {
    "px4": {"COM_RC_OVERRIDE": {"COM_RC_OVR_SPEED": _Rule(_positive(f"expected more than 0: {_NO_STICKS}"))}},
    "ardupilot": {
        "ANGLE_MAX": {"ATC_ANGLE_MAX": _tilt(1.0)},
        "LAND_SPEED": {"LAND_SPD_MS": _Rule(_land_speed(_CENTI, "m/s"), _to(0.5))},
        "WPNAV_ACCEL": {"WP_ACC": _Rule(_velocity_shaping, _to(2.5))},
        "PSC_JERK_XY": {"PSC_NE_JERK": _Rule(_velocity_shaping, _to(5.0))},
    },
}


def _names(autopilot_kind: AutopilotKind, first: str) -> dict[str, _Rule]:
    """What a parameter is called, with the rule of each name's unit."""
    return {first: _ALL[autopilot_kind][first], **OTHERS[autopilot_kind].get(first, {})}


_ALL: Final = {kind: RULES[kind] | TARGET_RULES[kind] for kind in RULES}
_BY_NAME: Final = {
    name: rule for kind in _ALL for first in _ALL[kind] for name, rule in _names(kind, first).items()
}


def _rules(autopilot_kind: AutopilotKind, output: Output) -> dict[str, _Rule]:
    return (RULES if output == "setpoints" else TARGET_RULES)[autopilot_kind]


def parameter_names(autopilot_kind: AutopilotKind, output: Output = "setpoints") -> tuple[str, ...]:
    """Those to read, by the names of all versions: only one of each answers. A judge may need others, too."""
    judged = [name for first in _rules(autopilot_kind, output) for name in _names(autopilot_kind, first)]
    if output == "landing_target":
        return tuple(judged)
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
    for first in _rules(kind, wanted.config.control.output):
        names = _names(kind, first)
        reported = [name for name in names if values.get(name) is not None]
        if not reported and first in PROFILES[kind].loss_parameters:
            why = "an answer: what it does when setpoints stop is not known; control is refused"
            found.append(_GROUP.fail(first, "the autopilot does not report it", f"expected {why}"))
            continue
        found += [_finding(name, values.get(name), names[name].judge, wanted) for name in reported or [first]]
    return found


def _finding(name: str, value: float | None, judge: _Judge, wanted: Wanted) -> Finding:
    if value is None:
        return _GROUP.skip(name, "the autopilot does not report it: another version's name, or a slow link")
    verdict = judge(value, wanted)
    if verdict is None:
        return _GROUP.ok(name, f"{value:g}")
    return Finding(GROUP, name, verdict[0], f"{value:g}", verdict[1])


# ---------------------------------------------------------------- as a file

_REAL: Final = mavlink.MAV_PARAM_TYPE_REAL32

HEADER: Final = f"""\
# companion {__version__}: the autopilot's parameters that differ from what a landing needs, and why.
# QGroundControl: Vehicle Setup, Parameters, Tools, Load from file.
# Mission Planner: Config, Full Parameter List, Load from file, Write Params.
# Each parameter stands here in the form of the one and in that of the other.
"""


def with_change(finding: Finding, read: ParameterReadings, wanted: Wanted) -> Finding:
    """The finding about a parameter; of one that differs with what it is to become."""
    value = read.values.get(finding.name)
    if value is None or finding.state not in {FindingState.WARNING, FindingState.FAIL}:
        return finding
    rule = _BY_NAME.get(finding.name)
    expected = None if rule is None or rule.target is None else rule.target(value, wanted, read)
    mav_type = read.types.get(finding.name, _REAL)
    return replace(finding, change=ParameterChange(read.system_id, value, expected, mav_type))


def parameters_read(findings: Sequence[Finding]) -> bool:
    return any(item.group == GROUP and item.state is not FindingState.NOT_CHECKED for item in findings)


def parameter_file(findings: Sequence[Finding]) -> str:
    """The text of the file; a parameter without an expected value is a comment alone."""
    changed = [(finding, finding.change) for finding in findings if finding.change is not None]
    text = HEADER + ("" if changed else "# no parameter differs\n")
    for finding, change in changed:
        lead = f"{finding.name} is {change.value:g}"
        if change.expected is None:
            text += f"#\n# not set here: {lead}; {finding.hint}\n"
            continue
        value = f"{change.expected:.9g}"
        text += f"#\n# {lead}; {finding.hint}\n"
        text += f"{change.system_id}\t{AUTOPILOT_COMPONENT}\t{finding.name}\t{value}\t{change.mav_type}\n"
        text += f"{finding.name},{value}\n"
    return text
