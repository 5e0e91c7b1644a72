"""Devices that are not there yet: what reads them fails, what is written is dropped, they come back."""

from __future__ import annotations

import errno

import pytest

from companion.app.devices import AwaitedBus, AwaitedPort, AwaitedTransport, opened_if_there
from companion.base.errors import ConfigError, DeviceMissing


class UnpluggedLine:
    """A port and a transport; `gone` while it is unplugged."""

    def __init__(self, shelf: Shelf) -> None:
        self.shelf, self.closed = shelf, False

    async def read(self) -> bytes:
        self.shelf.check(errno.EIO)
        return b"data"

    def write(self, data: bytes) -> None:
        self.shelf.check(errno.EIO)
        self.shelf.written.append(data)

    def set_baud(self, baud: int) -> None:
        self.shelf.check(errno.EIO)

    def close(self) -> None:
        self.closed = True
        self.shelf.closed += 1


class Bus:
    """A register bus on the same shelf."""

    def __init__(self, shelf: Shelf) -> None:
        self.shelf = shelf

    def read(self, address: int, register: int, length: int) -> bytes:
        self.shelf.check(self.shelf.bus_error)
        return bytes(length)

    def write(self, address: int, register: int, value: int) -> None:
        self.shelf.check(self.shelf.bus_error)

    def close(self) -> None:
        self.shelf.closed += 1


class Shelf:
    """Whether the device is plugged in, and what was done with it."""

    def __init__(self) -> None:
        self.there, self.opened, self.closed = False, 0, 0
        self.bus_error = errno.ENODEV
        self.written: list[bytes] = []

    def check(self, number: int) -> None:
        if not self.there:
            raise OSError(number, "unplugged")

    def open_line(self) -> UnpluggedLine:
        if not self.there:
            raise DeviceMissing("no such port")
        self.opened += 1
        return UnpluggedLine(self)

    async def open_transport(self) -> UnpluggedLine:
        return self.open_line()

    def open_bus(self) -> Bus:
        if not self.there:
            raise DeviceMissing("no such bus")
        self.opened += 1
        return Bus(self)


@pytest.mark.parametrize("kind", ["port", "transport"])
async def test_a_line_is_opened_when_it_is_there_and_again_after_it_went(kind: str) -> None:
    shelf = Shelf()
    line: AwaitedPort | AwaitedTransport
    line = (
        AwaitedPort(None, shelf.open_line) if kind == "port" else AwaitedTransport(None, shelf.open_transport)
    )
    line.write(b"into the void")
    with pytest.raises(OSError, match="no such port"):
        await line.read()
    shelf.there = True
    assert await line.read() == b"data"
    line.write(b"hello")
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        await line.read()
    with pytest.raises(OSError, match="no such port"):
        await line.read()
    shelf.there = True
    assert await line.read() == b"data"
    line.close()
    assert (shelf.opened, shelf.closed, shelf.written) == (2, 2, [b"hello"])


def test_a_port_that_goes_while_it_is_written_to_is_no_error_of_the_writer() -> None:
    shelf = Shelf()
    shelf.there = True
    port = AwaitedPort(shelf.open_line(), shelf.open_line)
    shelf.there = False
    port.set_baud(9600)
    port.write(b"lost")
    port.write(b"lost too")
    assert (shelf.closed, shelf.written) == (1, [])


def test_a_bus_is_opened_for_a_transaction_and_anew_once_its_adapter_went() -> None:
    shelf = Shelf()
    bus = AwaitedBus(None, shelf.open_bus)
    with pytest.raises(OSError, match="no such bus"):
        bus.read(0x68, 0, 1)
    shelf.there = True
    assert bus.read(0x68, 0, 3) == bytes(3)
    bus.write(0x68, 1, 2)
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        bus.write(0x68, 1, 2)
    shelf.there = True
    assert bus.read(0x68, 0, 1) == bytes(1)
    assert (shelf.opened, shelf.closed) == (2, 1)


def test_a_chip_that_does_not_answer_leaves_the_bus_open() -> None:
    shelf = Shelf()
    shelf.there, shelf.bus_error = True, errno.ENXIO
    bus = AwaitedBus(shelf.open_bus(), shelf.open_bus)
    shelf.there = False
    with pytest.raises(OSError, match="unplugged"):
        bus.read(0x68, 0, 1)
    shelf.there = True
    bus.read(0x68, 0, 1)
    assert (shelf.opened, shelf.closed) == (1, 0)


def test_only_what_is_missing_is_waited_for() -> None:
    shelf = Shelf()
    assert opened_if_there(shelf.open_line, waits=True) is None
    with pytest.raises(DeviceMissing):
        opened_if_there(shelf.open_line, waits=False)

    def misspelt() -> UnpluggedLine:
        raise ConfigError("no such kind of port")

    with pytest.raises(ConfigError, match="no such kind"):
        opened_if_there(misspelt, waits=True)
