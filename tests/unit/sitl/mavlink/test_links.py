"""The vehicle's sockets: who listens, who calls, and that nobody holds the vehicle up."""

import asyncio
import math
import socket
import tracemalloc
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
import pytest

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.config import ConfigError
from companion.link.codec import mavlink
from sitl.mavlink import links
from sitl.mavlink.ground_station import GroundStation
from sitl.mavlink.links import MOST_CLIENTS, UDP_SILENCE_S, UNREAD_BYTES, TcpServer, UdpServer, in_datagrams
from sitl.mavlink.network import Port
from sitl.scenario.scenario import BeaconSettings

HELLO = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(mavlink.MAVLink(None, srcSystem=255)))


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


@contextmanager
def traced_memory() -> Iterator[Callable[[], int]]:
    """How much more Python holds than at the start."""
    tracemalloc.start()
    try:
        yield lambda: tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()


async def test_a_client_that_never_reads_costs_neither_time_nor_memory() -> None:
    host = Host()
    server = TcpServer(host)
    port = await server.open("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", port)) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        await host.has_ports(1)
        with traced_memory() as held_bytes:
            for _ in range(3000):
                host.ports[0].write([bytes(1000)] * 10)
            assert 0.9 * UNREAD_BYTES < held_bytes() < 1.5 * UNREAD_BYTES  # of 30 MB
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


async def test_who_has_gone_makes_room_and_the_listener_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    host, clock = Host(), Hands()
    monkeypatch.setattr(links, "Clock", lambda: clock)
    monkeypatch.setattr(links, "SWEEP_PERIOD_S", 0.02)
    server = UdpServer(host, ("127.0.0.1", 9))
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
    await asyncio.wait_for(host.has_ports(1), 5.0)
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


# ---------------- The ground station at the pad: hears the companion, and answers where the pad is

HOME: Vector3 = (47.0, 8.0, 400.0)
PAD: Vector3 = (12.0, -5.0, -0.3)
PAD_VELOCITY: Vector3 = (1.0, 0.5, 0.0)
COMPANION = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)


@pytest.fixture
def ground() -> GroundStation:
    return station()


def station(seed: int = 1, **beacon: Any) -> GroundStation:
    return GroundStation(BeaconSettings(**beacon), np.random.default_rng(seed), HOME)


def ask(
    ground: GroundStation, now_s: float, message_id: float = 144.0, target: int = 255, part: int = 0
) -> None:
    request = mavlink.MAVLink_command_long_message(target, part, 512, 0, message_id, 0, 0, 0, 0, 0, 0)
    ground.receive(bytes(request.pack(COMPANION)), now_s)


def listen(ground: GroundStation, now_s: float, pad: Vector3 = PAD) -> dict[str, list[Any]]:
    """Its messages by type."""
    heard: dict[str, list[Any]] = defaultdict(list)
    for message in mavlink.MAVLink(None).parse_buffer(ground.transmit(now_s, pad, PAD_VELOCITY)) or []:
        heard[message.get_type()].append(message)
    return heard


def place(message: Any) -> Vector3:
    return ned_from_geodetic(message.lat * 1e-7, message.lon * 1e-7, message.alt, HOME)


def test_a_request_is_acknowledged_at_once_and_answered_half_a_second_later(ground: GroundStation) -> None:
    ask(ground, 10.0)
    acknowledgement = listen(ground, 10.0)["COMMAND_ACK"][0]
    assert (acknowledgement.command, acknowledgement.result) == (512, 0)
    assert (acknowledgement.target_system, acknowledgement.target_component) == (1, 191)
    assert not listen(ground, 10.49)["FOLLOW_TARGET"]
    (answer,) = listen(ground, 10.5)["FOLLOW_TARGET"]
    assert (answer.get_srcSystem(), answer.get_srcComponent()) == (255, 190)
    assert not listen(ground, 11.5)["FOLLOW_TARGET"]


