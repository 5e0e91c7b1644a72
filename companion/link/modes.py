"""Flight modes by MAVLink's numbers and by the names that people know, from the autopilots' profiles."""

from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES

_NAMES: Final = {
    kind: {number: name for name, number in profile.modes.items()} for kind, profile in PROFILES.items()
}


def custom_mode(autopilot_kind: AutopilotKind, mode: str) -> int:
    """HEARTBEAT.custom_mode of a named mode.

    Raises:
        KeyError: the autopilot has no such mode.
    """
    return PROFILES[autopilot_kind].modes[mode]


def mode_name(autopilot_kind: AutopilotKind, mode: int) -> str:
    """Name of HEARTBEAT.custom_mode; "mode N" when it is none of the profile's."""
    names, main_mode_bits = _NAMES[autopilot_kind], PROFILES[autopilot_kind].main_mode_bits
    main_mode = mode & main_mode_bits if main_mode_bits else mode
    return names.get(mode) or names.get(main_mode, f"mode {mode}")


def mode_parameters(autopilot_kind: AutopilotKind, mode: str) -> tuple[float, float, float]:
    """The first three parameters of MAV_CMD_DO_SET_MODE: custom mode enabled, (main) mode, sub mode."""
    number = custom_mode(autopilot_kind, mode)
    if not PROFILES[autopilot_kind].main_mode_bits:
        return (1.0, float(number), 0.0)
    return (1.0, float(number >> 16 & 0xFF), float(number >> 24))
