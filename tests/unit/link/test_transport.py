"""Transports: bytes both ways, in order, and a clear end."""

from __future__ import annotations

import asyncio
import os
import pty
import socket
import tty

import pytest

from companion.base.clock import run_in_virtual_time
from companion.config import ConfigError
from companion.link.codec import Codec, mavlink
from companion.link.inbox import memory_pair
from companion.link.serial_transport import SerialTransport
from companion.link.transport import TcpTransport, UdpTransport, backlog_read, open_transport


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


def heartbeat_of(system_id: int, component_id: int = 1, autopilot: int = mavlink.MAV_AUTOPILOT_PX4) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, autopilot, 0, 0, 4, 3)
    return Codec(system_id, component_id).encode(message)


HEARTBEAT = heartbeat_of(1)


async def test_a_listener_answers_the_autopilot_that_spoke_to_it() -> None:
    port = free_port()
    listener = await open_transport(f"udpin:127.0.0.1:{port}")
    caller = await open_transport(f"udp:127.0.0.1:{port}")
    try:
        listener.write(b"to nobody yet")
        caller.write(HEARTBEAT)
        assert await asyncio.wait_for(listener.read(), 5.0) == HEARTBEAT
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


class Wire(asyncio.DatagramTransport):
    """Takes the place of a socket, so that time can be virtual."""

    def __init__(self) -> None:
        super().__init__()
        self.sent_to: list[object] = []

    def sendto(self, data: object, addr: object = None) -> None:
        self.sent_to.append(addr)

    def is_closing(self) -> bool:
        return False


AUTOPILOT, STRAY = ("127.0.0.1", 14550), ("192.0.2.7", 999)


def answered_to(*heard: tuple[float, bytes, tuple[str, int]], system_id: int = 1) -> list[object]:
    """Whom a listener writes to after each of these datagrams."""

    async def main() -> list[object]:
        loop, wire = asyncio.get_running_loop(), Wire()
        transport = UdpTransport(system_id)
        transport._socket = wire
        peers: list[object] = []
        for time_s, data, address in heard:
            await asyncio.sleep(time_s - loop.time())
            transport.datagram_received(data, address)
            wire.sent_to.clear()
            transport.write(b"setpoint")
            peers += wire.sent_to or [None]
        return peers

    return run_in_virtual_time(main())


@pytest.mark.parametrize(
    "data",
    [
        b"hello",
        HEARTBEAT[:-1],
        heartbeat_of(255, 190, mavlink.MAV_AUTOPILOT_INVALID),
        heartbeat_of(1, 191),
        heartbeat_of(2),
    ],
    ids=["no message", "damaged", "ground station", "another component", "another vehicle"],
)
def test_only_our_autopilots_heartbeat_makes_a_peer(data: bytes) -> None:
    assert answered_to((0.0, data, STRAY)) == [None]
    assert answered_to((0.0, data, STRAY), (0.1, HEARTBEAT, AUTOPILOT)) == [None, AUTOPILOT]


def test_with_system_id_0_any_autopilot_makes_a_peer() -> None:
    assert answered_to((0.0, heartbeat_of(2), AUTOPILOT), system_id=0) == [AUTOPILOT]


def test_with_system_id_0_the_first_one_stays_the_only_one() -> None:
    peers = answered_to(
        (0.0, heartbeat_of(2), AUTOPILOT),
        (4.0, heartbeat_of(3), STRAY),
        (4.1, heartbeat_of(2), STRAY),
        system_id=0,
    )
    assert peers == [AUTOPILOT, AUTOPILOT, STRAY]


def test_setpoints_go_to_the_peer_whoever_speaks_in_between() -> None:
    peers = answered_to(
        (0.0, HEARTBEAT, AUTOPILOT), (1.0, b"x", AUTOPILOT), (3.9, b"hello", STRAY), (3.95, HEARTBEAT, STRAY)
    )
    assert peers == [AUTOPILOT] * 4


