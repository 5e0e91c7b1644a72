"""The NEO-6M's driver on hand-made bytes and on the simulated receiver's."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.commands import configuration
from companion.sense.gps.fixes import EpochClock
from companion.sense.gps.frames import FrameSplitter
from companion.sense.gps.line import SILENCE_S
from companion.sense.gps.neo6m import Neo6m
from sitl.devices.neo6m import Neo6mDevice, nmea, ubx
from sitl.sensors.sensors import NO_GPS_ERRORS, GpsSensor

HOME: Vector3 = (47.0, 8.0, 400.0)
BYTE_S = 10.0 / 9600.0
CONFIG = GpsConfig(baud=9600)  # what the hand-made bytes are timed for
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


def rmc(time: str = "120001.00", status: str = "A", course: str = "90.00") -> bytes:
    return nmea(f"GPRMC,{time},{status},4730.00000,N,00815.00000,W,10.000,{course},070126,,,A")


def gga(time: str = "120001.00", quality: int = 1) -> bytes:
    return nmea(f"GPGGA,{time},4730.00000,N,00815.00000,W,{quality},07,1.50,410.5,M,47.0,M,,")


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


# ---------------------------------------------------------------- settings


def acknowledge(command: bytes, kind: int = 1) -> bytes:
    return ubx(5, kind, command[2:4])


def test_the_commands_are_those_of_the_protocol() -> None:
    commands = configuration(CONFIG, 38400)
    assert ubx(6, 8, struct.pack("<HHH", 200, 1, 1)) in commands
    assert ubx(6, 1, bytes((1, 2, 0, 1, 0, 0, 0, 0))) in commands
    assert ubx(6, 1, bytes((0xF0, 4, 0, 0, 0, 0, 0, 0))) in commands
    assert len(commands) == 14


def test_one_command_at_a_time_and_the_next_after_its_answer() -> None:
    receiver = Neo6m(CONFIG)
    commands = configuration(CONFIG, 9600)
    sent = []
    for k in range(len(commands)):
        sent.append(receiver.pending(float(k)))
        assert receiver.pending(k + 0.1) == b""
        receiver.feed(acknowledge(sent[-1]), k + 0.2)
    assert sent == commands
    assert receiver.configured
    assert receiver.pending(20.0) == b""


def test_an_answer_to_something_else_is_no_answer() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    receiver.feed(ubx(5, 1, bytes((6, 0x13))), 0.1)
    assert receiver.pending(0.2) == b""
    assert receiver.pending(1.1) == first


def test_a_lost_answer_is_asked_for_again_and_silence_is_told() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    for k in range(4):
        receiver.feed(rmc() + gga(), 0.9 + k)
        assert receiver.pending(1.0 + k) == first
        assert receiver.problem is None
    receiver.feed(rmc() + gga(), 5.9)
    assert receiver.pending(6.0) == first
    assert receiver.problem == "NEO-6M: no answer to CFG-PRT"
    receiver.feed(acknowledge(first), 6.1)
    receiver.pending(6.2)
    assert receiver.problem is None


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "nothing received: check its power and wiring"),
        (b"\x00\xf8\x80", "no message at 9600 baud: trying other rates"),
        (ubx(5, 1, bytes((6, 0x13))), "no fix"),
    ],
)
def test_the_first_thing_that_is_missing_is_told_and_forgotten_when_it_comes(data: bytes, words: str) -> None:
    receiver = Neo6m(CONFIG)
    for k in range(20):
        if data:
            receiver.feed(data, 0.2 * k)
        receiver.pending(0.2 * k + 0.1)
        assert receiver.problem is None or k >= 14
    assert receiver.problem == f"NEO-6M: {words}"
    receiver.feed(rmc() + gga(), 4.1)
    receiver.pending(4.2)
    assert receiver.problem is None


def test_a_refused_command_is_told_and_passed_over() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    receiver.feed(acknowledge(first, kind=0), 0.1)
    assert receiver.pending(0.2) == configuration(CONFIG, 9600)[1]
    assert receiver.problem == "NEO-6M: refuses CFG-PRT"


# ---------------------------------------------------------------- with the simulated receiver


class Rig:
    """Receiver and driver on an ideal line."""

    def __init__(self) -> None:
        self.device = Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(5), HOME), latency_s=0.12)
        self.driver = Neo6m(CONFIG)
        self.fixes: list[GpsFix] = []
        self.now_s = 0.0

    def run(
        self, seconds: float, position: Vector3 = (0.0, 0.0, 0.0), velocity: Vector3 = (0.0, 0.0, 0.0)
    ) -> None:
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            p = tuple(p + v * self.now_s for p, v in zip(position, velocity, strict=True))
            data = self.device.step(self.now_s, (p[0], p[1], p[2]), velocity)
            # on the line from now on: the last byte comes as many byte times later
            self.fixes += self.driver.feed(data, self.now_s + len(data) * BYTE_S) if data else []
            self.device.receive(self.driver.pending(self.now_s))


def test_the_receiver_is_configured_and_sends_five_fixes_a_second() -> None:
    rig = Rig()
    rig.run(5.0)
    assert rig.driver.configured
    assert rig.driver.problem is None
    before = len(rig.fixes)
    rig.run(4.0)
    assert len(rig.fixes) - before == 20


@pytest.mark.parametrize("heading_deg", [0, 90, 180, 270])
def test_fixes_are_where_and_when_the_antenna_was(heading_deg: int) -> None:
    rig = Rig()
    heading = math.radians(heading_deg)
    velocity = (5.0 * math.cos(heading), 5.0 * math.sin(heading), -1.0)
    rig.run(8.0, (3.0, -4.0, -10.0), velocity)
    fix = rig.fixes[-1]
    north, east, down = ned_from_geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m, HOME)
    expected = [p + v * fix.time_s for p, v in zip((3.0, -4.0, -10.0), velocity, strict=True)]
    # the receiver samples on a 10 ms grid here: 5 cm at this speed
    assert (north, east, down) == pytest.approx(expected, abs=0.06)
    assert fix.velocity_ned_m_s == pytest.approx(velocity, abs=0.01)


def test_a_sky_out_of_sight_is_silence_until_it_is_seen_again() -> None:
    rig = Rig()
    rig.run(5.0)
    rig.device.has_fix = False
    rig.run(0.5)
    before = len(rig.fixes)
    rig.run(5.0)
    assert len(rig.fixes) == before
    rig.device.has_fix = True
    rig.run(2.0)
    assert len(rig.fixes) >= before + 9


def test_a_receiver_that_lost_power_is_configured_anew() -> None:
    rig = Rig()
    rig.run(5.0)
    rig.device.power_cycle()
    rig.run(SILENCE_S + 6.0)
    assert rig.driver.configured
    before = len(rig.fixes)
    rig.run(2.0)
    assert len(rig.fixes) - before == 10


def test_until_it_is_configured_nmea_gives_the_position() -> None:
    device = Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(5), HOME))
    driver = Neo6m(CONFIG)
    found: list[GpsFix] = []
    for k in range(400):
        data = device.step(0.01 * k, (10.0, 20.0, -5.0), (3.0, 4.0, 0.0))
        found += driver.feed(data, 0.01 * k + len(data) * BYTE_S)
    assert len(found) == 3
    where = ned_from_geodetic(found[0].latitude_deg, found[0].longitude_deg, found[0].altitude_m, HOME)
    assert where == pytest.approx((10.0, 20.0, -5.0), abs=0.1)
    assert found[0].velocity_ned_m_s == pytest.approx((3.0, 4.0, 0.0), abs=0.02)
