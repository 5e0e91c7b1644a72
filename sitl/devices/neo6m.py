"""The NEO-6M as bytes: NMEA at 1 Hz after power-up, UBX as configured.

After the u-blox 6 Receiver Description GPS.G6-SW-10018: CFG-MSG, CFG-RATE, CFG-NAV5 and CFG-PRT are applied
and acknowledged, other CFG messages refused; a change of the baud rate is acknowledged at the new one. The
serial line is simulated in `ports`. Messages are packed here independently of the
library that the driver parses with, so that one mistake cannot cancel itself.
"""

import datetime
import math
import struct
from collections import deque
from typing import Final

import pymap3d

from companion.base.geometry import Vector3
from sitl.sensors.sensors import GpsReading, GpsSensor

_WEEK: Final = 2400
_FIRST_TIME_OF_WEEK_MS: Final = 302_400_000  # Wednesday noon, GPS time
_WEEK_MS: Final = 604_800_000
_LEAP_S: Final = 18
_GPS_START: Final = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
# UTC (s since 1970) at the simulation's time 0
UNIX_AT_START_S: Final = (
    _GPS_START + datetime.timedelta(weeks=_WEEK, milliseconds=_FIRST_TIME_OF_WEEK_MS, seconds=-_LEAP_S)
).timestamp()
_GEOID_SEPARATION_M: Final = 47.0
_KNOT_M_S: Final = 1852.0 / 3600.0
_FASTEST_MS: Final = 200
_EARLY_S: Final = 1e-9

_RATES_BAUD: Final = (4800, 9600, 19200, 38400, 57600, 115200)
_UART1: Final = 1

NAV_POSLLH, NAV_STATUS, NAV_DOP = (0x01, 0x02), (0x01, 0x03), (0x01, 0x04)
NAV_SOL, NAV_VELNED = (0x01, 0x06), (0x01, 0x12)
_NMEA: Final = {(0xF0, 0x04): "RMC", (0xF0, 0x05): "VTG", (0xF0, 0x00): "GGA", (0xF0, 0x02): "GSA"}
_NMEA_ALL: Final = (*_NMEA, (0xF0, 0x01), (0xF0, 0x03))
_CFG, _CFG_PRT, _CFG_MSG, _CFG_RATE, _CFG_NAV5 = 0x06, 0x00, 0x01, 0x08, 0x24
_CFG_LENGTHS: Final = {_CFG_PRT: (20,), _CFG_MSG: (3, 8), _CFG_RATE: (6,), _CFG_NAV5: (36,)}


def ubx(message_class: int, message_id: int, payload: bytes) -> bytes:
    """A UBX message: sync, class, id, length, payload, 8-bit Fletcher checksum."""
    body = struct.pack("<BBH", message_class, message_id, len(payload)) + payload
    return b"\xb5\x62" + body + _fletcher(body)


def _fletcher(body: bytes) -> bytes:
    first = second = 0
    for value in body:
        first = (first + value) & 0xFF
        second = (second + first) & 0xFF
    return bytes((first, second))


def nmea(body: str) -> bytes:
    """An NMEA sentence: dollar, body, checksum, end of line."""
    total = 0
    for value in body.encode():
        total ^= value
    return f"${body}*{total:02X}\r\n".encode()


