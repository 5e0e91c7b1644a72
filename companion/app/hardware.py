"""What the app is plugged into: opening the ports, buses and cameras that the settings name."""

import asyncio
import errno
import hashlib
import json
import os
import socket
import struct
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from companion.base.clock import Clock, unix_time_s
from companion.base.errors import ConfigError, DeviceMissing
from companion.base.files import cannot_read, write_durably
from companion.config import CameraConfig, CompanionConfig, LinkConfig, RangeConfig, find_file, load_model
from companion.control.setpoints import resolved
from companion.link.actions.actions import PymavlinkActions
from companion.link.session import Session
from companion.link.signing import NEW_STREAM_MAY_LAG_S, LinkSigning, signing_of
from companion.link.transport import Transport, memory_pair, open_transport
from companion.sense.camera.source import FrameSource, keep_camera
from companion.sense.imu.i2c import RegisterBus, open_bus
from companion.sense.range.echo_pins import EchoPins
from companion.sense.range.ultrasonic import RANGE_BAUD
from companion.sense.serial_port import SerialPort

# ---------------------------------------------------------------- the signatures' last stamp
# On disk, so that what was accepted before a restart is not again. A frame that was recorded and is sent
# again would be as good as new to a process that has just started: for a minute, and on a computer whose
# clock is behind for as long as that is. The file is written at each order and each new stream of the link,
# once a minute, and at the end.

STAMP_FILE_NAME: Final = "signing.json"


@dataclass(frozen=True, slots=True)
class StampFile:
    """The file in a folder, which is made."""

    folder: Path

    @property
    def path(self) -> Path:
        return self.folder / STAMP_FILE_NAME

    def read(self) -> int:
        """The last stamp; 0: there is none.

        Raises:
            ConfigError: there is a file, and it cannot be read or says something else.
        """
        try:
            stamp = json.loads(self.path.read_text(encoding="utf-8"))["stamp"]
        except FileNotFoundError:
            return 0
        except OSError as error:
            raise cannot_read(self.path, error) from error
        except (ValueError, KeyError, TypeError):
            stamp = None
        if not isinstance(stamp, int) or stamp < 0:
            raise ConfigError(
                f"{self.path}: unreadable; expected the link's last signing stamp. Where the clock is right, "
                "the file may be deleted"
            )
        return stamp

    def write(self, stamp: int) -> None:
        """Keep a stamp.

        Raises:
            ConfigError: it cannot be written.
        """
        write_durably(self.path, json.dumps({"stamp": stamp}))


class StampKeeper:
    """Writes the link's newest stamp into its file while the app runs; without either it does nothing."""

    def __init__(
        self, file: StampFile | None, signing: LinkSigning | None, warn: Callable[[str], None]
    ) -> None:
        self._file, self._signing, self._warn = file, signing, warn
        self._streams = 0
        self._wanted = asyncio.Event()

    def note(self, *, ordered: bool) -> None:
        """Bytes were received: keep the stamp soon where they held an order, or began a stream."""
        if self._signing is None:
            return
        if ordered or self._signing.streams != self._streams:
            self._streams = self._signing.streams
            self._wanted.set()

    async def run(self) -> None:
        """Keep it from time to time, and at the end. On a disk that is full it goes on with a warning."""
        if self._file is None or self._signing is None:
            return
        try:
            while True:
                self._tell(await asyncio.to_thread(self._kept))
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._wanted.wait(), NEW_STREAM_MAY_LAG_S)
                self._wanted.clear()
        finally:
            self._tell(self._kept())

    def _kept(self) -> str:
        """Why it could not be kept; "" when it was."""
        assert self._file is not None
        assert self._signing is not None
        try:
            self._file.write(self._signing.stamp)
        except ConfigError as error:
            return str(error)
        return ""

    def _tell(self, problem: str) -> None:
        if problem:
            self._warn(f"{problem}; recorded orders could be sent again after a restart")


