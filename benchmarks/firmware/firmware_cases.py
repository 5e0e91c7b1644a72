"""The flights of `bench_firmware`: landings on the real PX4 and the real ArduCopter.

Calm air and lines, a circle and a figure-8; 8 m/s of wind with Dryden turbulence of moderate intensity
(MIL-F-8785C); a sea. Each under both kinds of setpoint that the autopilot may be sent.

As built, the firmware is told the hover thrust that the builder believed; as believed, it is told none and
begins with its own default, so that neither bench gives it the truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import yaml

from companion.base.autopilot_kind import AutopilotKind
from sitl.campaign.manifest import CampaignRun, code_digest, scenario_digest
from sitl.firmware.spec import FirmwareSpec
from sitl.scenario.scenario import Scenario

Sensors = Literal["boards", "autopilot"]
MEET: Final = {"point_ned_m": [10.0, 0.0], "time_s": 22.0, "spread_m": 2.0}
PASS: Final = {"lateral_error_m": 0.15, "vertical_speed_m_s": 0.5, "horizontal_speed_m_s": 0.3}
WIND: Final = {"mean_m_s": 8.0, "turbulence": "moderate"}
CALM: Final[dict[str, Any]] = {"mean_m_s": 0.0}
# what each is sent by default first; velocities to ArduPilot are no part of what has to land
SETPOINTS: Final[dict[AutopilotKind, tuple[str, ...]]] = {
    "px4": ("acceleration", "attitude"),
    "ardupilot": ("attitude",),
}


@dataclass(frozen=True, slots=True)
class FirmwareCase:
    """Landings that are judged together."""

    name: str
    windy: bool
    pad: dict[str, Any]

    def scenario(
        self, kind: AutopilotKind, setpoint: str, sensors: Sensors = "boards", *, as_built: bool = False
    ) -> dict[str, Any]:
        """The scenario as its file has it; `sensors`: IMU, compass and GPS of whom the app flies by."""
        return {
            **({"as_built": {}} if as_built else {}),
            "name": self.title(kind, setpoint, sensors, as_built=as_built),
            "description": f"{self.name} on the real {kind}, by {setpoint} setpoints",
            "time_limit_s": 120.0,
            "autopilot": kind,
            "pad": self.pad,
            "wind": WIND if self.windy else CALM,
            "pass": PASS,
            "companion": {
                "sense": {"source": sensors, "autopilot": {"range_source": "boards"}},
                "control": {"setpoint": setpoint},
                "plan": {"mission": {"waypoint_ned_m": [10.0, 0.0]}},
            },
        }

    def title(self, kind: AutopilotKind, setpoint: str, sensors: Sensors, *, as_built: bool = False) -> str:
        """The scenario's name."""
        said = (*(["telemetry"] if sensors == "autopilot" else ()), *(["as_built"] if as_built else ()))
        return "-".join((kind, setpoint, *said, self.name))


def _line(speed_m_s: float) -> dict[str, Any]:
    return {"surface_height_m": 0.3, "motion": {"kind": "line", "speed_m_s": speed_m_s, "meet": MEET}}


_CIRCLE: Final = {"kind": "circle", "speed_m_s": 1.5, "radius_m": 5.0, "meet": MEET}
_FIGURE_8: Final = {"kind": "figure_8", "speed_m_s": 2.0, "half_length_m": 12.0, "meet": MEET}
_HEAVE: Final = {
    "kind": "heave", "significant_height_m": 0.5, "peak_period_s": 5.0, "surge_share": 0.3,
    "drift_speed_m_s": 0.2, "meet": MEET,
}  # fmt: skip

# as the firmwares come, for vehicles that are as believed: nobody gives the bench the truth
OWN_HOVER_THRUST: Final[dict[AutopilotKind, tuple[str, float]]] = {
    "px4": ("MPC_THR_HOVER", 0.5),
    "ardupilot": ("MOT_THST_HOVER", 0.35),
}

CASES: Final = (
    FirmwareCase("static", False, {"surface_height_m": 0.1, "motion": {"kind": "static", "meet": MEET}}),
    FirmwareCase("line_1", False, _line(1.0)),
    FirmwareCase("line_4.2", False, _line(4.2)),
    FirmwareCase("circle_1.5", False, {"surface_height_m": 0.3, "motion": _CIRCLE}),
    FirmwareCase("figure_8_2", False, {"surface_height_m": 0.3, "motion": _FIGURE_8}),
    FirmwareCase("line_2_wind_8", True, _line(2.0)),
    FirmwareCase("circle_1.5_wind_8", True, {"surface_height_m": 0.3, "motion": _CIRCLE}),
    FirmwareCase("heave", False, {"surface_height_m": 1.0, "motion": _HEAVE}),
)


def write_flights(
    firmware: FirmwareSpec,
    setpoint: str,
    sensors: Sensors,
    cases: tuple[FirmwareCase, ...],
    seeds: range,
    folder: Path,
    *,
    as_built: bool = False,
) -> Iterator[CampaignRun]:
    """The flights of one firmware by one kind of setpoint; their scenarios are left in a folder."""
    code = code_digest()
    if not as_built:
        told = (OWN_HOVER_THRUST[firmware.kind], *firmware.parameters)
        firmware = replace(firmware, parameters=told)
    for case in cases:
        content = case.scenario(firmware.kind, setpoint, sensors, as_built=as_built)
        scenario = Scenario.model_validate(content)
        path = folder / f"{scenario.name}.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        identity = f"{code}-{scenario_digest(str(path), None)}"
        for seed in seeds:
            yield CampaignRun(
                scenario.name, str(path), seed, None, scenario.time_limit_s, identity, firmware=firmware
            )
