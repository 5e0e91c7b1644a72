"""The vehicle's sockets: who listens, who calls, and that nobody holds the vehicle up."""

import asyncio
import socket
from typing import Any, cast

import pytest

from companion.base.clock import Clock
from companion.config import ConfigError
from sitl.mavlink.framing import dialect
from sitl.mavlink.links import MOST_CLIENTS, UDP_SILENCE_S, UNREAD_BYTES, TcpServer, UdpServer, in_datagrams
from sitl.mavlink.network import Port

HELLO = bytes(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(dialect.MAVLink(None, srcSystem=255)))


class Host:
    """Stands in for the simulation behind sockets: remembers, and talks when told."""

    def __init__(self) -> None:
        self.ports: list[Any] = []
        self.heard: list[bytes] = []
        self._changed = asyncio.Event()

    async def has_ports(self, count: int) -> None:
        """Wait until so many clients are here."""
        while len(self.ports) != count:
            await self._changed.wait()
            self._changed.clear()

    async def has_heard(self) -> None:
        """Wait until somebody has spoken."""
        while not self.heard:
            await self._changed.wait()
            self._changed.clear()

    def connect(self, write: Any, *, datagrams: bool) -> Port:
        port: Any = type("P", (), {"write": staticmethod(write), "datagrams": datagrams})()
        self.ports.append(port)
        self._changed.set()
        return cast("Port", port)

    def receive(self, port: Any, data: bytes) -> None:
        self.heard.append(data)
        self._changed.set()

    def disconnect(self, port: Any) -> None:
        self.ports.remove(port)
        self._changed.set()


async def test_a_client_that_never_reads_costs_neither_time_nor_memory() -> None:
    host = Host()
    server = TcpServer(host)
    port = await server.open("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", port)) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        await host.has_ports(1)
        (client,) = server._clients
        for _ in range(3000):
            host.ports[0].write([bytes(1000)] * 10)
        assert client._transport is not None
        assert UNREAD_BYTES < client._transport.get_write_buffer_size() <= UNREAD_BYTES + 10_000
    server.close()
    await host.has_ports(0)


async def test_a_udp_server_talks_to_its_listener_and_to_who_speaks() -> None:
    host = Host()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as caller,
    ):
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(2.0)
        server = UdpServer(host, listener.getsockname())
        own = await server.open("127.0.0.1", 0)
        host.ports[0].write([b"one", b"two"])
        data, address = listener.recvfrom(100)
        assert (data, address[1]) == (b"onetwo", own)
        caller.sendto(HELLO, ("127.0.0.1", own))
        await host.has_ports(2)
        assert host.heard == [HELLO]
        for _ in range(2 * MOST_CLIENTS):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(HELLO, ("127.0.0.1", own))
        await asyncio.sleep(0.05)
        assert len(host.ports) <= MOST_CLIENTS
        server.close()
    assert not host.ports


class Hands:
    """A clock that is set by hand."""

    time_s = 0.0

    def now_s(self) -> float:
        return self.time_s


async def test_who_has_gone_makes_room_and_the_listener_stays() -> None:
    host, clock = Host(), Hands()
    server = UdpServer(host, ("127.0.0.1", 9))
    server._clock = cast("Clock", clock)
    await server.open("127.0.0.1", 0)
    (listener,) = host.ports
    server.datagram_received(HELLO, ("127.0.0.1", 9))
    server.datagram_received(HELLO, ("127.0.0.1", 10))
    assert len(host.ports) == 2
    clock.time_s = UDP_SILENCE_S + 1.0
    server.datagram_received(HELLO, ("127.0.0.1", 11))
    assert len(host.ports) == 2
    assert host.ports[0] is listener
    clock.time_s *= 2.0
    server._remove_periodically()
    assert host.ports == [listener]
    server.close()


async def test_stray_datagrams_take_nobodys_place() -> None:
    host = Host()
    server = UdpServer(host)
    await server.open("127.0.0.1", 0)
    for port in range(100):
        server.datagram_received(b"\xfd is no frame", ("127.0.0.1", 1000 + port))
    assert not host.ports
    server.datagram_received(HELLO, ("127.0.0.1", 10))
    assert host.heard == [HELLO]
    server.close()


async def test_a_listener_named_by_its_host_is_one_client_only() -> None:
    host = Host()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        server = UdpServer(host, ("localhost", listener.getsockname()[1]))
        own = await server.open("localhost", 0)
        listener.sendto(HELLO, ("127.0.0.1", own))
        await host.has_heard()
        assert len(host.ports) == 1
        server.close()


@pytest.mark.parametrize("name", ["a..b", f"{'x' * 70}.com", "300.1.1.1"])
async def test_an_address_that_is_none_is_reported_of_in_one_line(name: str) -> None:
    for server in (UdpServer(Host()), TcpServer(Host())):
        with pytest.raises(ConfigError, match="expected a free port at an address of this computer"):
            await server.open(name, 0)


def test_datagrams_hold_whole_frames() -> None:
    frames = [bytes([n]) * 250 for n in range(12)]
    datagrams = in_datagrams(frames)
    assert b"".join(datagrams) == b"".join(frames)
    assert [len(d) for d in datagrams] == [1250, 1250, 500]
