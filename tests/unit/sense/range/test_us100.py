"""The polled ultrasonic's driver: what counts is when bytes come."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import RangeConfig
from companion.sense.range.us100 import Us100
from sitl.devices.ultrasonic import millimetres

CONFIG = RangeConfig(kind="polled", rate_hz=10.0)
BYTE_S = 10.0 / 9600.0


def asked(now_s: float = 0.0) -> Us100:
    driver = Us100(CONFIG)
    assert driver.pending(now_s) == b"\x55"
    return driver


def test_it_asks_at_its_rate() -> None:
    driver = Us100(CONFIG)
    asked_at = [k for k in range(100) if driver.pending(0.01 * k)]
    assert asked_at == list(range(0, 100, 10))


def test_two_bytes_are_millimetres_the_high_one_first() -> None:
    (sample,) = asked().feed(b"\x07\xa1", 0.02)
    assert sample.distance_m == 1.953
    assert sample.time_s == pytest.approx(0.02 - 2 * BYTE_S - 1.953 / 340.0)


def test_an_answer_in_two_pieces_is_one() -> None:
    driver = asked()
    assert driver.feed(b"\x07", 0.01) == []
    assert [s.distance_m for s in driver.feed(b"\xa1", 0.011)] == [1.953]


@pytest.mark.parametrize(
    ("data", "taken"),
    [
        *((millimetres(n / 1000.0), n in (30, 4500)) for n in (0, 29, 30, 4500, 4501)),
        (b"\xff\xff", False),
        (b"\x00\x07\xa1", False),  # more than an answer is noise
    ],
)
def test_only_distances_within_the_range_are_taken(data: bytes, taken: bool) -> None:
    assert len(asked().feed(data, 0.03)) == taken


def test_what_comes_without_a_question_is_no_answer() -> None:
    driver = Us100(CONFIG)
    assert driver.feed(b"\x07\xa1", 0.0) == []
    driver.pending(0.1)
    assert len(driver.feed(b"\x07\xa1", 0.12)) == 1
    assert driver.feed(b"\x07\xa1", 0.14) == []


def test_half_an_answer_does_not_shift_the_next_one() -> None:
    driver = asked()
    assert driver.feed(b"\x07", 0.02) == []
    driver.pending(0.1)
    assert [s.distance_m for s in driver.feed(b"\x03\xe8", 0.12)] == [1.0]


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=6), max_size=20))
def test_anything_at_all_survives(pieces: list[bytes]) -> None:
    driver = Us100(CONFIG)
    for k, piece in enumerate(pieces):
        driver.pending(0.05 * k)
        for sample in driver.feed(piece, 0.05 * k + 0.01):
            assert 0.03 <= sample.distance_m <= 4.5
    driver.pending(10.0)
    assert [s.distance_m for s in driver.feed(b"\x03\xe8", 10.02)] == [1.0]


def problem_at(driver: Us100, now_s: float) -> str | None:
    driver.watch(now_s)
    return driver.problem


def test_a_sensor_that_says_nothing_is_reported_and_forgotten_when_it_speaks() -> None:
    driver = Us100(CONFIG)
    assert problem_at(driver, 0.0) is None
    assert problem_at(driver, 0.9) is None
    assert problem_at(driver, 1.1) == "ultrasonic: nothing received"
    driver.pending(1.2)
    driver.feed(b"\x07", 1.2)
    assert problem_at(driver, 1.3) == "ultrasonic: no answer in what is received"
    driver.pending(1.4)
    driver.feed(b"\x00\x00", 1.43)  # no echo is no fault
    assert problem_at(driver, 1.5) is None


@pytest.mark.parametrize("piece", [1, 2, 4])
def test_a_sensor_that_answers_with_frames_is_named_and_not_believed(piece: int) -> None:
    driver, taken = Us100(CONFIG), 0
    for k in range(30):
        now_s = 0.1 * k
        driver.pending(now_s)
        driver.watch(now_s)
        high, low = divmod(1500 + k, 256)
        frame = bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))
        for at in range(0, 4, piece):
            taken += len(driver.feed(frame[at : at + piece], now_s + 0.01 + 0.001 * at))
    assert taken == 0
    assert driver.problem is not None
    assert "4-byte frames, as a JSN-SR04T" in driver.problem
