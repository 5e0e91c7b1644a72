"""Flight modes of PX4 and ArduCopter: MAVLink's numbers and the names that people know.

PX4's custom mode holds a main mode in bits 16-23 and a sub mode in bits 24-31 (px4_custom_mode.h);
ArduCopter's is a plain number (COPTER_MODE of MAVLink's ardupilotmega dialect).
"""

from __future__ import annotations

from typing import Final

from companion.base.autopilot_kind import AutopilotKind

PX4_MODES: Final[dict[str, tuple[int, int]]] = {  # main and sub mode (px4_custom_mode.h)
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "AUTO.READY": (4, 1),
    "AUTO.TAKEOFF": (4, 2),
    "AUTO.LOITER": (4, 3),
    "AUTO.MISSION": (4, 4),
    "AUTO.RTL": (4, 5),
    "AUTO.LAND": (4, 6),
    "AUTO.FOLLOW_TARGET": (4, 8),
    "AUTO.PRECLAND": (4, 9),
    "ACRO": (5, 0),
    "OFFBOARD": (6, 0),
    "STABILIZED": (7, 0),
}
ARDUCOPTER_MODES: Final[dict[str, int]] = {  # COPTER_MODE
    "STABILIZE": 0,
    "ACRO": 1,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "CIRCLE": 7,
    "LAND": 9,
    "POSHOLD": 16,
    "BRAKE": 17,
    "GUIDED_NOGPS": 20,
    "SMART_RTL": 21,
}
CONTROL_MODE: Final[dict[AutopilotKind, str]] = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
# ArduPilot's LOITER reads the pilot's sticks, and without a radio it sinks: BRAKE stops and holds
HOLD_MODE: Final[dict[AutopilotKind, str]] = {"px4": "AUTO.LOITER", "ardupilot": "BRAKE"}
LAND_MODE: Final[dict[AutopilotKind, str]] = {"px4": "AUTO.LAND", "ardupilot": "LAND"}

# flown by hand: once one of these is received, another pilot has the vehicle
STICK_MODES: Final[dict[AutopilotKind, frozenset[str]]] = {
    "px4": frozenset({"MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"}),
    "ardupilot": frozenset({"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "POSHOLD"}),
}

_PX4_NAMES: Final = {(main << 16) | (sub << 24): name for name, (main, sub) in PX4_MODES.items()}
_ARDUCOPTER_NAMES: Final = {number: name for name, number in ARDUCOPTER_MODES.items()}


def custom_mode(autopilot_kind: AutopilotKind, mode: str) -> int:
    """HEARTBEAT.custom_mode of a named mode.

    Raises:
        KeyError: the autopilot has no such mode.
    """
    if autopilot_kind == "ardupilot":
        return ARDUCOPTER_MODES[mode]
    main, sub = PX4_MODES[mode]
    return (main << 16) | (sub << 24)


def mode_name(autopilot_kind: AutopilotKind, mode: int) -> str:
    """Name of HEARTBEAT.custom_mode; "mode N" when it is none of the tables'."""
    if autopilot_kind == "ardupilot":
        return _ARDUCOPTER_NAMES.get(mode, f"mode {mode}")
    # only PX4's POSCTL and VTOL modes use sub modes outside AUTO: they fall back to their main mode
    return _PX4_NAMES.get(mode) or _PX4_NAMES.get(mode & 0xFF0000, f"mode {mode}")


def mode_parameters(autopilot_kind: AutopilotKind, mode: str) -> tuple[float, float, float]:
    """The first three parameters of MAV_CMD_DO_SET_MODE: custom mode enabled, mode, PX4's sub mode."""
    if autopilot_kind == "ardupilot":
        return (1.0, float(ARDUCOPTER_MODES[mode]), 0.0)
    main, sub = PX4_MODES[mode]
    return (1.0, float(main), float(sub))
