"""What the app is plugged into: opening the ports, buses and cameras that the settings name."""

from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

from companion.app.devices import (
    AwaitedBus,
    AwaitedPort,
    AwaitedTransport,
    ClosableBus,
    SerialLine,
    opened_if_there,
)
from companion.app.service.autopilot_lock import only_app_at
from companion.app.service.stamp_file import StampFile
from companion.base.clock import Clock, unix_time_s
from companion.base.errors import DeviceMissing
from companion.config import CameraConfig, CompanionConfig, LinkConfig, RangeConfig, find_file, load_model
from companion.control.setpoints import resolved
from companion.link.actions.actions import PymavlinkActions, VehicleActions
from companion.link.session import Session
from companion.link.signing import LinkSigning, signing_of
from companion.link.transport import Transport, memory_pair, open_transport
from companion.sense.camera.source import FrameSource, keep_camera
from companion.sense.imu.i2c import RegisterBus, open_bus
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.ultrasonic import RANGE_BAUD
from companion.sense.serial_port import SerialPort

ActionsFactory = Callable[[Session, Callable[[bytes], None], Clock, CompanionConfig], VehicleActions]


@dataclass(frozen=True, slots=True)
class Hardware:
    """What the app is plugged into; the simulator gives the same interfaces as the vehicle.

    A board is None when the autopilot's own sensor takes its place.
    """

    transport: Transport
    frames: FrameSource
    imu_bus: RegisterBus | None = None
    gps_port: SerialLine | None = None
    range_port: SerialLine | EchoPins | None = None
    signing: LinkSigning | None = None
    stamp_file: StampFile | None = None


@asynccontextmanager
async def open_hardware(
    config: CompanionConfig, *, linked: bool = True, waits: bool = False, state: Path | None = None
) -> AsyncIterator[Hardware]:
    """Open what the settings name, and close it again at the end.

    Not `linked`, the line to the autopilot stays closed, and nothing ever comes over it. With `waits` a
    device that is missing is opened as soon as it is there. In the folder `state` the last stamp of a signed
    link is kept.

    Raises:
        ConfigError: a port, bus or camera is taken or misspelt, or missing, or another app on this machine is
            at the autopilot; one line says which.
    """
    camera = load_model(CameraConfig, find_file("cameras", config.camera))
    sense = config.sense
    with ExitStack() as opened:
        link = config.link
        stamp_file = None if state is None or link.signing_key is None else StampFile(state)
        signing = signing_of(link, unix_time_s(), 0 if stamp_file is None else stamp_file.read())
        transport: Transport = memory_pair()[0]
        if linked:
            opened.enter_context(only_app_at(link.connection))
            transport = opened.enter_context(closing(await _open_line(link, signing, waits=waits)))
        imu_bus: RegisterBus | None = None
        gps_port: SerialLine | None = None
        range_port: SerialLine | EchoPins | None = None
        if sense.source == "boards":
            imu_bus = opened.enter_context(closing(_open_bus(sense.imu.bus, waits=waits)))
            gps_port = opened.enter_context(closing(_open_port(sense.gps.port, sense.gps.baud, waits=waits)))
        if not sense.range_by_telemetry:
            range_port = opened.enter_context(closing(_open_range_port(sense.range, waits=waits)))
        vision = sense.vision
        frames = opened.enter_context(
            closing(await keep_camera(vision.source, camera, vision.unstamped_latency_s, waits=waits))
        )
        yield Hardware(transport, frames, imu_bus, gps_port, range_port, signing, stamp_file)


async def _open_line(config: LinkConfig, signing: LinkSigning | None, *, waits: bool) -> Transport:
    open_line = partial(open_transport, config.connection, config.system_id, signing)
    try:
        line = await open_line()
    except DeviceMissing:
        if not waits:
            raise
        line = None
    return AwaitedTransport(line, open_line) if waits else cast(Transport, line)


def _open_bus(spec: str, *, waits: bool) -> ClosableBus:
    bus = opened_if_there(partial(open_bus, spec), waits=waits)
    return AwaitedBus(bus, partial(open_bus, spec)) if waits else cast(ClosableBus, bus)


def _open_port(path: str, baud: int, *, waits: bool) -> SerialLine:
    open_port = partial(SerialPort, path, baud)
    port = opened_if_there(open_port, waits=waits)
    return AwaitedPort(port, open_port) if waits else cast(SerialLine, port)


def _open_range_port(config: RangeConfig, *, waits: bool) -> SerialLine | EchoPins:
    if config.kind == "gpio":
        return EchoPins(config.trigger_pin, config.echo_pin, Clock())
    return _open_port(config.port, RANGE_BAUD, waits=waits)


def make_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: CompanionConfig
) -> VehicleActions:
    """Actions by what `link.actions` names.

    Raises:
        ModuleNotFoundError: MAVSDK, if it was left out of the installation.
    """
    # what asks for nothing needs no MAVSDK
    if config.link.actions == "pymavlink" or config.control.output == "landing_target":
        return make_own_actions(session, send, clock, config)
    from companion.link.actions.mavsdk_link import MavsdkActions  # noqa: PLC0415 - may be left out

    return MavsdkActions(session, send, clock, config.link, attitude_setpoints=_sends_attitudes(config))


def make_own_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: CompanionConfig
) -> VehicleActions:
    """Actions by our own session whatever is named, for virtual time."""
    return PymavlinkActions(session, send, clock, config.link, attitude_setpoints=_sends_attitudes(config))


def _sends_attitudes(config: CompanionConfig) -> bool:
    """Whether an ArduPilot, for which it matters, gets attitudes."""
    return resolved(config.control, "ardupilot").setpoint == "attitude"
