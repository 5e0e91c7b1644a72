"""The receiver's baud rate: found, moved to the wanted one, found again. On lines that garble bytes."""

import asyncio
import contextlib
import math
import struct
from collections.abc import Callable
from typing import Final

import numpy as np
import pytest

from companion.base.clock import Clock
from companion.base.geometry import Vector3, ned_from_geodetic
from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.commands import (
    CHANGES,
    LISTEN_S,
    SILENCE_S,
    VERSION_REQUEST,
    BaudRate,
    conclusion,
    port_command,
    trial,
)
from companion.sense.gps.neo6m import ONLY_NMEA, UNHEARD, Neo6m
from companion.sense.serial_port import SerialPort
from sitl.devices.neo6m import NAV_SOL, Neo6mDevice, nmea, ubx
from sitl.devices.ports import AppEnd, MemoryPort, PtyPort, as_received
from sitl.sensors.sensors import GpsReading, GpsSensor
from tests.unit.sense.gps.test_neo6m import BYTE_S, CONFIG, gga, posllh, rmc, sol, velned
from tests.unit.sitl.sensors.flawless import NO_GPS_ERRORS
from tests.virtual_time import in_virtual_time

HOME: Vector3 = (47.0, 8.0, 400.0)
STILL: Vector3 = (0.0, 0.0, 0.0)
RATES = [4800, 9600, 19200, 38400, 57600, 115200]


class BaudRateRig:
    """Receiver, line and driver; the app's loops as in `companion.app.sensing`."""

    def __init__(
        self, wake_baud: int, config: GpsConfig, line: MemoryPort | PtyPort, port: AppEnd | SerialPort
    ):
        self.device = Neo6mDevice(GpsSensor(NO_GPS_ERRORS, np.random.default_rng(1), HOME), 0.12, wake_baud)
        self.driver = Neo6m(config)
        self.fixes: list[GpsFix] = []
        self.problems: list[str] = []
        self._line, self._port = line, port
        self._clock = Clock()

    async def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        tasks = [asyncio.create_task(loop()) for loop in (self._world, self._listen, self._configure)]
        end_s = self._clock.now_s() + seconds
        while self._clock.now_s() < end_s and not until():  # noqa: ASYNC110 - any condition will do
            await asyncio.sleep(0.01)
        for task in tasks:
            task.cancel()
        for task in tasks:
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def _world(self) -> None:
        while True:
            self.device.receive(self._line.receive())
            self._line.set_baud(self.device.baud)
            self._line.send(self.device.step(self._clock.now_s(), STILL, STILL))
            await asyncio.sleep(0.01)

    async def _listen(self) -> None:
        while True:
            data = await self._port.read()
            self.fixes += self.driver.feed(data, self._clock.now_s())

    async def _configure(self) -> None:
        while True:
            question = self.driver.pending(self._clock.now_s())
            if (problem := self.driver.problem) is not None and problem not in self.problems:
                self.problems.append(problem)
            self._port.set_baud(self.driver.baud)
            self._port.write(question)
            await asyncio.sleep(0.2)


@in_virtual_time
async def virtual(wake_baud: int, baud: int, script: Callable[[BaudRateRig], object]) -> BaudRateRig:
    """Run `script(rig)`, a coroutine, in virtual time."""
    line = MemoryPort(baud)
    line.set_baud(wake_baud)
    rig = BaudRateRig(wake_baud, GpsConfig.model_validate({"baud": baud}), line, line.app)
    await script(rig)  # type: ignore[misc]
    return rig


# ---------------------------------------------------------------- the rate itself


@pytest.mark.parametrize("baud", [9600, 38400, 115200])
@pytest.mark.parametrize("wake_baud", RATES)
def test_whatever_the_receiver_talks_at_it_ends_at_the_wanted_rate_with_five_fixes_a_second(
    wake_baud: int, baud: int
) -> None:
    rig = virtual(wake_baud, baud, lambda rig: rig.run(26.0, lambda: rig.driver.configured))
    assert rig.driver.configured
    assert rig.device.baud == rig.driver.baud == baud

    rig = virtual(wake_baud, baud, lambda rig: rig.run(30.0))
    newest = [fix for fix in rig.fixes if fix.time_s > rig.fixes[-1].time_s - 2.0]
    assert len(newest) == 10