# ---------------------------------------------------------------- devices that may not be there yet
# At boot a Raspberry Pi starts the app before every port is there, and an autopilot may be powered later.
# What reads a device that is missing raises OSError; its task is started again and again,
# which is what tries to open it. What is written meanwhile is dropped.


class Closable(Protocol):
    """Anything that is given back."""

    def close(self) -> None:
        """Give it back."""


class ReadableLine(Closable, Protocol):
    """What bytes come from."""

    async def read(self) -> bytes: ...


class SerialLine(ReadableLine, Protocol):
    """A serial line whose rate can be changed: `companion.sense.serial_port.SerialPort`."""

    def write(self, data: bytes) -> None: ...
    def set_baud(self, baud: int) -> None: ...


class ClosableBus(RegisterBus, Closable, Protocol):
    """A register bus that is given back."""


D = TypeVar("D", bound=Closable)
L = TypeVar("L", bound=ReadableLine)


class _Awaited(Generic[D]):
    """A device while it is there."""

    def __init__(self, device: D | None) -> None:
        self._device = device

    def close(self) -> None:
        """Give it back, if it is there."""
        if self._device is not None:
            device, self._device = self._device, None
            with suppress(OSError):
                device.close()


@contextmanager
def _not_there() -> Iterator[None]:
    """What cannot be opened is an error of the device, not of the settings."""
    try:
        yield
    except ConfigError as error:
        raise OSError(str(error)) from error


class _AwaitedLine(_Awaited[L]):
    """A line that is read as bytes come; `open_line` raises ConfigError while it cannot be opened."""

    def __init__(self, device: L | None, open_line: Callable[[], Awaitable[L]]) -> None:
        super().__init__(device)
        self._open = open_line

    async def read(self) -> bytes:
        """Wait for bytes.

        Raises:
            OSError: it is not there, or has gone.
        """
        if self._device is None:
            with _not_there():
                self._device = await self._open()
        try:
            return await self._device.read()
        except OSError:
            self.close()
            raise


class AwaitedPort(_AwaitedLine[SerialLine]):
    """A serial port to a sensor; `open_port` raises ConfigError while it cannot be opened."""

    def __init__(self, device: SerialLine | None, open_port: Callable[[], SerialLine]) -> None:
        async def opened() -> SerialLine:
            return open_port()

        super().__init__(device, opened)

    def write(self, data: bytes) -> None:
        """Send; dropped while it is not there."""
        self._if_there(lambda port: port.write(data))

    def set_baud(self, baud: int) -> None:
        self._if_there(lambda port: port.set_baud(baud))

    def _if_there(self, act: Callable[[SerialLine], None]) -> None:
        if self._device is not None:
            try:
                act(self._device)
            except OSError:
                self.close()


class AwaitedBus(_Awaited[ClosableBus]):
    """A register bus; `open_bus` raises ConfigError while it cannot be opened."""

    def __init__(self, device: ClosableBus | None, open_bus: Callable[[], ClosableBus]) -> None:
        super().__init__(device)
        self._open = open_bus

    def read(self, address: int, register: int, length: int) -> bytes:
        """See `RegisterBus`; OSError while it is not there."""
        with self._opened() as bus:
            return bus.read(address, register, length)

    def write(self, address: int, register: int, value: int) -> None:
        """See `RegisterBus`; OSError while it is not there."""
        with self._opened() as bus:
            bus.write(address, register, value)

    @contextmanager
    def _opened(self) -> Iterator[ClosableBus]:
        """The bus for one transaction; an adapter that was unplugged is opened anew for the next."""
        if self._device is None:
            with _not_there():
                self._device = self._open()
        try:
            yield self._device
        except OSError as error:
            if error.errno == errno.ENODEV:
                self.close()
            raise


class AwaitedTransport(_AwaitedLine[Transport]):
    """The line to the autopilot."""

    def write(self, data: bytes) -> None:
        """See `Transport`; dropped while it is not there."""
        if self._device is not None:
            self._device.write(data)


