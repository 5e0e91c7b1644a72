"""The link against anything that may come down a line."""

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import LinkConfig
from companion.link.codec import Codec, heartbeat, mavlink
from companion.link.session import Session
from companion.link.signing import LinkSigning
from companion.link.streams import HEARD

GOOD = Codec(1, 1).encode(
    mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 1, 393216, mavlink.MAV_STATE_ACTIVE, 3
    )
)
LONGEST_FRAME = 280
# garbage that looks like frames is the hard kind
NOISE = st.lists(
    st.one_of(st.binary(max_size=30), st.just(b"\xfd"), st.just(b"\xfe\x09"), st.just(GOOD[:15])), max_size=12
).map(b"".join)


@settings(max_examples=150, deadline=None)
@given(noise=NOISE, cuts=st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_a_good_message_after_any_garbage_is_heard(noise: bytes, cuts: list[int]) -> None:
    stream = noise + GOOD + bytes(LONGEST_FRAME)
    codec, found = Codec(1), 0
    for i in range(len(stream)):
        cut = cuts[i % len(cuts)]
        piece, stream = stream[:cut], stream[cut:]
        found += sum(m.get_type() == "HEARTBEAT" and m.custom_mode == 393216 for m in codec.decode(piece))
    assert found == 1


@settings(max_examples=100, deadline=None)
@given(damage=st.integers(0, len(GOOD) - 1), flip=st.integers(1, 255))
def test_a_damaged_message_is_never_heard(damage: int, flip: int) -> None:
    broken = bytearray(GOOD)
    broken[damage] ^= flip
    sane = Codec(1, 1).encode(heartbeat())
    heard = Codec(1).decode(bytes(broken) + sane + bytes(LONGEST_FRAME))
    assert [m.autopilot for m in heard] == [mavlink.MAV_AUTOPILOT_INVALID]


@settings(max_examples=100, deadline=None)
@given(
    message_id=st.one_of(st.sampled_from(sorted(HEARD)), st.sampled_from(sorted(mavlink.mavlink_map))),
    payload=st.binary(min_size=255, max_size=255),
    source=st.sampled_from([(1, 1), (1, 191), (255, 190), (7, 1)]),
)
def test_no_content_of_a_well_formed_message_upsets_the_session(
    message_id: int, payload: bytes, source: tuple[int, int]
) -> None:
    kind = mavlink.mavlink_map[message_id]
    size = kind.unpacker.size
    head = bytes([size, 0, 0, 0, *source]) + message_id.to_bytes(3, "little")
    covered = head + payload[:size]
    check = mavlink.x25crc(covered + bytes([kind.crc_extra])).crc
    session = Session(LinkConfig())
    session.receive(GOOD, 1.0)
    session.receive(b"\xfd" + covered + check.to_bytes(2, "little"), 1.1)
    session.tick(1.2)
    assert session.counters.skipped_bytes == 0


# ----------------
# Signed links against whoever listens and sends: forged, replayed, out of order, from other systems.

KEY, STAMP = bytes(range(32)), 30_000_000_000_000
FRAMES = 12


def signing(secret: bytes = KEY, stamp: int = STAMP, kept_stamp: int = 0) -> LinkSigning:
    return LinkSigning(secret, stamp, kept_stamp)


def frames_of(secret: bytes, stamp: int, system_id: int, count: int = FRAMES) -> list[bytes]:
    codec = Codec(system_id, 1)
    codec.sign(signing(secret, stamp))
    return [codec.encode(heartbeat(number)) for number in range(count)]


def receiver(kept_stamp: int = 0) -> Codec:
    codec = Codec(1)
    codec.sign(signing(kept_stamp=kept_stamp))
    return codec


@settings(max_examples=60, deadline=None)
@given(
    order=st.lists(st.tuples(st.sampled_from([1, 7, 255]), st.integers(0, FRAMES - 1)), max_size=40),
    restart_at=st.integers(0, 40),
)
def test_no_frame_is_accepted_twice_nor_after_a_later_one_of_its_stream(
    order: list[tuple[int, int]], restart_at: int
) -> None:
    sent = {system: frames_of(KEY, STAMP, system) for system in (1, 7, 255)}
    ours, latest = signing(), dict.fromkeys(sent, -1)
    for step, (system, number) in enumerate(order):
        if step == restart_at:
            ours = signing(stamp=0, kept_stamp=ours.stamp)  # with a clock that is behind
        accepted = ours.accepts(sent[system][number])
        assert not (accepted and number <= latest[system])
        latest[system] = max(latest[system], number) if accepted else latest[system]


@settings(max_examples=60, deadline=None)
@given(
    secret=st.binary(min_size=32, max_size=32).filter(lambda secret: secret != KEY),
    ahead=st.integers(-(10**12), 10**13),
    at=st.integers(0, FRAMES - 1),
    system_id=st.sampled_from([1, 7, 255]),
)
def test_whatever_is_forged_the_true_sender_is_heard(
    secret: bytes, ahead: int, at: int, system_id: int
) -> None:
    ours, heard = receiver(), 0
    for number, frame in enumerate(frames_of(KEY, STAMP, 1)):
        if number == at:
            (forged,) = frames_of(secret, STAMP + ahead, system_id, 1)
            assert ours.decode(forged) == []
        heard += len(ours.decode(frame))
    assert (heard, ours.counters.refused) == (FRAMES, 1)


@settings(max_examples=100, deadline=None)
@given(place=st.integers(1, 35), flip=st.integers(1, 255))
def test_no_byte_of_a_signed_frame_can_be_changed(place: int, flip: int) -> None:
    (frame,) = frames_of(KEY, STAMP, 1, 1)
    changed = bytearray(frame)
    changed[place % len(frame) or 1] ^= flip
    assert not signing().accepts(changed)
    assert signing().accepts(frame)