def test_a_receiver_without_settings_is_at_the_wanted_rate_within_seconds() -> None:
    async def script(rig: BaudRateRig) -> None:
        await rig.run(8.0, lambda: rig.device.baud == 38400)
        assert rig._clock.now_s() < 4.0

    virtual(9600, 38400, script)


def test_a_power_cut_takes_the_receiver_back_to_9600_and_it_is_found_again() -> None:
    async def script(rig: BaudRateRig) -> None:
        await rig.run(10.0)
        rig.device.power_cycle()
        assert rig.device.baud == 9600
        rig.fixes.clear()
        await rig.run(15.0)

    rig = virtual(9600, 38400, script)
    assert rig.device.baud == 38400
    assert rig.driver.configured
    assert rig.fixes[-1].time_s > 24.0


def test_a_receiver_that_says_nothing_unasked_is_found_by_asking() -> None:
    """All its output switched off, as in another's saved settings."""

    async def script(rig: BaudRateRig) -> None:
        rig.device._rates = dict.fromkeys(rig.device._rates, 0)
        await rig.run(40.0)

    rig = virtual(57600, 38400, script)
    assert rig.device.baud == 38400
    assert rig.driver.configured
    assert rig.fixes


def test_a_receiver_that_does_not_change_its_rate_serves_at_the_one_it_has() -> None:
    """One that speaks NMEA alone, say."""

    async def script(rig: BaudRateRig) -> None:
        rig.device.receive = lambda data: None  # type: ignore[method-assign]
        await rig.run(60.0)

    rig = virtual(9600, 38400, script)
    assert rig.driver.baud == 9600
    assert rig.fixes[-1].time_s > 58.0
    assert "NEO-6M: stays at 9600 baud, asked for 38400" in rig.problems


def test_a_silent_line_is_reported_and_tried_at_all_rates() -> None:
    tried: set[int] = set()

    async def script(rig: BaudRateRig) -> None:
        rig.device.silent = True

        def note() -> bool:
            tried.add(rig.driver.baud)
            return False

        await rig.run(30.0, note)

    rig = virtual(9600, 38400, script)
    assert tried == {*RATES, 230400, 460800}
    assert rig.problems == ["NEO-6M: nothing received: check its power and wiring"]


@pytest.mark.slow
async def test_it_works_on_a_pseudo_terminal_in_real_time() -> None:
    line = PtyPort(9600)
    port = SerialPort(line.path, 57600)
    rig = BaudRateRig(9600, GpsConfig(baud=57600), line, port)
    await rig.run(15.0, lambda: rig.device.baud == 57600 and rig.driver.configured)
    assert rig.device.baud == rig.driver.baud == 57600
    assert rig.driver.configured
    port.close()
    line.close()


def test_a_rate_with_messages_is_not_left() -> None:
    rate = BaudRate(38400)
    for k in range(500):
        assert not rate.step(0.1 * k, 0.1 * k - 0.05)
        assert rate.baud == 38400


def test_after_so_many_changes_in_vain_the_receiver_is_left_where_it_is() -> None:
    rate, asked, message_s, now_s = BaudRate(38400), 0, -1.0, 0.0
    while rate.wanted == 38400 and now_s < 200.0:
        asked += rate.step(now_s, message_s)
        if rate.baud == 9600:
            message_s = now_s + 0.05
        now_s += 0.2
    assert rate.baud == rate.wanted == 9600
    assert asked >= CHANGES


def test_one_rate_is_listened_to_for_longer_than_a_receivers_second() -> None:
    rate, at = BaudRate(38400), []
    for k in range(40):
        rate.step(0.1 * k, -1.0)
        at.append(rate.baud)
    assert at.count(38400) > 10
    assert LISTEN_S > 1.0
    assert at.index(9600) == pytest.approx(10 * LISTEN_S, abs=1)


