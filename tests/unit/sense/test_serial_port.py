"""The serial port on a pseudo terminal: what a tty does, unplugging included."""

import asyncio
import contextlib
import os
import tty
from collections.abc import Iterator

import pytest

from companion.base.errors import DeviceMissing
from companion.config import ConfigError
from companion.sense.serial_port import SerialPort
from sitl.devices.ports import PtyPort

PATIENCE_S = 5.0


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    yield master, path
    with contextlib.suppress(OSError):  # a test may have unplugged it
        os.close(master)


async def test_reading_waits_until_something_comes(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 9600)
    reading = asyncio.create_task(port.read())
    await asyncio.sleep(0.02)
    assert not reading.done()
    os.write(master, b"x")
    assert await asyncio.wait_for(reading, PATIENCE_S) == b"x"
    port.close()


async def test_unplugging_ends_reading_and_writing_with_an_error(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 9600)
    os.close(master)
    with pytest.raises(OSError, match=f"serial port {path}"):
        await asyncio.wait_for(port.read(), PATIENCE_S)
    with pytest.raises(OSError, match=f"serial port {path}"):
        port.write(b"x")
    port.close()


async def test_closing_ends_a_waiting_read(pty: tuple[int, str]) -> None:
    _, path = pty
    port = SerialPort(path, 9600)
    reading = asyncio.create_task(port.read())
    await asyncio.sleep(0)
    port.close()
    with pytest.raises(OSError, match="closed"):
        await asyncio.wait_for(reading, PATIENCE_S)


async def test_a_line_that_does_not_take_anything_is_an_error_and_no_growing_heap(
    pty: tuple[int, str],
) -> None:
    _, path = pty
    port = SerialPort(path, 9600)
    # the kernel takes the first tens of kilobytes
    port.write(bytes(60_000))
    port.write(bytes(1_000))
    with pytest.raises(OSError, match="does not keep up"):
        port.write(bytes(65_536))
    port.close()


async def test_a_port_that_is_not_there_is_reported_in_one_line() -> None:
    with pytest.raises(
        ConfigError, match=r"^serial port /dev/ttyNONE: cannot be opened at 9600 baud: No such"
    ):
        SerialPort("/dev/ttyNONE", 9600)


async def test_a_port_that_another_program_of_ours_has_is_waited_for(pty: tuple[int, str]) -> None:
    _, path = pty
    first = SerialPort(path, 9600)
    with pytest.raises(DeviceMissing, match=r"cannot be opened at 9600 baud: busy; expected a device"):
        SerialPort(path, 9600)
    first.close()
    SerialPort(path, 9600).close()


async def test_a_file_that_is_no_port_is_reported_in_one_line(tmp_path: os.PathLike[str]) -> None:
    path = os.path.join(tmp_path, "file")  # noqa: PTH118 - the setting is a string
    with open(path, "wb"):  # noqa: PTH123, ASYNC230
        pass
    with pytest.raises(ConfigError, match=r"^serial port .*file: cannot be opened at 9600 baud: "):
        SerialPort(path, 9600)


async def hears(port: SerialPort, expected: bytes) -> None:
    received = b""
    while len(received) < len(expected):
        received += await asyncio.wait_for(port.read(), PATIENCE_S)
    assert received == expected


async def receives(line: PtyPort, expected: bytes) -> None:
    sent = b""
    while len(sent) < len(expected):
        await asyncio.sleep(0.005)
        sent += line.receive()
    assert sent == expected


async def test_simulated_line_and_port_talk_both_ways() -> None:
    line = PtyPort(115200)
    port = SerialPort(line.path, 115200)
    every_byte = bytes(range(256))  # none of them means anything to the tty
    line.send(every_byte)
    await hears(port, every_byte)
    port.write(every_byte)
    await receives(line, every_byte)
    line.close()
    with pytest.raises(OSError, match="serial port"):
        await asyncio.wait_for(port.read(), PATIENCE_S)


async def test_at_another_rate_there_is_garbage_until_the_rate_is_set() -> None:
    """GIVEN a device at 9600 baud and a port at 38400 WHEN the port is set to 9600 THEN both understand."""
    line = PtyPort(9600)
    port = SerialPort(line.path, 38400)
    line.send(b"$GPRMC,191418.00,V\r\n")
    garbage = await asyncio.wait_for(port.read(), PATIENCE_S)
    assert b"$GP" not in garbage
    await asyncio.sleep(0.05)
    port.set_baud(9600)
    line.send(b"$GPRMC,191418.00,V\r\n")
    await hears(port, b"$GPRMC,191418.00,V\r\n")
    port.write(b"command")
    await receives(line, b"command")
    port.close()
    with pytest.raises(OSError, match="closed"):
        port.set_baud(38400)
    line.close()