def test_a_peer_that_has_fallen_silent_is_followed_by_the_next_heartbeats() -> None:
    peers = answered_to((0.0, HEARTBEAT, AUTOPILOT), (3.1, b"hello", STRAY), (3.2, HEARTBEAT, STRAY))
    assert peers == [AUTOPILOT, AUTOPILOT, STRAY]


def test_what_strangers_say_is_not_heard() -> None:
    async def main() -> tuple[bytes, int]:
        transport = UdpTransport(1)
        transport.datagram_received(HEARTBEAT, AUTOPILOT)
        transport.datagram_received(heartbeat_of(1, 1), STRAY)
        transport.datagram_received(b"last", AUTOPILOT)
        return await transport.read(), transport.strangers

    assert run_in_virtual_time(main()) == (HEARTBEAT + b"last", 1)


async def test_a_caller_survives_that_nobody_listens_yet() -> None:
    port = free_port()
    caller = await open_transport(f"udp:127.0.0.1:{port}")
    caller.write(b"lost")
    await asyncio.sleep(0.05)
    listener = await open_transport(f"udpin:127.0.0.1:{port}")
    try:
        caller.write(HEARTBEAT)
        assert await asyncio.wait_for(listener.read(), 5.0) == HEARTBEAT
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
        (
            "tcpin:127.0.0.1:5760",
            "expected serial:PATH:BAUD, udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT",
        ),
        ("udp:127.0.0.1:99999", "."),
    ],
)
async def test_what_cannot_be_opened_is_told_in_one_line(spec: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=rf"^link\.connection: .*{reason}") as caught:
        await open_transport(spec)
    assert "\n" not in str(caught.value)
    assert spec in str(caught.value)


async def test_tcp_carries_bytes_both_ways_and_its_end_is_an_error() -> None:
    heard = asyncio.get_running_loop().create_future()

    async def vehicle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"heartbeat")
        heard.set_result(await reader.read(100))
        writer.close()

    server = await asyncio.start_server(vehicle, "127.0.0.1", 0)
    link = await open_transport(f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}")
    assert await asyncio.wait_for(link.read(), 5.0) == b"heartbeat"
    link.write(b"setpoint")
    assert await asyncio.wait_for(heard, 5.0) == b"setpoint"
    with pytest.raises(OSError, match="closed"):
        await asyncio.wait_for(link.read(), 5.0)
    link.close()
    link.write(b"to nobody")
    server.close()


async def test_tcp_drops_whole_writes_while_nobody_takes_them() -> None:
    server = await asyncio.start_server(lambda _reader, _writer: None, "127.0.0.1", 0)
    link = await open_transport(f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}")
    assert isinstance(link, TcpTransport)
    for _ in range(20_000):
        link.write(bytes(1000))
    assert link.dropped_bytes > 0
    assert link.dropped_bytes % 1000 == 0
    link.close()
    server.close()


async def test_a_tcp_port_where_nobody_listens_is_told_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^link\.connection: tcp:127\.0\.0\.1:1: Connection refused$"):
        await open_transport("tcp:127.0.0.1:1")


# ---------------------------------------------------------------- after a pause


async def test_all_that_came_during_a_pause_is_read_before_anything_else() -> None:
    port = free_port()
    transport = await open_transport(f"udpin:127.0.0.1:{port}")
    read = 0

    async def listen() -> None:
        nonlocal read
        while True:
            read += len(await transport.read())

    listening = asyncio.create_task(listen())
    await asyncio.sleep(0.01)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        beat = Codec(1, 1).encode(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
        for _ in range(60):  # the event loop does not run meanwhile
            autopilot.sendto(beat, ("127.0.0.1", port))
    await backlog_read(lambda: read)
    assert read == 60 * len(beat)
    listening.cancel()
    await asyncio.gather(listening, return_exceptions=True)
    transport.close()