# ---------------------------------------------------------------- what is sent


def test_the_port_command_is_the_protocols() -> None:
    """CFG-PRT for UART 1: 8N1 (0x8D0), the rate, UBX and NMEA in and out."""
    assert port_command(38400)[:24] == bytes.fromhex(
        "b562 0600 1400 01 00 0000 d0080000 00960000 0300 0300 0000"
    )


@pytest.mark.parametrize(("baud", "rate"), [(9600, 5), (19200, 1), (38400, 1), (115200, 1)])
def test_what_is_asked_for_fits_the_line(baud: int, rate: int) -> None:
    """At 9600 baud status and dilution come once a second: 190 bytes five times would leave nothing over."""
    commands = trial(GpsConfig(), baud) + conclusion(GpsConfig())
    rates = {
        command[7]: command[9] for command in commands if command[2:4] == b"\x06\x01" and command[6] == 1
    }
    assert rates == {0x02: 1, 0x12: 1, 0x06: 1, 0x03: rate, 0x04: rate}
    sizes = {0x02: 36, 0x12: 44, 0x06: 60, 0x03: 24, 0x04: 26}
    bytes_a_second = sum(5 / every * sizes[message] for message, every in rates.items())
    assert bytes_a_second < 0.8 * baud / 10


# ---------------------------------------------------------------- the line


@pytest.mark.parametrize("baud", RATES)
def test_at_one_rate_everything_is_heard_as_it_was_sent(baud: int) -> None:
    assert as_received(bytes(range(256)), baud, baud) == bytes(range(256))


@pytest.mark.parametrize("sent", RATES)
@pytest.mark.parametrize("heard", RATES)
def test_at_different_rates_nothing_is(sent: int, heard: int) -> None:
    text = b"$GPRMC,191418.00,V,,,,,,,040712,,,N*79\r\n"
    if sent != heard:
        assert b"$GPRMC" not in as_received(text, sent, heard)


@pytest.mark.parametrize(
    ("sent", "heard", "expected"),
    [
        # 0x55 is 0 10101010 1 on the line; seen twice as fast: 0 01100110 0, a framing error, then the rest
        (9600, 19200, "00e6"),
        # and so slowly that the byte is over within the start bit
        (115200, 9600, "ff"),
    ],
)
def test_garbage_is_the_waveform_seen_at_the_wrong_rate(sent: int, heard: int, expected: str) -> None:
    assert as_received(b"\x55", sent, heard) == bytes.fromhex(expected)


# ---------------- The NEO-6M's settings, and its driver on the simulated receiver


def acknowledge(command: bytes, kind: int = 1) -> bytes:
    return ubx(5, kind, command[2:4])


def test_the_commands_are_those_of_the_protocol() -> None:
    commands = trial(CONFIG, 38400) + conclusion(CONFIG)
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
        second = f"12000{k}.00"
        receiver.feed(rmc(second) + gga(second), 0.9 + k)
        assert receiver.pending(1.0 + k) == first
        assert receiver.problem is None
    receiver.feed(rmc("120005.00") + gga("120005.00"), 5.9)
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
    assert receiver.pending(0.2) == trial(CONFIG, 9600)[1]
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


# ----------------
# Receivers later than the NEO-6M: NAV-SOL is gone, on some the old commands too; fixes come all the same.

NAV_PVT: Final = (0x01, 0x07)
READING: Final = GpsReading(47.3, 8.5, 400.0, (1.0, 2.0, -0.5), 2.5, 3.5, 0.3, 9)


class FixedGps:
    def sample(self, *_: object) -> GpsReading:
        return READING


