"""The NEO-6M's settings, and its driver on the simulated receiver."""

import math
import struct

import numpy as np
import pytest

from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import GpsFix
from companion.sense.gps.baud_rate import SILENCE_S
from companion.sense.gps.commands import VERSION_REQUEST, conclusion, configuration, trial
from companion.sense.gps.neo6m import UNHEARD, Neo6m
from sitl.devices.neo6m import Neo6mDevice, ubx
from sitl.sensors.sensors import NO_GPS_ERRORS, GpsSensor
from tests.unit.sense.gps.nmea import BYTE_S, CONFIG, gga, rmc
from tests.unit.sense.gps.test_gps_trust import posllh, sol, velned

HOME: Vector3 = (47.0, 8.0, 400.0)


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
    asked, concluded = trial(CONFIG, 9600), conclusion(CONFIG)
    sent = []
    for k in range(len(asked)):
        sent.append(receiver.pending(float(k)))
        assert receiver.pending(k + 0.1) == b""
        receiver.feed(acknowledge(sent[-1]), k + 0.2)
    assert sent == asked
    # NMEA is not switched off before fixes come as asked for
    assert receiver.pending(7.3) == VERSION_REQUEST
    assert receiver.pending(7.4) == b""
    assert not receiver.configured
    receiver.feed(posllh(1) + velned(1) + sol(1), 7.5)
    receiver.pending(7.6)
    for k in range(len(concluded)):
        assert receiver.pending(8.0 + k) == concluded[k]
        receiver.feed(acknowledge(concluded[k]), 8.2 + k)
    assert receiver.configured


def test_an_answer_to_something_else_is_no_answer() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    receiver.feed(ubx(5, 1, bytes((6, 0x13))), 0.1)
    assert receiver.pending(0.2) == b""
    assert receiver.pending(1.1) == first


def test_a_lost_answer_is_asked_for_again_and_silence_is_reported() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    for k in range(4):
        receiver.feed(rmc() + gga(), 0.9 + k)
        assert receiver.pending(1.0 + k) == first
        assert receiver.problem is None
    receiver.feed(rmc() + gga(), 5.9)
    assert receiver.pending(6.0) == first
    assert receiver.problem == f"NEO-6M: no answer to CFG-PRT: {UNHEARD}"
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
def test_the_first_thing_that_is_missing_is_reported_and_forgotten_when_it_comes(
    data: bytes, words: str
) -> None:
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


def test_a_refused_command_is_reported_and_passed_over() -> None:
    receiver = Neo6m(CONFIG)
    first = receiver.pending(0.0)
    receiver.feed(acknowledge(first, kind=0), 0.1)
    assert receiver.pending(0.2) == configuration(CONFIG, 9600)[1]
    assert receiver.problem == "NEO-6M: refuses CFG-PRT"


class ReceiverRig:
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
    rig = ReceiverRig()
    rig.run(5.0)
    assert rig.driver.configured
    assert rig.driver.problem is None
    before = len(rig.fixes)
    rig.run(4.0)
    assert len(rig.fixes) - before == 20


@pytest.mark.parametrize("heading_deg", [0, 90, 180, 270])
def test_fixes_are_where_and_when_the_antenna_was(heading_deg: int) -> None:
    rig = ReceiverRig()
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
    rig = ReceiverRig()
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
    rig = ReceiverRig()
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