def test_the_answer_is_the_pads_place_to_within_a_gps_receivers_error() -> None:
    errors = []
    for seed in range(40):
        ground = station(seed, position_std_m=1.5)
        ask(ground, 0.0)
        (message,) = listen(ground, 0.5)["FOLLOW_TARGET"]
        errors.append(np.subtract(place(message), PAD))
        assert math.dist(message.vel, PAD_VELOCITY) < 0.6
        assert message.position_cov[0] == pytest.approx(1.5, abs=0.1)
        assert message.est_capabilities == 3
    spread = np.std(errors, axis=0)
    assert spread[0] == pytest.approx(1.5, abs=0.5)
    assert spread[2] > spread[0]


def test_its_error_stays_the_same_over_a_flight() -> None:
    ground, shown = station(3), []
    for k in range(5):
        ask(ground, float(k))
        shown.append(place(listen(ground, k + 0.5)["FOLLOW_TARGET"][0])[0])
    assert max(shown) - min(shown) < 1.2


def test_other_requests_are_refused_and_those_for_others_ignored(ground: GroundStation) -> None:
    ask(ground, 0.0, message_id=33.0)
    ask(ground, 0.0, message_id=math.nan)
    results = [m.result for m in listen(ground, 0.0)["COMMAND_ACK"]]
    assert results == [mavlink.MAV_RESULT_UNSUPPORTED] * 2
    ask(ground, 0.0, target=1)
    ask(ground, 0.0, part=191)  # another component of its system
    assert listen(ground, 0.6).keys() <= {"HEARTBEAT"}


def test_it_beats_once_a_second(ground: GroundStation) -> None:
    beats = [m for k in range(40) for m in listen(ground, k / 10)["HEARTBEAT"]]
    assert len(beats) == 4
    assert beats[0].type == mavlink.MAV_TYPE_GCS


def test_random_bytes_do_no_harm(ground: GroundStation) -> None:
    ground.receive(np.random.default_rng(0).bytes(3000), 0.0)
    for _ in range(10):
        ask(ground, 0.0)
    assert ground.requests > 0


def test_whoever_floods_it_does_not_fill_the_memory(ground: GroundStation) -> None:
    for _ in range(500):
        ask(ground, 0.0)
    results = [m.result for m in listen(ground, 0.0)["COMMAND_ACK"]]
    assert results.count(mavlink.MAV_RESULT_ACCEPTED) == 32
    assert results.count(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) == len(results) - 32
    assert len(listen(ground, 0.5)["FOLLOW_TARGET"]) == 32


# ---------------------------------------------------------------- a beacon's settings


def test_a_pad_without_a_beacon_is_reported_of_and_gives_no_answer() -> None:
    ground = station(available=False)
    ask(ground, 1.0)
    assert listen(ground, 1.0)["COMMAND_ACK"][0].result == mavlink.MAV_RESULT_UNSUPPORTED
    assert not listen(ground, 5.0)["FOLLOW_TARGET"]


def test_the_answer_is_the_newest_fix_after_the_delay() -> None:
    ground = station(position_std_m=0.0, rate_hz=0.5, delay_s=0.1)
    assert listen(ground, 10.0)  # a fix at 10 s, the next at 12 s
    ask(ground, 11.0)
    assert not listen(ground, 11.05)["FOLLOW_TARGET"]
    (answer,) = listen(ground, 11.1, (PAD[0] + 5.0, PAD[1], PAD[2]))["FOLLOW_TARGET"]
    assert answer.timestamp == 10_000
    assert place(answer)[0] == pytest.approx(PAD[0], abs=1.0)


def test_the_beacons_velocity_is_as_good_as_it_is_said_to_be() -> None:
    def off(std_m_s: float) -> float:
        ground, errors = station(3, velocity_std_m_s=std_m_s), []
        for k in range(60):
            ask(ground, float(k))
            errors.append(math.dist(listen(ground, k + 0.6)["FOLLOW_TARGET"][0].vel, PAD_VELOCITY))
        return float(np.mean(errors))

    assert off(0.0) < 1e-6
    assert off(2.0) == pytest.approx(2.0 * 1.6, rel=0.2)  # the mean length of three normal numbers
