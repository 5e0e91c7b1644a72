"""The NEO-6M's driver on hand-made bytes: UBX, NMEA, and what a line does to them."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.messages import GpsFix
from companion.sense.gps.baud_rate import SILENCE_S
from companion.sense.gps.fixes import EpochClock
from companion.sense.gps.framing import FrameSplitter
from companion.sense.gps.neo6m import Neo6m
from sitl.devices.neo6m import nmea, ubx
from tests.unit.sense.gps.nmea import BYTE_S, CONFIG, gga, rmc

TIME_OF_WEEK_MS = 302_400_200


def posllh(itow: int = TIME_OF_WEEK_MS) -> bytes:
    return ubx(1, 0x02, struct.pack("<IiiiiII", itow, -75_1234567, 47_7654321, 447_000, 400_500, 2500, 3750))


def velned(itow: int = TIME_OF_WEEK_MS) -> bytes:
    return ubx(1, 0x12, struct.pack("<IiiiIIiII", itow, 150, -250, 75, 301, 292, 0, 30, 0))


def sol(itow: int = TIME_OF_WEEK_MS, fix: int = 3, flags: int = 0x0D) -> bytes:
    fields = (itow, 0, 2400, fix, flags, 0, 0, 0, 0, 0, 0, 0, 0, 180, 0, 9, 0)
    return ubx(1, 0x06, struct.pack("<IihBBiiiIiiiIHBBI", *fields))


def fixes(data: bytes) -> list[GpsFix]:
    return Neo6m(CONFIG).feed(data, 100.0)


# ---------------------------------------------------------------- UBX


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_three_messages_of_one_epoch_make_one_fix(order: tuple[int, int, int]) -> None:
    parts = (posllh(), velned(), sol())
    (fix,) = fixes(b"".join(parts[k] for k in order))
    assert fix.latitude_deg == pytest.approx(47.7654321, abs=1e-9)
    assert fix.longitude_deg == pytest.approx(-75.1234567, abs=1e-9)
    assert fix.altitude_m == pytest.approx(400.5)  # above mean sea level, not the ellipsoid's 447
    assert fix.velocity_ned_m_s == pytest.approx((1.5, -2.5, 0.75))
    assert (fix.horizontal_accuracy_m, fix.vertical_accuracy_m) == pytest.approx((2.5, 3.75))
    assert fix.speed_accuracy_m_s == pytest.approx(0.3)
    assert fix.satellites == 9


def test_messages_of_two_epochs_are_not_joined() -> None:
    later = TIME_OF_WEEK_MS + 200
    assert fixes(posllh() + velned() + sol(later)) == []
    assert len(fixes(posllh() + sol(later) + posllh(later) + velned(later))) == 1


@pytest.mark.parametrize(("fix", "flags"), [(0, 0x0D), (1, 0x0D), (2, 0x0D), (5, 0x0D), (3, 0x0C)])
def test_no_three_dimensional_fix_is_no_position(fix: int, flags: int) -> None:
    assert fixes(posllh() + velned() + sol(fix=fix, flags=flags)) == []


def test_time_is_the_epochs_less_transmission_and_latency() -> None:
    """All 140 bytes read at 100 s in one piece: the first bit left 140 byte times before."""
    data = posllh() + velned() + sol()
    (fix,) = fixes(data)
    assert len(data) == 140
    assert fix.time_s == pytest.approx(100.0 - len(data) * BYTE_S - CONFIG.latency_s)


def test_time_does_not_depend_on_the_pieces() -> None:
    data = posllh() + velned() + sol()
    receiver = Neo6m(CONFIG)
    found = [
        fix
        for end in range(1, len(data) + 1)
        for fix in receiver.feed(data[end - 1 : end], 100.0 - (len(data) - end) * BYTE_S)
    ]
    assert found[0].time_s == pytest.approx(fixes(data)[0].time_s)


def test_a_reader_woken_late_does_not_make_a_fix_younger() -> None:
    receiver = Neo6m(CONFIG)
    times = []
    for k in range(50):
        itow = TIME_OF_WEEK_MS + 200 * k
        late_s = 0.15 if k % 7 == 3 else 0.0
        data = posllh(itow) + velned(itow) + sol(itow)
        times += [fix.time_s for fix in receiver.feed(data, 10.0 + 0.2 * k + late_s)]
    assert np.diff(times) == pytest.approx(np.full(49, 0.2), abs=1e-3)


def test_epoch_clock_follows_drift_and_jumps() -> None:
    clock = EpochClock()
    for k in range(3000):
        local_s = clock.local_s(0.2 * k, 5.0 + 0.2 * k * (1.0 + 30e-6))
    assert local_s == pytest.approx(5.0 + 0.2 * 2999 * (1.0 + 30e-6), abs=1e-3)
    # the week rolls over: the time of week starts at nought, our clock does not
    assert clock.local_s(0.0, 700.0) == 700.0


# ---------------------------------------------------------------- what a line does to bytes


@pytest.mark.parametrize("flip", [0, 2, 4, 10, 30, -1])
def test_a_damaged_message_is_no_fix_and_the_next_epoch_is(flip: int) -> None:
    damaged = bytearray(posllh())
    damaged[flip] ^= 0x04
    later = TIME_OF_WEEK_MS + 200
    good = posllh(later) + velned(later) + sol(later)
    found = fixes(bytes(damaged) + velned() + sol() + good + bytes(1100))
    assert len(found) == 1


@pytest.mark.parametrize("cut", range(1, 44))
def test_half_a_message_does_not_swallow_what_follows(cut: int) -> None:
    """Where a length is garbled, the message seems to be hundreds of bytes: later ones are still found."""
    epochs = range(TIME_OF_WEEK_MS + 200, TIME_OF_WEEK_MS + 1200, 200)
    data = posllh()[:cut] + b"".join(posllh(t) + velned(t) + sol(t) for t in epochs)
    assert len(fixes(data)) == 5


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(max_size=30), max_size=8), st.integers(1, 40))
def test_garbage_before_whole_epochs_survives(noise: list[bytes], step: int) -> None:
    receiver = Neo6m(CONFIG)
    data = b"".join(noise) + b"".join(
        posllh(t) + velned(t) + sol(t) for t in range(TIME_OF_WEEK_MS, TIME_OF_WEEK_MS + 3000, 200)
    )
    found: list[GpsFix] = []
    for start in range(0, len(data), step):
        found += receiver.feed(data[start : start + step], 10.0 + start * BYTE_S)
    # a length in the noise can at worst hide the half kilobyte behind it
    assert len(found) >= 11
    assert all(fix.latitude_deg == pytest.approx(47.7654321) for fix in found)


@settings(max_examples=60)
@given(st.binary(max_size=300))
def test_the_splitter_returns_whole_messages_whatever_comes(data: bytes) -> None:
    splitter = FrameSplitter(9600)
    for message in splitter.feed(data, 1.0) + splitter.feed(posllh() + bytes(1200), 2.0):
        assert message.data[:1] in (b"\xb5", b"$")
        assert message.began_s <= 2.0


# ---------------------------------------------------------------- NMEA


def test_rmc_and_gga_of_one_second_make_a_fix() -> None:
    (fix,) = fixes(rmc() + gga())
    assert (fix.latitude_deg, fix.longitude_deg, fix.altitude_m) == pytest.approx((47.5, -8.25, 410.5))
    assert fix.velocity_ned_m_s == pytest.approx((0.0, 5.1444, 0.0), abs=1e-3)
    assert fix.horizontal_accuracy_m == pytest.approx(3.75)
    assert fix.satellites == 7


def test_a_receiver_at_rest_leaves_the_course_out() -> None:
    (fix,) = fixes(rmc(course="") + gga())
    assert fix.velocity_ned_m_s == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        rmc(status="V") + gga(),
        rmc() + gga(quality=0),
        rmc("120001.00") + gga("120002.00"),
        nmea("GPGSA,A,2,01,02,03,,,,,,,,,,2.00,1.00,1.70") + rmc() + gga(),
        nmea("GPRMC,,V,,,,,,,,,,N") + nmea("GPGGA,,,,,,0,00,99.99,,,,,,"),
        rmc().replace(b"4730", b"4731") + gga(),
    ],
)
def test_nmea_without_a_good_fix_is_no_position(data: bytes) -> None:
    assert fixes(data) == []


def test_nmea_is_silent_beside_ubx_and_serves_when_ubx_stops() -> None:
    receiver = Neo6m(CONFIG)
    assert len(receiver.feed(posllh() + velned() + sol(), 10.0)) == 1
    assert receiver.feed(rmc("120001.00") + gga("120001.00"), 11.0) == []
    assert len(receiver.feed(rmc("120009.00") + gga("120009.00"), 11.0 + SILENCE_S)) == 1
