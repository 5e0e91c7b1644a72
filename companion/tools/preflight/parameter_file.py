"""The autopilot's parameters that differ, as a file that QGroundControl and Mission Planner both load. Pure.

QGroundControl takes lines of five columns between tabs (system, component, name, value, MAV_PARAM_TYPE) and
skips others; Mission Planner takes lines of a name and a value (`NAME,VALUE`) and skips others, so that each
parameter stands in both forms. Both skip what begins with '#'. Sources: QGroundControl, "Parameters, file
format", and its ParameterManager; Mission Planner, ParamFile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from companion import __version__
from companion.link.autopilot_setup import CIRCLE_FENCE
from companion.link.codec import AUTOPILOT_COMPONENT, mavlink
from companion.link.parameters import GUIDED_OPTIONS, THRUST_IS_THRUST
from companion.tools.preflight.findings import Finding, FindingState, ParameterChange
from companion.tools.preflight.parameters import GROUP, Wanted

# PX4's COM_OBL_RC_ACT, and how long it may fly on the last setpoint: docs/reference/autopilot-parameters.md
_HOLD, _LAND, _LAND_TIMEOUT_S, _HOLD_TIMEOUT_S = 5.0, 4, 0.5, 1.0
_OVERRIDE_OFFBOARD, _EXCEPT_OFFBOARD, _CONTINUE_GUIDED = 2, 4, 4
_REAL: Final = mavlink.MAV_PARAM_TYPE_REAL32

HEADER: Final = f"""\
# companion {__version__}: the autopilot's parameters that differ from what a landing needs, and why.
# QGroundControl: Vehicle Setup, Parameters, Tools, Load from file.
# Mission Planner: Config, Full Parameter List, Load from file, Write Params.
# Each parameter stands here in the form of the one and in that of the other.
"""


@dataclass(frozen=True, slots=True)
class ParameterReadings:
    """What the autopilot reported: its system id; values and MAV_PARAM_TYPE by name."""

    system_id: int
    values: Mapping[str, float | None]
    types: Mapping[str, int]


_Target = Callable[[float, Wanted, ParameterReadings], float]


def _to(value: float) -> _Target:
    return lambda _value, _wanted, _read: value


def _bits(set_: int = 0, cleared: int = 0) -> _Target:
    return lambda value, _wanted, _read: float((int(value) | set_) & ~cleared)


def _offboard_timeout(_value: float, _wanted: Wanted, read: ParameterReadings) -> float:
    return _LAND_TIMEOUT_S if read.values.get("COM_OBL_RC_ACT") == _LAND else _HOLD_TIMEOUT_S


# What a parameter that differs is set to: the expected value nearest to the firmware's default. The hover
# thrust has none: either the autopilot's or the vehicle file's is wrong, and only a hover tells which.
TARGETS: Final[dict[str, _Target]] = {
    "COM_OF_LOSS_T": _offboard_timeout,
    "COM_OBL_RC_ACT": _to(_HOLD),
    "COM_RC_OVERRIDE": _bits(set_=_OVERRIDE_OFFBOARD),
    "COM_RCL_EXCEPT": _bits(cleared=_EXCEPT_OFFBOARD),
    "COM_DISARM_LAND": _to(2.0),
    "MPC_TILTMAX_AIR": lambda _value, wanted, _read: wanted.tilt_deg,
    "MPC_USE_HTE": _to(1.0),
    "MPC_Z_VEL_MAX_DN": lambda _value, wanted, _read: wanted.descent_m_s,
    "MPC_Z_VEL_MAX_UP": lambda _value, wanted, _read: wanted.climb_m_s,
    "GUID_TIMEOUT": _to(1.0),
    "FENCE_ENABLE": _to(1.0),
    "FENCE_TYPE": _bits(set_=CIRCLE_FENCE),
    "FENCE_ACTION": _to(1.0),
    GUIDED_OPTIONS: _bits(set_=THRUST_IS_THRUST),
    # the second name and unit of each pair: from ArduCopter 4.7 on
    "ANGLE_MAX": lambda _value, wanted, _read: float(math.ceil(100.0 * wanted.tilt_deg - 1e-6)),
    "ATC_ANGLE_MAX": lambda _value, wanted, _read: wanted.tilt_deg,
    "FS_THR_ENABLE": _to(1.0),
    "FS_OPTIONS": _bits(cleared=_CONTINUE_GUIDED),
    "DISARM_DELAY": _to(10.0),
    "LAND_SPEED": _to(50.0),
    "LAND_SPD_MS": _to(0.5),
    "WPNAV_ACCEL": _to(250.0),
    "WP_ACC": _to(2.5),
    "PSC_JERK_XY": _to(5.0),
    "PSC_NE_JERK": _to(5.0),
}


def with_changes(findings: Sequence[Finding], read: ParameterReadings, wanted: Wanted) -> list[Finding]:
    """The findings about parameters; those that differ with what the parameter is to become."""
    return [_with_change(finding, read, wanted) for finding in findings]


def _with_change(finding: Finding, read: ParameterReadings, wanted: Wanted) -> Finding:
    value = read.values.get(finding.name)
    if value is None or finding.state not in {FindingState.WARNING, FindingState.FAIL}:
        return finding
    target = TARGETS.get(finding.name)
    expected = None if target is None else target(value, wanted, read)
    mav_type = read.types.get(finding.name, _REAL)
    return replace(finding, change=ParameterChange(read.system_id, value, expected, mav_type))


def parameters_read(findings: Sequence[Finding]) -> bool:
    """Whether the autopilot reported any parameter."""
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