class Later(Neo6mDevice):
    """A receiver of a later generation; `pvt`: it knows NAV-PVT."""

    def __init__(self, *, old_commands: bool, pvt: bool) -> None:
        super().__init__(FixedGps(), wake_baud=38400)  # type: ignore[arg-type]
        self._old_commands, self._pvt = old_commands, pvt
        self.switched_off: list[tuple[int, int]] = []

    def receive(self, data: bytes) -> None:
        if data == VERSION_REQUEST:
            line = b"MOD=NEO-M9N".ljust(30, b"\0")
            self._replies += ubx(0x0A, 0x04, b"EXT CORE 4.04".ljust(30, b"\0") + bytes(10) + line)
        super().receive(data)

    def _obey(self, message_class: int, message_id: int, payload: bytes) -> None:
        asked = tuple(payload[:2])
        if message_class == 6 and (not self._old_commands or (message_id == 1 and asked == NAV_SOL)):
            self._replies += ubx(5, 0, bytes((message_class, message_id)))
            return
        if message_class == 6 and message_id == 1 and payload[0] == 0xF0 and not payload[3]:
            self.switched_off.append((payload[0], payload[1]))
        super()._obey(message_class, message_id, payload)

    def _messages(self, gps_ms: int, reading: GpsReading) -> bytes:
        out = super()._messages(gps_ms, reading)
        if self._pvt and self._wanted(NAV_PVT):
            out += ubx(*NAV_PVT, pvt_payload(gps_ms % 604_800_000, reading))
        return out


class ByKeys(Later):
    """A u-blox M10: it takes CFG-VALSET alone (key 32 bits, its size in bits 28 to 30; value)."""

    KEYS: Final = {0x20910007: NAV_PVT, 0x2091001B: (0x01, 0x03), 0x20910039: (0x01, 0x04)}

    def __init__(self, wake_baud: int = 38400) -> None:
        super().__init__(old_commands=False, pvt=True)
        self._wake_baud = wake_baud
        self.power_cycle()

    def _obey(self, message_class: int, message_id: int, payload: bytes) -> None:
        if (message_class, message_id) != (0x06, 0x8A):
            super()._obey(message_class, message_id, payload)
            return
        assert payload[:4] == b"\x00\x01\x00\x00"  # version 0, into RAM
        rest = payload[4:]
        while rest:
            (key,) = struct.unpack_from("<I", rest)
            size = {1: 1, 2: 1, 3: 2, 4: 4}[key >> 28 & 7]
            self._set(key, int.from_bytes(rest[4 : 4 + size], "little"))
            rest = rest[4 + size :]
        self._replies += ubx(5, 1, bytes((message_class, message_id)))

    def _set(self, key: int, value: int) -> None:
        if key in self.KEYS:
            self._rates[self.KEYS[key]] = value
        elif key == 0x30210001:
            self._period_ms, self._next_ms = value, None
        elif key == 0x40520001:
            self.baud = value
        elif key == 0x10740002:
            assert value == 0
            for sentence in list(self._rates):
                if sentence[0] == 0xF0:
                    self._rates[sentence] = 0
                    self.switched_off.append(sentence)
        else:
            assert (key, value) == (0x20110021, 7), f"{key:#x}"


def pvt_payload(time_of_week_ms: int, r: GpsReading) -> bytes:
    north, east, down = (round(1000.0 * v) for v in r.velocity_ned_m_s)
    head = struct.pack(
        "<IHBBBBBBIiBBBB", time_of_week_ms, 2026, 1, 7, 12, 0, 0, 7, 20, 0, 3, 1, 0, r.satellites
    )
    place = struct.pack(
        "<iiiiII",
        *(round(1e7 * r.longitude_deg), round(1e7 * r.latitude_deg)),
        *(round(1000.0 * (r.altitude_m + 47.0)), round(1000.0 * r.altitude_m)),
        *(round(1000.0 * r.horizontal_accuracy_m), round(1000.0 * r.vertical_accuracy_m)),
    )
    motion = struct.pack("<iiiiiII", north, east, down, 0, 0, round(1000.0 * r.speed_accuracy_m_s), 0)
    return (head + place + motion + struct.pack("<H", 150)).ljust(92, b"\0")


