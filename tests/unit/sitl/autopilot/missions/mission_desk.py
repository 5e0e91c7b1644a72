"""A ground station's side of the mission protocol, for tests: uploads, downloads, and items by hand."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight

RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
NANS = (math.nan,) * 7


class Station:
    """A flight with its endpoint, and a ground station (system 255) at the other end."""

    def __init__(self, autopilot_kind: AutopilotKind, booted_s: float = 6.0, rate_hz: int = 20) -> None:
        self.autopilot_kind, self.rate_hz = autopilot_kind, rate_hz
        self.flight = AutopilotFlight(autopilot_kind)
        self.endpoint = MavlinkEndpoint(self.flight.autopilot)
        self.us = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.parser = mavlink.MAVLink(None)
        self.heard: list[Any] = []
        self.run(booted_s)

    def run(self, seconds: float) -> list[Any]:
        """Step on; returns the messages heard meanwhile."""
        new: list[Any] = []
        for _ in range(max(1, round(seconds * self.rate_hz))):
            self.flight.run(1.0 / self.rate_hz)
            new += self.parser.parse_buffer(self.endpoint.transmit(self.flight.now_s)) or []
        self.heard += new
        return new

    def send(self, message: Any) -> list[Any]:
        """Send one message; returns the answers to it (telemetry left out)."""
        self.endpoint.receive(bytes(message.pack(self.us)), self.flight.now_s)
        new = self.parser.parse_buffer(self.endpoint.transmit(self.flight.now_s)) or []
        self.heard += new
        return [m for m in new if m.get_type() in ANSWERS]

    def command(self, number: int, *parameters: float) -> int:
        """Send a COMMAND_LONG; returns the result in its COMMAND_ACK."""
        filled = (*parameters, *NANS[len(parameters) :])
        return self.result(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))

    def result(self, command: Any) -> int:
        """Send a COMMAND_LONG or COMMAND_INT; returns the result in its COMMAND_ACK."""
        return int(next(m for m in self.send(command) if m.get_type() == "COMMAND_ACK").result)

    def upload(self, items: list[Any], mission_type: int = 0) -> int:
        """A whole upload as the protocol has it; returns the MISSION_ACK's result."""
        answers = self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), mission_type))
        while answers and answers[-1].get_type().startswith("MISSION_REQUEST"):
            answers = self.send(items[answers[-1].seq])
        return int(answers[-1].type)

    def download(self, mission_type: int = 0) -> list[Any]:
        """All items."""
        count = self.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type))[-1].count
        return [
            self.send(mavlink.MAVLink_mission_request_int_message(1, 1, number, mission_type))[-1]
            for number in range(count)
        ]

    @property
    def first(self) -> int:
        """The number of a mission's first item: ArduPilot's item 0 is home."""
        return 1 if self.autopilot_kind == "ardupilot" else 0

    def mission(self, items: list[Any]) -> list[Any]:
        """Numbered items, after home where that is item 0."""
        listed = [item(16)] * self.first + items
        for number, each in enumerate(listed):
            each.seq = number
        return listed

    def fly(self, items: list[Any]) -> None:
        """Upload, arm and start; home goes first where it has to."""
        assert self.upload(self.mission(items)) == 0
        if self.autopilot_kind == "ardupilot":
            assert self.flight.autopilot.set_mode(4) == 0
            assert self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        assert self.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == 0

    @property
    def texts(self) -> list[str]:
        """What the autopilot has said, over the link or before it got there."""
        return self.flight.texts + [m.text for m in self.heard if m.get_type() == "STATUSTEXT"]

    def reached(self) -> list[int]:
        """Numbers in the MISSION_ITEM_REACHED heard."""
        return [m.seq for m in self.heard if m.get_type() == "MISSION_ITEM_REACHED"]


def of(messages: list[Any], name: str) -> list[Any]:
    """Those of a type."""
    return [message for message in messages if message.get_type() == name]


ANSWERS = {
    "COMMAND_ACK",
    "PARAM_VALUE",
    "MISSION_ACK",
    "MISSION_COUNT",
    "MISSION_CURRENT",
    "MISSION_ITEM",
    "MISSION_ITEM_INT",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
}


def item(
    command: int,
    north_m: float = 0.0,
    east_m: float = 0.0,
    height_m: float = 0.0,
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, math.nan),
    **other: int,
) -> Any:
    """A MISSION_ITEM_INT at so many metres from home."""
    latitude = HOME[0] + north_m / 111_170.0
    longitude = HOME[1] + east_m / 76_056.0
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, other.get("seq", 0), other.get("frame", RELATIVE), command, 0, 1, *parameters,
        round(latitude * 1e7), round(longitude * 1e7), height_m, other.get("mission_type", 0),
    )  # fmt: skip


def plain(command: int, *parameters: float) -> Any:
    """An item that has no place."""
    filled = (*parameters, 0.0, 0.0, 0.0, 0.0)[:4]
    return mavlink.MAVLink_mission_item_int_message(1, 1, 0, 2, command, 0, 1, *filled, 0, 0, 0.0, 0)


WAYPOINT, TAKE_OFF, LAND, RETURN = 16, 22, 21, 20
