"""Serial lines and TCP: bytes both ways, and a clear end."""

import asyncio
import errno
import os
import pty
import socket
import tty

import pytest

from companion.base.errors import DeviceMissing
from companion.config import ConfigError
from companion.link.transport import SerialTransport, TcpTransport, UdpTransport, open_transport


async def read_count(transport: UdpTransport | SerialTransport, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += await asyncio.wait_for(transport.read(), 5.0)
    return data


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
async def test_what_cannot_be_opened_is_reported_in_one_line(spec: str, reason: str) -> None:
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


async def test_a_tcp_port_where_nobody_listens_is_reported_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^link\.connection: tcp:127\.0\.0\.1:1: Connection refused$"):
        await open_transport("tcp:127.0.0.1:1")


@pytest.mark.parametrize("network", ["is up", "is down"])
async def test_a_peer_that_is_not_up_yet_may_come_whatever_keeps_it_away(
    network: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = asyncio.get_running_loop()

    async def of_both_kinds(_host: str, port: int, **_: object) -> list[tuple[object, ...]]:
        addresses = (socket.AF_INET6, ("::1", port, 0, 0)), (socket.AF_INET, ("127.0.0.1", port))
        return [(family, socket.SOCK_STREAM, 6, "", address) for family, address in addresses]

    async def network_is_down(*_: object) -> None:
        raise OSError(errno.ENETDOWN, "Network is down")

    # asyncio's error for several addresses that refuse, each in its own words, has no number
    monkeypatch.setattr(loop, "getaddrinfo", of_both_kinds)
    if network == "is down":
        monkeypatch.setattr(loop, "sock_connect", network_is_down)
    with pytest.raises(DeviceMissing, match=r"^link\.connection: tcp:peer:1: "):
        await open_transport("tcp:peer:1")


@pytest.mark.parametrize("spec", ["serial:/dev/null:57600", "tcp:127.0.0.1:99999", "udp:a..b:14540"])
async def test_what_can_never_be_opened_is_no_missing_device(spec: str) -> None:
    with pytest.raises(ConfigError) as caught:
        await open_transport(spec)
    assert not isinstance(caught.value, DeviceMissing)
