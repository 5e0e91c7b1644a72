"""Receivers later than the NEO-6M: NAV-SOL is gone, on some the old commands too; fixes come all the same."""

import struct
from typing import Final

import pytest

from companion.config import GpsConfig
from companion.sense.gps.commands import VERSION_REQUEST
from companion.sense.gps.neo6m import ONLY_NMEA, UNHEARD, Neo6m
from sitl.devices.neo6m import NAV_SOL, Neo6mDevice, nmea, ubx
from sitl.sensors.sensors import GpsReading

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


def test_one_that_refuses_every_old_command_serves_by_its_nmea() -> None:
    _, times_s = run(Later(old_commands=False, pvt=False))
    assert sum(time_s > 20.0 for time_s in times_s) >= 19


@pytest.mark.parametrize("wake_baud", [38400, 9600])
def test_one_that_takes_keys_alone_gives_its_fixes_at_the_rate_asked_for(wake_baud: int) -> None:
    driver, times_s = run(device := ByKeys(wake_baud))
    assert sum(time_s > 20.0 for time_s in times_s) == pytest.approx(100, abs=2)
    assert driver.baud == device.baud == 38400
    assert len(device.switched_off) == 6
    assert driver.problem is None


def test_one_that_refuses_all_says_what_its_nmea_lacks() -> None:
    driver, _ = run(Later(old_commands=False, pvt=False))
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
