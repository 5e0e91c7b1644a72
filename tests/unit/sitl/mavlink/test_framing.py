"""Frames out of bytes: no garbage costs a good frame, whatever it claims and however the bytes are cut."""

import hashlib
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from companion.link.codec import mavlink
from companion.link.signing import EPOCH_UNIX_S, STAMPS_PER_S, stamp_from_unix
from sitl.mavlink.endpoint import MavlinkEndpoint
from sitl.mavlink.framing import PATIENCE_S, FrameReader, MavFrame, Signing, number, read_key
from tests.unit.sitl.autopilot.autopilot_flight import AutopilotFlight

SENDER = mavlink.MAVLink(None, srcSystem=7, srcComponent=9)
COMMAND = bytes(mavlink.MAVLink_command_long_message(1, 2, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(SENDER))
PING = bytes(mavlink.MAVLink_timesync_message(0, 77).pack(SENDER))
OLD = bytes(mavlink.MAVLink_param_request_list_message(3, 4).pack(SENDER, force_mavlink1=True))


def data_of(reader: FrameReader, *chunks: bytes) -> list[bytes]:
    return [frame.data for chunk in chunks for frame in reader.read(chunk, 0.0)]


def test_a_frame_tells_who_sent_it_and_for_whom() -> None:
    cut = bytes(
        mavlink.MAVLink_param_request_list_message(1, 0).pack(SENDER)
    )  # zeros at the end are not sent
    command, *others = FrameReader().read(COMMAND + PING + OLD + cut, 0.0)
    assert (command.message_id, command.system, command.component, command.signed) == (76, 7, 9, False)
    assert [frame.target for frame in (command, *others)] == [(1, 2), (0, 0), (3, 4), (1, 0)]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_frames_may_come_in_any_pieces(sizes: list[int]) -> None:
    data, reader, found = COMMAND + OLD + PING, FrameReader(), []
    for size in [*sizes, len(data)]:
        found += data_of(reader, data[:size])
        data = data[size:]
    assert found == [COMMAND, OLD, PING]


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_no_garbage_before_it_in_a_datagram_costs_a_frame(garbage: bytes) -> None:
    assert data_of(FrameReader(datagrams=True), garbage + COMMAND)[-1] == COMMAND
    reader = FrameReader(datagrams=True)
    assert data_of(reader, garbage, COMMAND)[-1] == COMMAND
    assert not reader.waits


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_garbage_in_a_stream_delays_a_frame_but_does_not_cost_it(garbage: bytes) -> None:
    assert COMMAND in data_of(FrameReader(), garbage, COMMAND, PING * 20)


def test_a_false_beginning_is_given_up_after_a_while() -> None:
    reader = FrameReader()
    false_start = b"\xfd\xff\x00\x00\x01\x07\x09\x4c\x00\x00"
    assert not reader.read(false_start + COMMAND, 0.0)
    assert reader.waits
    assert not reader.read(b"", PATIENCE_S)
    assert [frame.data for frame in reader.read(b"", 1.1 * PATIENCE_S)] == [COMMAND]
    assert reader.skipped_bytes == len(false_start)


def test_a_wrong_check_sum_and_unknown_flags_are_no_frame() -> None:
    flags = COMMAND[:2] + b"\x02" + COMMAND[3:]
    assert not data_of(FrameReader(), COMMAND[:-1] + bytes([COMMAND[-1] ^ 1]), flags)


@pytest.mark.parametrize("value", [math.inf, -math.inf, 1e8, -3e38, math.nan])
def test_what_is_beyond_all_that_flies_is_not_given(value: float) -> None:
    assert math.isnan(number(value))
    assert number(-123.5) == -123.5


# ----------------
# Signing as the guide has it: who has the key is believed, once; of others, what may be unsigned.

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
NOW = 1000 * STAMPS_PER_S


def packer(key: bytes | None, stamp: int = NOW, link_id: int = 3) -> Any:
    made = mavlink.MAVLink(None, srcSystem=9, srcComponent=8)
    if key is not None:
        made.signing.secret_key, made.signing.sign_outgoing = key, True
        made.signing.timestamp, made.signing.link_id = stamp, link_id
    return made


def frame(key: bytes | None, stamp: int = NOW, link_id: int = 3, message: Any = None) -> MavFrame:
    message = message or mavlink.MAVLink_timesync_message(0, 5)
    (found,) = FrameReader().read(bytes(message.pack(packer(key, stamp, link_id))), 0.0)
    return found


@pytest.fixture
def signing() -> Signing:
    made = Signing("ardupilot", KEY)
    made.stamp = NOW
    return made


def test_the_right_key_is_believed_and_no_other(signing: Signing) -> None:
    good = frame(KEY)
    for at in (4, 12, len(good.data) - 1):  # a changed byte
        data = bytearray(good.data)
        data[at] ^= 1
        assert not signing.accepts(good._replace(data=bytes(data)))
    assert signing.accepts(good)
    # a forged time does not lock the owner out
    assert not signing.accepts(frame(OTHER, NOW + 10**9))
    assert not signing.accepts(frame(None))
    assert signing.refused == 5
    assert signing.accepts(frame(KEY, NOW + 2))
    assert Signing("px4").accepts(frame(None))


def test_what_was_heard_cannot_be_said_again_though_the_same_key_is_set_up_again(signing: Signing) -> None:
    assert signing.accepts(frame(KEY, NOW + 5))
    assert not signing.accepts(frame(KEY, NOW + 5))
    assert not signing.accepts(frame(KEY, NOW + 4))
    assert signing.accepts(frame(KEY, NOW + 4, link_id=4)), "another stream has another time"
    assert signing.accepts(frame(KEY, NOW + 6))
    signing.set_up(KEY, 0)
    assert not signing.accepts(frame(KEY, NOW + 6))
    signing.set_up(OTHER, 0)
    assert signing.accepts(frame(OTHER, NOW + 5))


def test_a_new_stream_may_be_a_minute_behind(signing: Signing) -> None:
    assert not signing.accepts(frame(KEY, NOW - 61 * STAMPS_PER_S))
    assert signing.accepts(frame(KEY, NOW - 60 * STAMPS_PER_S))


def test_some_messages_need_no_signature(autopilot_kind: AutopilotKind) -> None:
    signing = Signing(autopilot_kind, KEY)
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    status = mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)
    assert signing.accepts(frame(None, message=beat)) is (autopilot_kind == "px4")
    assert signing.accepts(frame(None, message=status))


