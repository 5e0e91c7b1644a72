"""Signed links against whoever listens and sends: forged, replayed, out of order, from other systems."""

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.link.codec import Codec, heartbeat
from companion.link.signing import LinkSigning, SigningKey

KEY, STAMP = bytes(range(32)), 30_000_000_000_000
FRAMES = 12


def signing(secret: bytes = KEY, stamp: int = STAMP, kept_stamp: int = 0) -> LinkSigning:
    return LinkSigning(SigningKey(secret, stamp, kept_stamp))


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
