"""The line in the process, and what waits in any line after a pause."""

import asyncio
import socket

import pytest

from companion.link.codec import Codec, mavlink
from companion.link.transport import backlog_read, memory_pair, open_transport
from tests.unit.link.transport.transport_ends import free_port
from tests.virtual_time import in_virtual_time

# ---------------------------------------------------------------- in process


@in_virtual_time
async def test_the_pipe_delivers_in_order_after_its_latency() -> None:
    one, other = memory_pair(latency_s=0.005)
    for i in range(50):
        one.write(bytes([i]))
    data = await other.read()
    arrived_s = asyncio.get_running_loop().time()
    while len(data) < 50:
        data += await other.read()
    assert data == bytes(range(50))
    assert arrived_s == pytest.approx(0.005)


@in_virtual_time
async def test_the_pipe_goes_both_ways() -> None:
    one, other = memory_pair()
    one.write(b"there")
    there = await other.read()
    other.write(b"back")
    assert (there, await one.read()) == (b"there", b"back")


@in_virtual_time
async def test_what_has_arrived_is_read_before_the_end_is_reported() -> None:
    one, other = memory_pair()
    one.write(b"last")
    await asyncio.sleep(0.01)
    one.close()
    last = await other.read()
    with pytest.raises(OSError, match="closed"):
        await other.read()
    other.write(b"nobody")
    assert last == b"last"


@in_virtual_time
async def test_closing_wakes_who_reads() -> None:
    one, _ = memory_pair()
    reading = asyncio.ensure_future(one.read())
    await asyncio.sleep(0.01)
    one.close()
    with pytest.raises(OSError, match="closed"):
        await reading


@in_virtual_time
async def test_a_reader_that_sleeps_finds_new_bytes_not_a_heap_of_old_ones() -> None:
    one, other = memory_pair()
    for i in range(100):
        one.write(bytes([i]) * 1000)
    await asyncio.sleep(1.0)
    data = await other.read()
    assert len(data) <= 1 << 16
    assert data.endswith(bytes([99]) * 1000)


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
