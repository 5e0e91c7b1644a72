"""UDP: who becomes the peer, who is heard, and a clear end."""

import asyncio

import pytest

from companion.config import ConfigError
from companion.link.codec import Codec, mavlink
from companion.link.signing import LinkSigning
from companion.link.transport import UdpTransport, open_transport
from tests.unit.link.transport.transport_ends import free_port
from tests.virtual_time import in_virtual_time


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


@in_virtual_time
async def answered_to(
    *heard: tuple[float, bytes, tuple[str, int]], system_id: int = 1, signing: LinkSigning | None = None
) -> list[object]:
    """Whom a listener writes to after each of these datagrams."""
    loop, wire = asyncio.get_running_loop(), Wire()
    transport = UdpTransport(system_id, signing)
    transport._socket = wire
    peers: list[object] = []
    for time_s, data, address in heard:
        await asyncio.sleep(time_s - loop.time())
        transport.datagram_received(data, address)
        wire.sent_to.clear()
        transport.write(b"setpoint")
        peers += wire.sent_to or [None]
    return peers


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


def test_an_autopilot_that_speaks_before_its_heartbeat_is_no_stranger_to_warn_of(
    caplog: pytest.LogCaptureFixture,
) -> None:
    peers = answered_to((0.0, b"attitude", AUTOPILOT), (0.9, HEARTBEAT, AUTOPILOT))
    assert (peers, caplog.messages) == ([None, AUTOPILOT], [])


def test_a_stranger_that_goes_on_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    answered_to(*((0.5 * i, heartbeat_of(2), STRAY) for i in range(20)))
    assert caplog.messages == ["link: 192.0.2.7:999 ignored: no heartbeat of system 1"]


@in_virtual_time
async def test_what_strangers_say_is_not_heard() -> None:
    transport = UdpTransport(1)
    transport.datagram_received(HEARTBEAT, AUTOPILOT)
    transport.datagram_received(heartbeat_of(1, 1), STRAY)
    transport.datagram_received(b"last", AUTOPILOT)
    assert (await transport.read(), transport.strangers) == (HEARTBEAT + b"last", 1)


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


async def test_a_port_in_use_is_reported_in_one_line() -> None:
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


# ---------------------------------------------------------------- signed

KEY = bytes(range(32))
STAMP = 30_000_000_000_000


def signed_heartbeat(stamp: int = STAMP, key: bytes = KEY) -> bytes:
    codec = Codec(1, 1)
    codec.sign(LinkSigning(key, stamp))
    kind, none = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4
    return codec.encode(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, 4, 3))


def our_signing() -> LinkSigning:
    return LinkSigning(KEY, STAMP)


@pytest.mark.parametrize(
    "data", [HEARTBEAT, signed_heartbeat(key=bytes(32))], ids=["unsigned", "with another key"]
)
def test_where_signatures_are_demanded_no_other_heartbeat_makes_a_peer(data: bytes) -> None:
    heard = (0.0, data, STRAY), (0.1, signed_heartbeat(), AUTOPILOT), (4.0, data, STRAY)
    assert answered_to(*heard, signing=our_signing()) == [None, AUTOPILOT, AUTOPILOT]


def test_a_heartbeat_that_is_sent_again_takes_no_peer_s_place() -> None:
    signing = our_signing()
    recorded = signed_heartbeat(STAMP + 5)
    assert signing.accepts(recorded)  # by the session, when it came
    assert signing.accepts(signed_heartbeat(STAMP + 9))
    peers = answered_to(
        (0.0, signed_heartbeat(STAMP + 19), AUTOPILOT), (4.0, recorded, STRAY), signing=signing
    )
    assert peers == [AUTOPILOT, AUTOPILOT]


def test_an_autopilot_with_an_old_time_is_answered_and_gives_way_to_a_fresh_one() -> None:
    old = signed_heartbeat(5)
    peers = answered_to(
        (0.0, old, AUTOPILOT),  # it cannot move on before it hears us
        (0.1, old, STRAY),
        (0.2, old, AUTOPILOT),
        (0.3, signed_heartbeat(), AUTOPILOT),
        (0.4, old, STRAY),
        (9.0, old, STRAY),
        signing=our_signing(),
    )
    assert peers == [AUTOPILOT, STRAY, AUTOPILOT, AUTOPILOT, AUTOPILOT, AUTOPILOT]


async def test_a_listener_on_a_signed_link_is_opened_with_the_key() -> None:
    port = free_port()
    listener = await open_transport(f"udpin:127.0.0.1:{port}", 1, our_signing())
    caller = await open_transport(f"udp:127.0.0.1:{port}")
    try:
        caller.write(HEARTBEAT)
        caller.write(signed_heartbeat())
        assert await asyncio.wait_for(listener.read(), 5.0) == signed_heartbeat()
    finally:
        caller.close()
        listener.close()
