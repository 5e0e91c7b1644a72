"""Devices that may not be there yet: opened as soon as they are, and again when they come back.

At boot a Raspberry Pi starts the app before every port is there, and an autopilot may be powered later. What
reads a device that is missing raises OSError; its task is started again and again (`supervision`), which is
what tries to open it. What is written meanwhile is dropped.
"""

import errno
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Generic, Protocol, TypeVar

from companion.base.errors import ConfigError, DeviceMissing
from companion.link.transport import Transport
from companion.sense.imu.i2c import RegisterBus


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
        if self._device is not None:
            try:
                self._device.write(data)
            except OSError:
                self.close()

    def set_baud(self, baud: int) -> None:
        """Change the rate of a port that is there."""
        if self._device is not None:
            try:
                self._device.set_baud(baud)
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


def opened_if_there(open_device: Callable[[], D], *, waits: bool) -> D | None:
    """A device, or None when it is missing and may be waited for.

    Raises:
        ConfigError: it cannot be opened, for a reason that does not pass by itself, or may not be waited for.
    """
    try:
        return open_device()
    except DeviceMissing:
        if waits:
            return None
        raise