def run(device: Later, seconds: float = 40.0) -> tuple[Neo6m, list[float]]:
    """The driver after a while, and when it gave fixes."""
    driver, times_s = Neo6m(GpsConfig()), []
    for k in range(round(20 * seconds)):
        now_s = 0.05 * k
        out = driver.pending(now_s)
        if driver.baud == device.baud:
            device.receive(out)
        data = device.step(now_s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        if data and driver.baud == device.baud:
            for fix in driver.feed(data, now_s):
                assert fix.latitude_deg == pytest.approx(47.3)
                times_s.append(now_s)
    return driver, times_s


def test_one_without_nav_sol_is_asked_for_nav_pvt() -> None:
    driver, times_s = run(device := Later(old_commands=True, pvt=True))
    assert times_s[0] < 3.0
    assert sum(time_s > 20.0 for time_s in times_s) == pytest.approx(100, abs=2)
    assert len(device.switched_off) == 6  # NMEA, once fixes came
    assert driver.problem is None
    assert driver.name == "NEO-M9N"


def test_one_that_sends_neither_keeps_nmea_and_is_named() -> None:
    driver, times_s = run(device := Later(old_commands=True, pvt=False))
    assert device.switched_off == []
    assert sum(time_s > 20.0 for time_s in times_s) == pytest.approx(100, abs=2)
    assert driver.problem == f"NEO-M9N: {ONLY_NMEA}"


@pytest.mark.parametrize("wake_baud", [38400, 9600])
def test_one_that_takes_keys_alone_gives_its_fixes_at_the_rate_asked_for(wake_baud: int) -> None:
    driver, times_s = run(device := ByKeys(wake_baud))
    assert sum(time_s > 20.0 for time_s in times_s) == pytest.approx(100, abs=2)
    assert driver.baud == device.baud == 38400
    assert len(device.switched_off) == 6
    assert driver.problem is None


def test_one_that_refuses_all_says_what_its_nmea_lacks() -> None:
    driver, times_s = run(Later(old_commands=False, pvt=False))
    assert sum(time_s > 20.0 for time_s in times_s) >= 19
    assert driver.problem == f"NEO-M9N: {ONLY_NMEA}"


@pytest.mark.parametrize("length", [84, 92])
def test_nav_pvt_is_read_from_one_that_cannot_be_configured(length: int) -> None:
    """u-blox 7 sends 84 bytes, later ones 92; with its TX wire alone connected nothing is ever answered."""
    driver, fixes = Neo6m(GpsConfig()), []
    for k in range(25):
        now_s = 0.2 * k
        driver.pending(now_s)
        fixes += driver.feed(ubx(*NAV_PVT, pvt_payload(302_400_000 + 200 * k, READING)[:length]), now_s)
    assert len(fixes) == 25
    assert fixes[-1].altitude_m == pytest.approx(400.0)
    assert fixes[-1].velocity_ned_m_s == pytest.approx((1.0, 2.0, -0.5))


@pytest.mark.parametrize(
    ("talker", "baud", "rate_hz"), [("GN", 9600, 1), ("BD", 115200, 5), ("GP", 230400, 10)]
)
def test_one_that_hears_nothing_serves_by_its_nmea_without_further_search(
    talker: str, baud: int, rate_hz: int
) -> None:
    # a receiver that is no u-blox's (many a "NEO-6M"), or one whose RX is not wired
    driver, times_s, sent = Neo6m(GpsConfig()), [], 0
    for k in range(20 * 60):
        now_s = 0.05 * k
        driver.pending(now_s)
        if now_s < sent / rate_hz:
            continue
        sent += 1
        clock = f"12{int(now_s / 60):02d}{now_s % 60:05.2f}"
        sentences = (
            f"{talker}GGA,{clock},4718.0000,N,00830.0000,E,1,09,0.9,400.0,M,47.0,M,,",
            f"{talker}RMC,{clock},A,4718.0000,N,00830.0000,E,0.20,90.0,070126,,,A",
        )
        data = b"".join(nmea(text) for text in sentences)
        fixes = driver.feed(data if driver.baud == baud else bytes(range(128, 200)), now_s)
        times_s += [now_s] * len(fixes)
    assert sum(time_s >= 30.0 for time_s in times_s) == pytest.approx(30 * rate_hz, abs=2)
    assert driver.problem == f"NEO-6M: no answer to CFG-PRT: {UNHEARD}"
