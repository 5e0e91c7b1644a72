"""Settings of the link to the autopilot."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from companion.config.reading import OPERATOR, StrictModel

CONNECTION_FORM = re.compile(
    r"(?P<kind>udp|udpin|tcp):(?P<host>[^:\s]+):(?P<port>\d{1,5})|serial:(?P<path>/\S+):(?P<baud>\d{4,7})"
)


class LinkConfig(StrictModel):
    """The autopilot's port, who we are on it, and how long we wait."""

    connection: str = Field(default="udpin:127.0.0.1:14540", json_schema_extra=OPERATOR)
    """Link to the autopilot: `serial:PATH:BAUD`, `udp:HOST:PORT` or `tcp:HOST:PORT` (the app connects),
    `udpin:HOST:PORT` (the app listens); set it as wired"""
    actions: Literal["mavsdk", "pymavlink"] = Field(default="mavsdk")
    """Library for actions such as arming and take-off: MAVSDK or pymavlink; change it for signing, or to
    run without MAVSDK's server. Flights in real time use this setting; with `--fast` it is always
    pymavlink, since MAVSDK has threads and a clock of its own"""
    system_id: int = Field(default=1, ge=0, le=255)
    """System id of the vehicle, which the app uses too; 0 takes the first autopilot received. Set it when
    several vehicles share a link"""
    component_id: int = Field(default=191, ge=2, le=255)
    """Component id of the app; change it if another component has this id"""
    mavsdk_component_id: int = Field(default=192, ge=2, le=255)
    """Component id of MAVSDK; change it if another component has this id"""
    ground_system_id: int = Field(default=255, ge=1, le=255)
    """System id of the ground station; only its pad position reports are used; set it if your ground
    station does not use 255"""
    beacon_component_id: int | None = Field(default=None, ge=1, le=255)
    """Component id, in the ground station's system, whose FOLLOW_TARGET counts as the pad's position
    without a request. None: only an answer to the app's request, accepted by COMMAND_ACK, counts, since
    ground stations also stream their operator's position (Follow Me). Set it to that of a beacon that
    streams"""
    beacon_system_id: int | None = Field(default=None, ge=1, le=255)
    """System id on the pad whose GLOBAL_POSITION_INT is the pad's position (an autopilot or an RTK rover on
    the landing platform), as accurate as its GPS_RAW_INT says; then no FOLLOW_TARGET is used. None: there is
    no such system; set it to the id of the system on the pad"""
    maximum_pad_speed_m_s: float = Field(default=8.0, gt=0.0, le=30.0)
    """A pad position report with a greater speed is refused; raise it for faster pads"""
    heartbeat_timeout_s: float = Field(default=3.0, ge=1.0, le=30.0)
    """The link counts as lost after this time without a heartbeat. Longer is worse: the app flies on old
    telemetry. Raise it only on a radio that loses heartbeats"""
    command_timeout_s: float = Field(default=0.5, ge=0.1, le=5.0)
    """A command is repeated after this time without an answer; raise it on a slow radio"""
    command_tries: int = Field(default=4, ge=1, le=10)
    """Tries of a command before it is given up; raise it for a lossy link"""
    force_disarm: bool = Field(default=True)
    """Allow disarming by force, only if the autopilot refuses the plain disarming after a recent sighting or
    echo has shown the vehicle at rest for `land_after_s` (1 s; without the IMU 3 s), or while it lies on its
    side. Without it PX4 may stay armed on a moving pad. Turn it off if a pilot disarms"""
    set_parameters: bool = Field(default=False, json_schema_extra=OPERATOR)
    """Allow setting bit 3 of ArduPilot's GUID_OPTIONS, which attitude setpoints need; without it arming and
    control are refused while the bit is missing. Set it if you do not set the parameter yourself"""
    signing_key: Path | None = Field(default=None, json_schema_extra=OPERATOR)
    """File with the key of MAVLink 2 signing, mode 0600: 32 bytes or a passphrase. All frames sent are
    signed; received frames that are unsigned or repeated are refused; needs `actions: pymavlink`. Without
    it anyone who reaches the link can command the vehicle: set it on a radio or a network that others
    reach"""

    @field_validator("connection")
    @classmethod
    def _has_a_known_form(cls, value: str) -> str:
        form = CONNECTION_FORM.fullmatch(value)
        if form is None or not 1 <= int(form["port"] or 1) <= 65535:
            raise ValueError(
                "expected serial:PATH:BAUD, udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT with a port of "
                "1..65535, "
                f"found '{value}'"
            )
        return value

    @model_validator(mode="after")
    def _has_a_component_for_each(self) -> LinkConfig:
        if self.signing_key is not None and self.actions == "mavsdk":
            raise ValueError("signing_key: MAVSDK cannot sign; expected actions: pymavlink with it")
        others = {"the vehicle's": self.system_id, "the ground station's": self.ground_system_id}
        for whose, system_id in others.items():
            if self.beacon_system_id is not None and self.beacon_system_id == system_id:
                raise ValueError(
                    f"beacon_system_id: expected another system than {whose}, found {system_id} twice"
                )
        if self.component_id == self.mavsdk_component_id:
            raise ValueError(
                f"expected mavsdk_component_id to differ from component_id, found {self.component_id} twice"
            )
        return self
