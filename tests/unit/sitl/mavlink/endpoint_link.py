"""The simulated autopilot's MAVLink port, spoken to in bytes as a companion or a ground station would."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
NANS = (math.nan,) * 7


class Link:
    """A flight with its endpoint, and a component at the other end."""

    def __init__(self, autopilot_kind: AutopilotKind, booted_s: float = 6.0) -> None:
        self.flight = AutopilotFlight(autopilot_kind)
        self.endpoint = MavlinkEndpoint(self.flight.autopilot)
        self.us = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self.parser = mavlink.MAVLink(None)
        self.heard: list[Any] = []
        self.run(booted_s)

    def run(self, seconds: float) -> list[Any]:
        """Step on, listening at 100 Hz; returns the messages heard meanwhile."""
        new: list[Any] = []
        for _ in range(round(seconds * 100)):
            data = self.endpoint.transmit(self.flight.now_s)
            new += self.parser.parse_buffer(data) or []
            self.flight.run(0.01)
        self.heard += new
        return new

    def send(self, message: Any) -> list[Any]:
        """Send one message; returns what comes back at once."""
        self.endpoint.receive(bytes(message.pack(self.us)), self.flight.now_s)
        return self.run(0.01)

    def command(self, number: int, *parameters: float, target: tuple[int, int] = (1, 1)) -> Any:
        """Send a COMMAND_LONG; returns its COMMAND_ACK, None when there is none."""
        filled = (*parameters, *NANS[len(parameters) :])
        answers = self.send(mavlink.MAVLink_command_long_message(*target, number, 0, *filled))
        return next((m for m in answers if m.get_type() == "COMMAND_ACK"), None)


def of(messages: list[Any], name: str) -> list[Any]:
    return [message for message in messages if message.get_type() == name]


def velocity_message(frame: int, mask: int, velocity: tuple[float, float, float]) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, 0, 0, 0, *velocity, 0, 0, 0, 0.0, 0.0
    )
