"""Settings of the link to the autopilot."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from companion.config.reading import StrictModel

CONNECTION_FORM = re.compile(
    r"(?P<kind>udp|udpin|tcp):(?P<host>[^:\s]+):(?P<port>\d{1,5})|serial:(?P<path>/\S+):(?P<baud>\d{4,7})"
)


class LinkConfig(StrictModel):
    """The autopilot's port, who we are on it, and how long we wait.

    `connection` is serial:PATH:BAUD, udp:HOST:PORT (we call), udpin:HOST:PORT (we listen) or tcp:HOST:PORT
    (we call). `system_id` is the vehicle's and so ours; 0 takes the first autopilot heard. `component_id` is
    ours; MAVSDK, which speaks beside us, is another component. `force_disarm` allows disarming by force after
    a touchdown that several signs have confirmed for seconds while the autopilot's land detector still
    believes itself in the air, as it may on a pad that moves; never elsewhere. The pad's beacon is taken from
    `ground_system_id` alone, as the answer to our request or from its component `beacon_component_id`, and
    only when it is not faster than `maximum_pad_speed_m_s`. `set_parameters` allows setting the one autopilot
    parameter that we need: bit 3 of ArduPilot's GUID_OPTIONS, for attitude setpoints; without it control is
    refused while the bit is missing.
    """

    connection: str = "udpin:127.0.0.1:14540"
    actions: Literal["mavsdk", "pymavlink"] = "mavsdk"
    system_id: int = Field(default=1, ge=0, le=255)
    component_id: int = Field(default=191, ge=2, le=255)
    mavsdk_component_id: int = Field(default=192, ge=2, le=255)
    ground_system_id: int = Field(default=255, ge=1, le=255)
    beacon_component_id: int | None = Field(default=None, ge=1, le=255)
    maximum_pad_speed_m_s: float = Field(default=8.0, gt=0.0, le=30.0)
    heartbeat_timeout_s: float = Field(default=3.0, ge=1.0, le=30.0)
    command_timeout_s: float = Field(default=0.5, ge=0.1, le=5.0)
    command_tries: int = Field(default=4, ge=1, le=10)
    force_disarm: bool = True
    set_parameters: bool = False
    signing_key: Path | None = None

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
        if self.component_id == self.mavsdk_component_id:
            raise ValueError(
                f"expected mavsdk_component_id to differ from component_id, found {self.component_id} twice"
            )
        return self
