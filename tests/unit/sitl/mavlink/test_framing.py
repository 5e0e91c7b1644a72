"""Frames out of bytes: no garbage costs a good frame, whatever it claims and however the bytes are cut."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.mavlink.framing import PATIENCE_S, FrameReader, dialect, number

mavlink: Any = dialect
SENDER = mavlink.MAVLink(None, srcSystem=7, srcComponent=9)
COMMAND = bytes(mavlink.MAVLink_command_long_message(1, 2, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(SENDER))
PING = bytes(mavlink.MAVLink_timesync_message(0, 77).pack(SENDER))
OLD = bytes(mavlink.MAVLink_param_request_list_message(3, 4).pack(SENDER, force_mavlink1=True))


def data_of(reader: FrameReader, *chunks: bytes) -> list[bytes]:
    return [frame.data for chunk in chunks for frame in reader.read(chunk, 0.0)]


def test_a_frame_tells_who_sent_it_and_for_whom() -> None:
    command, ping, old = FrameReader().read(COMMAND + PING + OLD, 0.0)
    assert (command.message_id, command.system, command.component, command.signed) == (76, 7, 9, False)
    assert (command.target, ping.target, old.target) == ((1, 2), (0, 0), (3, 4))


def test_zeros_cut_off_at_the_end_are_a_target_of_all() -> None:
    request = bytes(mavlink.MAVLink_param_request_list_message(1, 0).pack(SENDER))
    (frame,) = FrameReader().read(request, 0.0)
    assert frame.target == (1, 0)


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
