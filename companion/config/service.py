"""Settings of the service: the orders that a companion in standby takes, its records, the live page."""

import ipaddress
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, field_validator

from companion.config.reading import OPERATOR, StrictModel


class RecordConfig(StrictModel):
    """What is looked at before a flight's log begins: the oldest flights are removed first."""

    total_mb: float = Field(default=8000.0, ge=100.0)
    """Size of all recorded flights together (10⁶ bytes); the oldest are removed before a flight's log
    begins, the newest is kept. A minute of flight takes about 25 MB. Raise it on a large disk, lower it on a
    small one"""
    free_mb: float = Field(default=1000.0, ge=0.0)
    """The oldest flights are also removed until this much is free on the disk; raise it if other programs
    need the disk"""


ModeName = Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_.]*$", max_length=32)]
ADDRESS_FORM: Final = "ADDRESS:PORT, for example 127.0.0.1:8080 or [::1]:8080"
FAILSAFE_MODES: Final = frozenset({"RTL", "SMART_RTL", "LAND", "PRECLAND", "BRAKE"})
LOCALHOST: Final = "localhost"


class OrdersConfig(StrictModel):
    """Who may ask for a landing; whatever is left out asks for nothing. See docs/how-to/service.md."""

    mavlink: bool = Field(default=True, json_schema_extra=OPERATOR)
    """Take MAV_CMD_NAV_LAND, MAV_CMD_DO_LAND_START and MAV_CMD_USER_1 from `link.ground_system_id` as
    orders; turn it off if others use the link without signing"""
    rc_channel: int | None = Field(default=None, ge=1, le=18, json_schema_extra=OPERATOR)
    """RC channel whose rise above `rc_on_us` orders a landing, and whose fall stops it; set it to a free
    switch"""
    rc_on_us: int = Field(default=1700, ge=1000, le=2000, json_schema_extra=OPERATOR)
    """Pulse width (µs) above which the switch is on; set it for your transmitter's switch"""
    flight_mode: ModeName | None = Field(default=None, json_schema_extra=OPERATOR)
    """Flight mode whose entry by the pilot, from a mode flown by hand, orders a landing, for example GUIDED
    on ArduPilot; not RTL, LAND or BRAKE; see docs/how-to/service.md; set it if the pilot has no free
    switch"""
    mission_item: int | None = Field(default=None, ge=0, le=65535, json_schema_extra=OPERATOR)
    """Number of the mission item that orders a landing when it is reached; set it to the last waypoint of
    your mission"""

    @field_validator("flight_mode")
    @classmethod
    def _a_pilot_alone_chooses_it(cls, mode: str | None) -> str | None:
        if mode is not None and mode.removeprefix("AUTO.") in FAILSAFE_MODES:
            raise ValueError(f"{mode} is what failsafes choose; expected a mode that a pilot alone enters")
        return mode


class ServeConfig(StrictModel):
    """Who may look at the app with a browser; without an address nobody. See docs/how-to/live-page.md."""

    address: str | None = Field(default=None, json_schema_extra=OPERATOR)
    """Address and port of the live page (docs/how-to/live-page.md), ADDRESS:PORT, an IP address or
    localhost; none: no page. `--serve` overrides it. Any address except loopback needs a token. Set it to
    watch every flight of the service"""
    token_file: Path | None = Field(default=None, json_schema_extra=OPERATOR)
    """File with the page's token, mode 0600; by default the environment variable COMPANION_SERVE_TOKEN is
    used. If there is a token, the page shows nothing without it. Set it if others can reach the network"""
    allow_commands: bool = Field(default=False, json_schema_extra=OPERATOR)
    """Whether the page has buttons to land and to stop; needs a token. Set it if an operator orders
    landings by the page"""
    host_names: tuple[str, ...] = Field(default=(), max_length=16)
    """Names by which browsers may address the page, besides IP addresses, localhost and the machine's own
    name; set it for a name of your own network"""
    rate_hz: float = Field(default=10.0, ge=1.0, le=30.0)
    """Pictures a second at most; lower it on a slow network"""
    most_viewers: int = Field(default=4, ge=1, le=16)
    """Largest number of browsers at once; more are refused; lower it for a slow computer or radio"""

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
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it."""
    return host == LOCALHOST or ipaddress.ip_address(host).is_loopback
