"""Transports: bytes both ways, in order, and a clear end."""

from __future__ import annotations

import asyncio
import os
import pty
import socket
import tty

import pytest

from companion.clock import run_in_virtual_time
from companion.config import ConfigError
from companion.link.transport import SerialTransport, UdpTransport, memory_pair, open_transport


async def read_count(transport: UdpTransport | SerialTransport, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += await asyncio.wait_for(transport.read(), 5.0)
    return data


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


# ---------------------------------------------------------------- in process


def test_the_pipe_delivers_in_order_after_its_latency() -> None:
    async def main() -> tuple[bytes, float]:
        one, other = memory_pair(latency_s=0.005)
        for i in range(50):
            one.write(bytes([i]))
        data = await other.read()
        arrived_s = asyncio.get_running_loop().time()
        while len(data) < 50:
            data += await other.read()
        return data, arrived_s

    data, arrived_s = run_in_virtual_time(main())
    assert data == bytes(range(50))
    assert arrived_s == pytest.approx(0.005)


def test_the_pipe_goes_both_ways() -> None:
    async def main() -> tuple[bytes, bytes]:
        one, other = memory_pair()
        one.write(b"there")
        there = await other.read()
        other.write(b"back")
        return there, await one.read()

    assert run_in_virtual_time(main()) == (b"there", b"back")


def test_what_has_arrived_is_read_before_the_end_is_told() -> None:
    async def main() -> bytes:
        one, other = memory_pair()
        one.write(b"last")
        await asyncio.sleep(0.01)
        one.close()
        last = await other.read()
        with pytest.raises(OSError, match="closed"):
            await other.read()
        other.write(b"nobody")
        return last

    assert run_in_virtual_time(main()) == b"last"


def test_closing_wakes_who_reads() -> None:
    async def main() -> None:
        one, _ = memory_pair()
        reading = asyncio.ensure_future(one.read())
        await asyncio.sleep(0.01)
        one.close()
        with pytest.raises(OSError, match="closed"):
            await reading

    run_in_virtual_time(main())


def test_a_reader_that_sleeps_finds_new_bytes_not_a_heap_of_old_ones() -> None:
    async def main() -> bytes:
        one, other = memory_pair()
        for i in range(100):
            one.write(bytes([i]) * 1000)
        await asyncio.sleep(1.0)
        return await other.read()

    data = run_in_virtual_time(main())
    assert len(data) <= 1 << 16
    assert data.endswith(bytes([99]) * 1000)


# ---------------------------------------------------------------- UDP


async def test_a_listener_answers_who_spoke_to_it() -> None:
    port = free_port()
    listener = await open_transport(f"udpin:127.0.0.1:{port}")
    caller = await open_transport(f"udp:127.0.0.1:{port}")
    try:
        listener.write(b"to nobody yet")
        caller.write(b"hello")
        assert await asyncio.wait_for(listener.read(), 5.0) == b"hello"
        listener.write(b"answer")
        assert await asyncio.wait_for(caller.read(), 5.0) == b"answer"
    finally:
        listener.close()
        caller.close()
    with pytest.raises(OSError, match="closed"):
        await asyncio.wait_for(listener.read(), 5.0)
    listener.write(b"nothing happens")


async def test_a_caller_survives_that_nobody_listens_yet() -> None:
    port = free_port()
    caller = await open_transport(f"udp:127.0.0.1:{port}")
    caller.write(b"lost")
    await asyncio.sleep(0.05)
    listener = await open_transport(f"udpin:127.0.0.1:{port}")
    try:
        caller.write(b"heard")
        assert await asyncio.wait_for(listener.read(), 5.0) == b"heard"
    finally:
        caller.close()
        listener.close()


async def test_a_port_in_use_is_told_in_one_line() -> None:
    port = free_port()
    first = await open_transport(f"udpin:127.0.0.1:{port}")
    try:
        with pytest.raises(
            ConfigError, match=rf"^link\.connection: udpin:127\.0\.0\.1:{port}: .*in use"
        ) as caught:
            await open_transport(f"udpin:127.0.0.1:{port}")
        assert "\n" not in str(caught.value)
    finally:
        first.close()


# ---------------------------------------------------------------- serial


def open_pty() -> tuple[int, str]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    return master, path


async def test_a_serial_port_carries_bytes_both_ways() -> None:
    master, path = open_pty()
    port = await open_transport(f"serial:{path}:57600")
    assert isinstance(port, SerialTransport)
    try:
        everything = bytes(range(256))
        os.write(master, everything)
        assert await read_count(port, 256) == everything
        port.write(everything)
        assert await asyncio.to_thread(os.read, master, 512) == everything
    finally:
        port.close()
        os.close(master)
    with pytest.raises(OSError, match="closed"):
        await port.read()


async def test_an_unplugged_serial_port_ends_the_reading() -> None:
    master, path = open_pty()
    port = await open_transport(f"serial:{path}:57600")
    os.close(master)
    with pytest.raises(OSError):  # noqa: PT011 - the system's words differ
        await asyncio.wait_for(port.read(), 5.0)
    port.write(b"nothing happens")
    port.close()


async def test_a_stuck_line_drops_what_it_cannot_take() -> None:
    master, path = open_pty()
    port = await open_transport(f"serial:{path}:57600")
    assert isinstance(port, SerialTransport)
    try:
        for _ in range(200):
            port.write(bytes(1000))
        assert port.dropped_bytes > 0
        assert port.dropped_bytes % 1000 == 0
        taken = 200_000 - port.dropped_bytes
        received = 0
        while received < taken:
            await asyncio.sleep(0)
            received += len(await asyncio.to_thread(os.read, master, 65536))
        assert received == taken
    finally:
        port.close()
        os.close(master)


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("serial:/dev/no-such-port:57600", "No such file or directory"),
        ("serial:/dev/null:57600", "."),
        ("udpin:no-such-host.invalid:14540", "."),
        ("udpin:203.0.113.1:14540", "."),
        ("tcp:127.0.0.1:5760", "expected serial:PATH:BAUD, udp:HOST:PORT or udpin:HOST:PORT"),
        ("udp:127.0.0.1:99999", "."),
    ],
)
async def test_what_cannot_be_opened_is_told_in_one_line(spec: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=rf"^link\.connection: .*{reason}") as caught:
        await open_transport(spec)
    assert "\n" not in str(caught.value)
    assert spec in str(caught.value)
