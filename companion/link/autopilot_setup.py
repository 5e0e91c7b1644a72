"""Those of the autopilot's parameters on which our loop depends: read, never written. Pure."""

from __future__ import annotations

from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.messages import AutopilotSetup
from companion.link.parameters import ParameterRequest, ParameterRequests

NAMES: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "px4": ("MPC_TILTMAX_AIR", "MPC_THR_HOVER"),
    "ardupilot": ("ANGLE_MAX", "WPNAV_ACCEL", "PSC_JERK_XY", "MOT_THST_HOVER"),
}
_CENTI: Final = 0.01


class SetupReader:
    """Asks for them all at once; `setup` is None until each has been answered or given up."""

    def __init__(self, requests: ParameterRequests) -> None:
        self._requests = requests
        self._autopilot_kind: AutopilotKind | None = None
        self._asked: dict[str, ParameterRequest] = {}

    def begin(self, autopilot_kind: AutopilotKind | None) -> None:
        """An autopilot has been received; another one is asked again."""
        if autopilot_kind is None or autopilot_kind == self._autopilot_kind:
            return
        self._autopilot_kind = autopilot_kind
        self._asked = {name: ParameterRequest(name) for name in NAMES[autopilot_kind]}
        for request in self._asked.values():
            self._requests.submit(request)

    @property
    def setup(self) -> AutopilotSetup | None:
        """What is known of it; a parameter that it does not have is unknown."""
        if self._autopilot_kind is None or any(request.outcome is None for request in self._asked.values()):
            return None
        value = {name: request.value for name, request in self._asked.items()}
        if self._autopilot_kind == "px4":
            return AutopilotSetup(tilt_deg=value["MPC_TILTMAX_AIR"], hover_thrust=value["MPC_THR_HOVER"])
        return AutopilotSetup(
            tilt_deg=_scaled(value["ANGLE_MAX"]),
            hover_thrust=value["MOT_THST_HOVER"],
            acceleration_m_s2=_scaled(value["WPNAV_ACCEL"]),
            jerk_m_s3=value["PSC_JERK_XY"],
        )


def _scaled(hundredths: float | None) -> float | None:
    return None if hundredths is None else _CENTI * hundredths
