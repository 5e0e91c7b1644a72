"""What both firmwares have in common, as the simulation sees them."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from companion.base.geometry import Vector3
from sitl.scenario.scenario import AirframeConfig
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors
from sitl.vehicle.quadrotor import Four, QuadrotorState

# an answer takes a fraction of a millisecond; a machine too busy for this one is hopeless
ANSWER_S: Final = 5.0


class Moment(NamedTuple):
    """The vehicle at one step, as its sensors have it; `clock_s` is the firmware's time."""

    clock_s: float
    sensors: SimulatedAutopilotSensors
    state: QuadrotorState


class Setup(NamedTuple):
    """What the firmware needs to know of the vehicle, set by parameters."""

    airframe: AirframeConfig  # as its builder believes it
    home: Vector3  # latitude (deg), longitude (deg), altitude (m AMSL) of the world's origin
    gps_delay_s: float
    parameters: dict[str, float]  # over all others
    rate_scale: float = 1.0  # what tuning has multiplied the rate loops' gains by


class Firmware(Protocol):
    """A running firmware in lockstep: time passes for it in `step` alone."""

    def step(self, moment: Moment) -> Four:
        """The motors' shares of full thrust (front, right, rear, left) until the next step.

        Raises:
            FirmwareError: it has ended or does not answer.
        """
        ...

    def read(self) -> list[bytes]:
        """Datagrams of MAVLink that it has sent since the last call."""
        ...

    def write(self, data: bytes) -> None:
        """A datagram of MAVLink for it."""
        ...

    def close(self) -> None:
        """End it."""
        ...