def opened_if_there(open_device: Callable[[], D]) -> D | None:
    """A device, or None when it is missing.

    Raises:
        ConfigError: it cannot be opened, for a reason that does not pass by itself.
    """
    try:
        return open_device()
    except DeviceMissing:
        return None


# ---------------------------------------------------------------- one app at an autopilot
# Two of them would both answer orders and send setpoints, as one component, and neither would know. A serial
# port can be had by one process alone, but a UDP or TCP address by many. So the one that flies holds a name,
# made of the address, in Linux's abstract namespace of sockets: it belongs to no user and no folder, and it
# is gone with the process that holds it, however that ends (unix(7)). Elsewhere than on Linux nothing is
# held.

ANOTHER: Final = "another companion"
# nobody takes their calls: so many are told which process it is, the others that there is one
ASKED: Final = 100
_CREDENTIALS: Final = struct.Struct("3i")  # struct ucred: process, user, group


@contextmanager
def only_app_at(connection: str) -> Iterator[None]:
    """Hold the line to the autopilot while inside.

    Raises:
        ConfigError: another app on this machine holds it.
    """
    if sys.platform != "linux":
        yield
        return
    name = _name(connection)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as held:
        try:
            held.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise ConfigError(
                f"link.connection {connection}: {_holder(name) or ANOTHER} is at this autopilot; "
                "expected it to be stopped ('systemctl stop companion', if it is the service)"
            ) from None
        held.listen(ASKED)  # so that who is refused can ask who is there
        yield


def app_at(connection: str) -> str | None:
    """Which app on this machine is at this autopilot, in words; None: none. Nothing is held by asking."""
    return _holder(_name(connection)) if sys.platform == "linux" else None


def _name(connection: str) -> str:
    """A name of fixed length, the same for all paths of one device."""
    kind, _, rest = connection.partition(":")
    if kind == "serial":
        path, _, _ = rest.rpartition(":")
        connection = f"serial:{os.path.realpath(path)}"
    return f"\0companion-{hashlib.sha256(connection.encode()).hexdigest()[:32]}"


def _holder(name: str) -> str | None:
    """Who holds it, as far as the kernel tells; None: nobody."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(name)
        except BlockingIOError:
            return ANOTHER
        except OSError:
            return None
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, _, _ = _CREDENTIALS.unpack(credentials)
    return f"{ANOTHER} (process {process})" if process > 0 else ANOTHER


ActionsFactory = Callable[[Session, Callable[[bytes], None], Clock, CompanionConfig], PymavlinkActions]


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
    if not waits:
        return await open_line()
    try:
        return AwaitedTransport(await open_line(), open_line)
    except DeviceMissing:
        return AwaitedTransport(None, open_line)


def _open_bus(spec: str, *, waits: bool) -> ClosableBus:
    opened = partial(open_bus, spec)
    return AwaitedBus(opened_if_there(opened), opened) if waits else opened()


def _open_port(path: str, baud: int, *, waits: bool) -> SerialLine:
    open_port = partial(SerialPort, path, baud)
    return AwaitedPort(opened_if_there(open_port), open_port) if waits else open_port()


def _open_range_port(config: RangeConfig, *, waits: bool) -> SerialLine | EchoPins:
    if config.kind == "gpio":
        return EchoPins(config.trigger_pin, config.echo_pin, Clock())
    return _open_port(config.port, RANGE_BAUD, waits=waits)


def make_actions(
    session: Session, send: Callable[[bytes], None], clock: Clock, config: CompanionConfig
) -> PymavlinkActions:
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
) -> PymavlinkActions:
    """Actions by our own session whatever is named, for virtual time."""
    return PymavlinkActions(session, send, clock, config.link, attitude_setpoints=_sends_attitudes(config))


def _sends_attitudes(config: CompanionConfig) -> bool:
    """Whether an ArduPilot, for which it matters, gets attitudes."""
    return resolved(config.control, "ardupilot").setpoint == "attitude"
