"""Connections to somebody else's vehicle: over UDP and TCP, and gone and back."""

import asyncio
import socket
from contextlib import closing

import pytest

from companion.config import ConfigError
from sitl.external import link as external_link
from sitl.external.link import check_connection, open_link, open_relay, pump


@pytest.mark.parametrize(
    "spec",
    [
        "udp:127.0.0.1",
        "udp:127.0.0.1:0",
        "udp:127.0.0.1:70000",
        "serial:/dev/tty:57600",
        "",
        "tcp::1",
        "tcp:a..b:1",
        "udp:a..b:1",
    ],
)
def test_what_is_no_connection_is_refused_in_one_line(spec: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_connection(spec, "--external")
    assert "expected udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT" in str(caught.value)
    assert "\n" not in str(caught.value)


async def read(end: external_link.ExternalLink) -> bytes:
    return await asyncio.wait_for(end.read(), 5.0)


async def test_udp_calls_and_udpin_listens() -> None:
    relay, port = await open_relay()
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    assert not relay.has_peer
    relay.write(b"nobody hears that")
    caller.write(b"here I am")
    assert await read(relay) == b"here I am"
    relay.write(b"and I")
    assert await read(caller) == b"and I"
    caller.close()
    relay.close()


async def test_udpin_takes_a_port_and_a_port_in_use_is_reported() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(ConfigError, match="in use; expected a free port"):
            await open_link(f"udpin:127.0.0.1:{other.getsockname()[1]}", print)


async def test_a_call_that_nobody_answers_yet_goes_on() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as vacant:
        vacant.bind(("127.0.0.1", 0))
        port = vacant.getsockname()[1]
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    caller.write(b"refused")
    await asyncio.sleep(0.05)
    late = await open_link(f"udpin:127.0.0.1:{port}", print)
    caller.write(b"heard")
    assert await read(late) == b"heard"
    caller.close()
    late.close()


async def test_tcp_calls_again_and_tells_it_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(external_link, "RETRY_S", 0.02)
    came: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()

    async def vehicle(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"hello")
        came.put_nowait(writer)

    server = await asyncio.start_server(vehicle, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    texts: list[str] = []
    link = await open_link(f"tcp:127.0.0.1:{port}", texts.append)
    assert await read(link) == b"hello"
    first = await came.get()
    server.close()
    first.transport.abort()
    while len(texts) < 1:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    link.write(b"nobody hears that")
    await asyncio.sleep(0.1)  # several calls in vain, of which nothing is said
    assert len(texts) == 1
    assert texts[0].startswith(f"tcp:127.0.0.1:{port}: ")
    assert texts[0].endswith("; trying again every 0.02 s")
    server = await asyncio.start_server(vehicle, "127.0.0.1", port)
    assert await read(link) == b"hello"
    assert texts[1:] == [f"tcp:127.0.0.1:{port}: connected again"]
    link.close()
    (await came.get()).close()
    server.close()


async def test_pumped_bytes_reach_every_sink() -> None:
    relay, port = await open_relay()
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    one, other = bytearray(), bytearray()
    task = asyncio.create_task(pump(relay, one.extend, other.extend))
    caller.write(b"bytes")
    while not other:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    assert one == other == b"bytes"
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    caller.close()
    relay.close()


async def test_what_makes_no_sense_is_reported_once_and_the_rest_goes_on() -> None:
    relay, port = await open_relay()
    caller = await open_link(f"udp:127.0.0.1:{port}", print)
    told: list[str] = []
    handed_on: asyncio.Queue[bytes] = asyncio.Queue()

    def reckon(data: bytes) -> None:
        raise ValueError("math domain error")

    pumping = asyncio.create_task(pump(relay, reckon, handed_on.put_nowait, tell=told.append))
    for data in (b"wild", b"wilder"):
        caller.write(data)
        assert await asyncio.wait_for(handed_on.get(), 5.0) == data
    assert told == ["WARNING: ignored invalid data (math domain error)"]
    pumping.cancel()
    await asyncio.wait([pumping])
    caller.close()
    relay.close()
