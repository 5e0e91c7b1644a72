"""Settings of the orders that a companion in standby takes."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from companion.config.reading import StrictModel

ModeName = Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_.]*$", max_length=32)]


class OrdersConfig(StrictModel):
    """Who may ask for a landing; whatever is left out asks for nothing. See docs/service.md."""

    mavlink: bool = True  # MAV_CMD_NAV_LAND, MAV_CMD_DO_LAND_START and MAV_CMD_USER_1 from the ground station
    rc_channel: int | None = Field(default=None, ge=1, le=18)  # rising above `rc_on_us` asks, falling stops
    rc_on_us: int = Field(default=1700, ge=1000, le=2000)  # µs
    flight_mode: ModeName | None = None  # entered by the pilot, it asks for a landing
    mission_item: int | None = Field(default=None, ge=0, le=65535)  # reached, it asks for a landing
