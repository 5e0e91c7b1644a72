"""The ultrasonic's parser, on hand-made frames and on the simulated sensor's."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import RangeConfig
from companion.sense.range.ultrasonic import Ultrasonic
from sitl.devices.ultrasonic import frame

BYTE_S = 10.0 / 9600.0


def distances(data: bytes) -> list[float]:
    return [sample.distance_m for sample in Ultrasonic(RangeConfig()).feed(data, 1.0)]


def test_the_data_sheets_example_is_1953_mm() -> None:
    assert distances(bytes.fromhex("ff07a1a7")) == [1.953]


def test_time_is_when_the_sound_met_the_ground() -> None:
    """Sound is back 2d/c after the ping; it met the ground half way; then four bytes take 4.17 ms."""
    (sample,) = Ultrasonic(RangeConfig()).feed(bytes.fromhex("ff07a1a7"), 10.0)
    assert sample.time_s == pytest.approx(10.0 - 4 * BYTE_S - 1.953 / 340.0)


def test_time_of_a_frame_with_others_behind_it_counts_their_bytes_too() -> None:
    both = Ultrasonic(RangeConfig()).feed(frame(1.0) + frame(2.0), 10.0)
    assert both[0].time_s == pytest.approx(10.0 - 8 * BYTE_S - 1.0 / 340.0)
    assert both[1].time_s == pytest.approx(10.0 - 4 * BYTE_S - 2.0 / 340.0)


def test_a_frame_in_single_bytes_is_found() -> None:
    parser = Ultrasonic(RangeConfig())
    found = [sample for byte in frame(0.5) for sample in parser.feed(bytes((byte,)), 1.0)]
    assert [sample.distance_m for sample in found] == [0.5]


@pytest.mark.parametrize(
    ("millimetres", "taken"),
    [(0, False), (29, False), (30, True), (4500, True), (4501, False), (65279, False)],
)
def test_only_distances_within_the_range_are_taken(millimetres: int, taken: bool) -> None:
    assert distances(frame(millimetres / 1000.0)) == ([millimetres / 1000.0] if taken else [])


@pytest.mark.parametrize(
    ("data", "taken"),
    [
        (frame(1.0).replace(frame(1.0)[2:3], b"\x00", 1) + frame(2.0), [2.0]),  # damaged
        (frame(1.0)[:3] + frame(2.0), [2.0]),  # half of one
        (frame(0.255) + frame(0.511), [0.255, 0.511]),  # 255 mm: 0xFF 0x00 0xFF 0xFE, a header byte within
    ],
)
def test_what_is_no_whole_frame_costs_no_other(data: bytes, taken: list[float]) -> None:
    assert distances(data) == taken


@settings(max_examples=60)
@given(st.binary(max_size=40).filter(lambda noise: b"\xff" not in noise), st.integers(30, 4500))
def test_garbage_before_a_frame_does_no_harm(noise: bytes, millimetres: int) -> None:
    assert distances(noise + frame(millimetres / 1000.0)) == [millimetres / 1000.0]


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=9), max_size=20))
def test_anything_at_all_survives(pieces: list[bytes]) -> None:
    parser = Ultrasonic(RangeConfig())
    for piece in pieces:
        for sample in parser.feed(piece, 1.0):
            assert 0.03 <= sample.distance_m <= 4.5
    # whatever came: three frames later at the latest it is in step again
    tail = [sample.distance_m for _ in range(3) for sample in parser.feed(frame(1.234), 2.0)]
    assert tail[-1] == 1.234


# ---------------------------------------------------------------- faults


def problem_at(parser: Ultrasonic, now_s: float) -> str | None:
    parser.watch(now_s)
    return parser.problem


def test_a_sensor_that_says_nothing_is_reported_and_forgotten_when_it_speaks() -> None:
    parser = Ultrasonic(RangeConfig())
    assert problem_at(parser, 10.0) is None
    assert problem_at(parser, 10.9) is None
    assert problem_at(parser, 11.1) == "ultrasonic: nothing received"
    parser.feed(frame(1.0), 11.5)
    assert problem_at(parser, 12.0) is None
    assert problem_at(parser, 13.0) == "ultrasonic: nothing received"


def test_no_echo_is_no_fault() -> None:
    parser = Ultrasonic(RangeConfig())
    for k in range(30):
        assert parser.feed(frame(None), 0.1 * k) == []
        assert problem_at(parser, 0.1 * k) is None


def test_bytes_that_make_no_frame_are_reported() -> None:
    parser = Ultrasonic(RangeConfig())
    for k in range(30):
        parser.feed(b"\x12\x34", 0.1 * k)
        parser.watch(0.1 * k)
    assert parser.problem == "ultrasonic: no frame in what is received"