class Neo6mDevice:
    """The receiver. `has_fix` False: no satellites; `silent`: unplugged; `hdop` how it sees.

    `baud` is the rate of its port; `wake_baud` is that after power-up.
    """

    def __init__(self, sensor: GpsSensor, latency_s: float = 0.12, wake_baud: int = 9600) -> None:
        self._sensor = sensor
        self._latency_s = latency_s
        self._wake_baud = wake_baud
        self.has_fix = True
        self.hdop = 1.0
        self.silent = False
        self.power_cycle()

    def power_cycle(self) -> None:
        """Everything as after power-on: NMEA at 1 Hz."""
        self.baud = self._wake_baud
        self._rates = dict.fromkeys(_NMEA_ALL, 1)
        self._period_ms = 1000
        self._epoch = 0
        self._next_ms: int | None = None
        self._incoming = bytearray()
        self._replies = b""
        self._due: deque[tuple[float, bytes]] = deque()

    @property
    def next_s(self) -> float:
        """Time of the next measurement or transmission."""
        if self._next_ms is None or self._replies:
            return -math.inf
        epoch_s = self._next_ms / 1000.0 - _EARLY_S
        return min(epoch_s, self._due[0][0]) if self._due else epoch_s

    def step(self, now_s: float, position_ned_m: Vector3, velocity_ned_m_s: Vector3) -> bytes:
        """Bytes that go on the line now; the antenna's truth counts at the instants of its epochs."""
        elapsed_ms = (now_s + _EARLY_S) * 1000.0  # a step that falls on an epoch counts as it
        if self._next_ms is None:
            self._schedule(int(elapsed_ms))
        if self._next_ms is not None and elapsed_ms >= self._next_ms:
            epoch_ms = self._next_ms
            self._schedule(epoch_ms)
            reading = self._sensor.sample(now_s, position_ned_m, velocity_ned_m_s)
            data = self._messages(epoch_ms + _FIRST_TIME_OF_WEEK_MS, reading)
            self._due.append((epoch_ms / 1000.0 + self._latency_s, data))
        out, self._replies = self._replies, b""
        while self._due and now_s >= self._due[0][0]:
            out += self._due.popleft()[1]
        return b"" if self.silent else out

    def receive(self, data: bytes) -> None:
        """Bytes from the companion computer: commands, or garbage."""
        if not data:
            return
        self._incoming += data
        while (start := self._incoming.find(b"\xb5\x62")) >= 0:
            del self._incoming[:start]
            if len(self._incoming) < 8:
                return
            message_class, message_id, length = struct.unpack_from("<BBH", self._incoming, 2)
            if len(self._incoming) < length + 8 and length < 256:
                return
            body = bytes(self._incoming[2 : length + 6])
            checksum = bytes(self._incoming[length + 6 : length + 8])
            if length >= 256 or _fletcher(body) != checksum:
                del self._incoming[:2]
                continue
            del self._incoming[: length + 8]
            self._obey(message_class, message_id, body[4:])
        del self._incoming[:-1]  # perhaps the first half of a sync

    # ------------------------------------------------------------ commands

    def _obey(self, message_class: int, message_id: int, payload: bytes) -> None:
        if message_class != _CFG:
            return
        obeyed = len(payload) in _CFG_LENGTHS.get(message_id, ())
        if obeyed and message_id == _CFG_MSG:
            # the long form has a rate for each port: DDC, UART1, UART2, USB, SPI
            self._rates[payload[0], payload[1]] = payload[2] if len(payload) == 3 else payload[3]
        elif obeyed and message_id == _CFG_RATE:
            self._period_ms = max(_FASTEST_MS, int.from_bytes(payload[:2], "little"))
            self._next_ms = None
        elif obeyed and message_id == _CFG_PRT:
            obeyed = self._set_port(payload)
        self._replies += ubx(0x05, 0x01 if obeyed else 0x00, bytes((message_class, message_id)))

    def _set_port(self, payload: bytes) -> bool:
        port, baud = payload[0], int.from_bytes(payload[8:12], "little")
        if port != _UART1 or baud not in _RATES_BAUD:
            return False
        self.baud = baud
        return True

    def _schedule(self, after_ms: int) -> None:
        """The next epoch: a whole multiple of the period, in GPS time and here alike."""
        self._next_ms = (after_ms // self._period_ms + 1) * self._period_ms

    # ------------------------------------------------------------ messages

    def _messages(self, gps_ms: int, reading: GpsReading) -> bytes:
        self._epoch += 1
        time_of_week_ms = gps_ms % _WEEK_MS
        out = b""
        for (message_class, message_id), sentence in _NMEA.items():
            if self._wanted((message_class, message_id)):
                out += nmea(self._sentence(sentence, gps_ms, reading))
        for identity, payload in (
            (NAV_POSLLH, self._posllh),
            (NAV_STATUS, self._status),
            (NAV_DOP, self._dop),
            (NAV_SOL, self._sol),
            (NAV_VELNED, self._velned),
        ):
            if self._wanted(identity):
                out += ubx(*identity, payload(time_of_week_ms, reading))
        return out

    def _wanted(self, identity: tuple[int, int]) -> bool:
        rate = self._rates.get(identity, 0)
        return rate > 0 and self._epoch % rate == 0

    def _posllh(self, time_of_week_ms: int, r: GpsReading) -> bytes:
        accuracy = (r.horizontal_accuracy_m, r.vertical_accuracy_m) if self.has_fix else (4e3, 4e3)
        return struct.pack(
            "<IiiiiII",
            time_of_week_ms,
            round(r.longitude_deg * 1e7),
            round(r.latitude_deg * 1e7),
            round((r.altitude_m + _GEOID_SEPARATION_M) * 1000.0),
            round(r.altitude_m * 1000.0),
            *(round(a * 1000.0) for a in accuracy),
        )

    def _status(self, time_of_week_ms: int, _reading: GpsReading) -> bytes:
        fix, flags = (3, 0x0D) if self.has_fix else (0, 0x0C)
        return struct.pack("<IBBBBII", time_of_week_ms, fix, flags, 0, 0, 29_000, time_of_week_ms)

    def _dop(self, time_of_week_ms: int, _reading: GpsReading) -> bytes:
        h = self.hdop if self.has_fix else 99.99
        # geometric, position, time, vertical, horizontal, north, east
        dops = (2.2 * h, 2.0 * h, 1.0 * h, 1.7 * h, h, 0.7 * h, 0.7 * h)
        return struct.pack("<I7H", time_of_week_ms, *(min(9999, round(100.0 * d)) for d in dops))

    def _velned(self, time_of_week_ms: int, r: GpsReading) -> bytes:
        north, east, down = r.velocity_ned_m_s
        speed = (north * north + east * east) ** 0.5
        course = _course_deg(north, east)
        return struct.pack(
            "<IiiiIIiII",
            time_of_week_ms,
            *(round(v * 100.0) for v in (north, east, down)),
            round((speed * speed + down * down) ** 0.5 * 100.0),
            round(speed * 100.0),
            round(course * 1e5),
            round(r.speed_accuracy_m_s * 100.0),
            round(5.0 * 1e5),
        )

    def _sol(self, time_of_week_ms: int, r: GpsReading) -> bytes:
        where = r.latitude_deg, r.longitude_deg
        position = pymap3d.geodetic2ecef(*where, r.altitude_m + _GEOID_SEPARATION_M)
        north, east, down = r.velocity_ned_m_s
        velocity = pymap3d.enu2uvw(east, north, -down, *where)
        return struct.pack(
            "<IihBBiiiIiiiIHBBI",
            time_of_week_ms,
            0,
            _WEEK,
            3 if self.has_fix else 0,
            0x0D if self.has_fix else 0x0C,  # fix ok, week and time of week known
            *(round(float(x) * 100.0) for x in position),
            round(r.vertical_accuracy_m * 100.0),
            *(round(float(v) * 100.0) for v in velocity),
            round(r.speed_accuracy_m_s * 100.0),
            180,
            0,
            r.satellites if self.has_fix else 0,
            0,
        )

    def _sentence(self, kind: str, gps_ms: int, r: GpsReading) -> str:
        utc = _GPS_START + datetime.timedelta(weeks=_WEEK, milliseconds=gps_ms, seconds=-_LEAP_S)
        time = utc.strftime("%H%M%S.") + f"{utc.microsecond // 10000:02d}"
        latitude = _degrees_minutes(r.latitude_deg, 2, "NS")
        longitude = _degrees_minutes(r.longitude_deg, 3, "EW")
        north, east, _ = r.velocity_ned_m_s
        knots, course = (north * north + east * east) ** 0.5 / _KNOT_M_S, _course_deg(north, east)
        if kind == "GSA":
            used = ",".join(f"{k + 1:02d}" if k < r.satellites and self.has_fix else "" for k in range(12))
            dops = ",".join(f"{share * self.hdop:.2f}" for share in (2.0, 1.0, 1.7))
            return f"GPGSA,A,{3 if self.has_fix else 1},{used},{dops}"
        if not self.has_fix:
            lost = {"RMC": f"{time},V,,,,,,,{utc:%d%m%y},,,N", "GGA": f"{time},,,,,0,00,99.99,,,,,,"}
            return f"GP{kind}," + lost.get(kind, ",,,,,,,,N")
        fields = {
            "RMC": f"{time},A,{latitude},{longitude},{knots:.3f},{course:.2f},{utc:%d%m%y},,,A",
            "VTG": f"{course:.2f},T,,M,{knots:.3f},N,{knots * 1.852:.3f},K,A",
            "GGA": f"{time},{latitude},{longitude},1,{r.satellites:02d},{self.hdop:.2f},{r.altitude_m:.1f},M,"
            f"{_GEOID_SEPARATION_M:.1f},M,,",
        }
        return f"GP{kind},{fields[kind]}"


def _course_deg(north: float, east: float) -> float:

    return math.degrees(math.atan2(east, north)) % 360.0


def _degrees_minutes(angle_deg: float, width: int, letters: str) -> str:
    degrees, minutes = divmod(abs(angle_deg) * 60.0, 60.0)
    return f"{int(degrees):0{width}d}{minutes:08.5f},{letters[angle_deg < 0.0]}"
