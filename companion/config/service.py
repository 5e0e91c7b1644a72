"""Settings of the service: the orders that a companion in standby takes, and the live page."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, field_validator

from companion.config.reading import StrictModel

ModeName = Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_.]*$", max_length=32)]
ADDRESS_FORM: Final = "ADDRESS:PORT, for example 127.0.0.1:8080 or [::1]:8080"
FAILSAFE_MODES: Final = frozenset({"RTL", "SMART_RTL", "LAND", "PRECLAND", "BRAKE"})
LOCALHOST: Final = "localhost"


class OrdersConfig(StrictModel):
    """Who may ask for a landing; whatever is left out asks for nothing. See docs/service.md."""

    mavlink: bool = True  # MAV_CMD_NAV_LAND, MAV_CMD_DO_LAND_START and MAV_CMD_USER_1 from the ground station
    rc_channel: int | None = Field(default=None, ge=1, le=18)  # rising above `rc_on_us` asks, falling stops
    rc_on_us: int = Field(default=1700, ge=1000, le=2000)  # µs
    flight_mode: ModeName | None = None  # entered by the pilot, it asks for a landing
    mission_item: int | None = Field(default=None, ge=0, le=65535)  # reached, it asks for a landing

    @field_validator("flight_mode")
    @classmethod
    def _a_pilot_alone_chooses_it(cls, mode: str | None) -> str | None:
        if mode is not None and mode.removeprefix("AUTO.") in FAILSAFE_MODES:
            raise ValueError(f"{mode} is what failsafes choose; expected a mode that a pilot alone enters")
        return mode


class ServeConfig(StrictModel):
    """Who may look at the app with a browser; without an address nobody. See docs/live-page.md."""

    address: str | None = None
    token_file: Path | None = None
    allow_commands: bool = False
    host_names: tuple[str, ...] = Field(default=(), max_length=16)
    rate_hz: float = Field(default=10.0, ge=1.0, le=30.0)
    most_viewers: int = Field(default=4, ge=1, le=16)

    @field_validator("address")
    @classmethod
    def _address_is_one(cls, text: str | None) -> str | None:
        if text is not None:
            host_and_port(text)
        return text


def host_and_port(address: str) -> tuple[str, int]:
    """The parts of ADDRESS:PORT; port 0 is any that is free.

    Raises:
        ValueError: it is not of that form.
    """
    host, _, digits = address.rpartition(":")
    port = int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 6 else -1
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not 0 <= port <= 65535 or (":" in bare and bare == host) or not (bare == LOCALHOST or is_ip(bare)):
        raise ValueError(f"expected {ADDRESS_FORM}")
    return bare, port


def is_ip(host: str) -> bool:
    """Whether it is an IP address, of either kind."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    return host == LOCALHOST or ipaddress.ip_address(host).is_loopback
