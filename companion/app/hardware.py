"""What the app is plugged into: opening the ports, buses and cameras that the settings name."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from typing import Protocol

from companion.base.clock import Clock
from companion.config import CameraConfig, CompanionConfig, RangeConfig, find_file, load_model
from companion.control.setpoints import resolved
from companion.link.actions.actions import PymavlinkActions, VehicleActions
from companion.link.actions.mavsdk_link import MavsdkActions
from companion.link.inbox import memory_pair
from companion.link.session import Session
from companion.link.transport import Transport, open_transport
from companion.sense.camera.source import FrameSource, keep_camera
from companion.sense.imu.i2c import RegisterBus, open_bus
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.range_finder import BytePort
from companion.sense.serial_port import SerialPort

ActionsFactory = Callable[[Session, Callable[[bytes], None], Clock, CompanionConfig], VehicleActions]


class BaudRatePort(BytePort, Protocol):
    """A serial line whose rate can be changed."""

    def set_baud(self, baud: int) -> None:
        """Change the rate. OSError when the line is gone."""
        ...

    def close(self) -> None:
        """Give the line back."""
        ...


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the app is plugged into; the simulator gives the same interfaces as the vehicle.

    A board is None when the autopilot's own sensor takes its place.
    """

    transport: Transport
    frames: FrameSource
    imu_bus: RegisterBus | None = None
    gps_port: BaudRatePort | None = None
    range_port: BaudRatePort | EchoPins | None = None


@asynccontextmanager
async def open_hardware(config: CompanionConfig, *, linked: bool = True) -> AsyncIterator[Hardware]:
    """Open what the settings name, and close it again at the end.

    Not `linked`, the line to the autopilot stays closed, and nothing ever comes over it.

    Raises:
        ConfigError: a port, bus or camera is missing, taken or misspelt; one line says which.
    """
    camera = load_model(CameraConfig, find_file("cameras", config.camera))
    sense = config.sense
    with ExitStack() as opened:
        link = config.link
        transport: Transport = memory_pair()[0]
        if linked:
            transport = opened.enter_context(closing(await open_transport(link.connection, link.system_id)))
        imu_bus: RegisterBus | None = None
        gps_port: BaudRatePort | None = None
        range_port: BaudRatePort | EchoPins | None = None
        if sense.source == "boards":
            imu_bus = opened.enter_context(closing(open_bus(sense.imu.bus)))
            gps_port = opened.enter_context(closing(SerialPort(sense.gps.port, sense.gps.baud)))
        if not sense.range_by_telemetry:
            range_port = opened.enter_context(closing(_open_range_port(sense.range)))
        vision = sense.vision
        frames = opened.enter_context(
            closing(await keep_camera(vision.source, camera, vision.unstamped_latency_s))
        )
        yield Hardware(transport, frames, imu_bus, gps_port, range_port)


def _open_range_port(config: RangeConfig) -> SerialPort | EchoPins:
    if config.kind == "gpio":
        return EchoPins(config.trigger_pin, config.echo_pin, Clock())
    return SerialPort(config.port, config.baud)


def make_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: CompanionConfig
) -> VehicleActions:
    """Actions by what `link.actions` names."""
    kind = MavsdkActions if config.link.actions == "mavsdk" else PymavlinkActions
    return kind(session, send, clock, config.link, attitude_setpoints=_sends_attitudes(config))


def make_own_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: CompanionConfig
) -> VehicleActions:
    """Actions by our own session whatever is named, for virtual time."""
    return PymavlinkActions(session, send, clock, config.link, attitude_setpoints=_sends_attitudes(config))


def _sends_attitudes(config: CompanionConfig) -> bool:
    """Whether an ArduPilot, for which it matters, gets attitudes."""
    return resolved(config.control, "ardupilot").setpoint == "attitude"