def test_our_own_stamps_follow_the_clock_and_never_repeat(signing: Signing) -> None:
    ours, stamps = packer(None), []
    for since_s in (2000.0, 1990.0, 3000.0):
        signing.advance(EPOCH_UNIX_S + since_s)
        signing.prepare(ours, 2)
        for _ in range(3):
            data = mavlink.MAVLink_timesync_message(0, 5).pack(ours)
            stamps.append(int.from_bytes(data[-12:-6], "little"))
            assert data[-13] == 2
    assert stamps == sorted(set(stamps))
    assert stamps[0] == stamp_from_unix(EPOCH_UNIX_S + 2000.0)
    assert stamps[-1] >= 3000 * STAMPS_PER_S


def test_a_key_is_set_up_and_ended_over_the_link() -> None:
    endpoint = MavlinkEndpoint(AutopilotFlight("px4").autopilot, unix_at_start_s=EPOCH_UNIX_S + 1000.0)
    unsigned, signed = packer(None), packer(KEY)

    def answers(sender: Any, message: Any = None) -> list[Any]:
        message = message or mavlink.MAVLink_timesync_message(0, 5)
        endpoint.receive(bytes(message.pack(sender)), 0.0)
        listener = mavlink.MAVLink(None)
        heard = listener.parse_buffer(bytearray(b"".join(endpoint.answers(0.0)))) or []
        return [m for m in heard if m.get_type() == "TIMESYNC"]

    assert answers(unsigned)
    answers(unsigned, mavlink.MAVLink_setup_signing_message(1, 1, KEY, NOW))
    assert not answers(unsigned)
    (answer,) = answers(signed)
    assert answer.get_header().incompat_flags & 1
    answers(signed, mavlink.MAVLink_setup_signing_message(1, 1, bytes(32), 0))
    assert answers(unsigned)


def test_a_key_file_holds_the_key_or_a_passphrase(tmp_path: Path) -> None:
    raw, words, empty = tmp_path / "raw", tmp_path / "words", tmp_path / "empty"
    raw.write_bytes(KEY)
    words.write_bytes(b"open sesame\n")
    empty.write_bytes(b"\n")
    assert read_key(raw) == KEY
    assert read_key(words) == hashlib.sha256(b"open sesame").digest()
    with pytest.raises(ConfigError, match="empty; expected 32 bytes or a passphrase"):
        read_key(empty)
    with pytest.raises(ConfigError, match="No such file or directory; expected a file with the key"):
        read_key(tmp_path / "none")
