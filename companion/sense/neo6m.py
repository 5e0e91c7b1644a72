"""The NEO-6M GPS receiver: its settings as UBX commands, its bytes to fixes. No input or output here.

It wakes up at 1 Hz with NMEA; we ask for NAV-POSLLH, NAV-VELNED and NAV-SOL at `config.rate_hz` and no
NMEA (u-blox 6 Receiver Description GPS.G6-SW-10018). The three messages of one epoch carry the same time
of week (iTOW) and make one fix. Until the commands are obeyed, or on a receiver that does not know them,
NMEA's RMC and GGA serve. Altitudes are above mean sea level.
"""

from __future__ import annotations

import datetime
import math
import struct
from dataclasses import dataclass, field
from typing import Any, Final

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError
from pyubx2 import SET, UBXMessage, UBXReader

from companion.config import GpsConfig
from companion.messages import GpsFix
from companion.sense.gps_frames import FrameSplitter, GpsMessage

ANSWER_TIMEOUT_S: Final = 1.0  # at 9600 baud a receiver's second of NMEA stands before the answer
TRIES: Final = 5
SILENCE_S: Final = 3.0  # without a UBX epoch for so long, the receiver has lost its settings

_ACK_ACK, _ACK_NAK = b"\x05\x01", b"\x05\x00"
_NAV: Final = {b"\x01\x02": "POSLLH", b"\x01\x12": "VELNED", b"\x01\x06": "SOL"}
_NMEA_SENTENCES: Final = (0x01, 0x02, 0x03, 0x05, 0x04, 0x00)  # GLL, GSA, GSV, VTG, RMC, GGA
_AIRBORNE_2G: Final = 7
_FIX_3D: Final = (3, 4)
_UART1: Final = 1

_KNOT_M_S: Final = 1852.0 / 3600.0
_RANGE_ERROR_M: Final = 2.5  # NEO-6M data sheet: 2.5 m CEP; times the dilution of precision
_NMEA_SPEED_ACCURACY_M_S: Final = 2.0  # RMC has no vertical speed: as uncertain as a usual climb is fast
_CLOCK_DRIFT: Final = 50e-6
_CLOCK_JUMP_S: Final = 1.0


def configuration(config: GpsConfig) -> list[bytes]:
    """The UBX commands, in the order to send them; each is acknowledged."""
    messages = [_message_rate(0xF0, sentence, 0) for sentence in _NMEA_SENTENCES]
    messages += [_message_rate(0x01, identity[1], 1) for identity in _NAV]
    messages += [
        UBXMessage("CFG", "CFG-NAV5", SET, dyn=1, dynModel=_AIRBORNE_2G),
        UBXMessage("CFG", "CFG-RATE", SET, measRate=1000 // config.rate_hz, navRate=1, timeRef=1),
    ]
    return [bytes(message.serialize()) for message in messages]


def _message_rate(message_class: int, message_id: int, rate: int) -> Any:
    return UBXMessage("CFG", "CFG-MSG", SET, msgClass=message_class, msgID=message_id, rateUART1=rate)


class EpochClock:
    """The receiver's time scale on the app's clock.

    Messages are sent and read late now and then, never early: the smallest delay seen is the one that
    counts, and it is let grow by the drift that two quartz clocks can have.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._last_epoch_s = 0.0

    def local_s(self, epoch_s: float, began_s: float) -> float:
        """App time of the receiver's `epoch_s`, whose messages began at `began_s`, plus the least delay."""
        offset_s = began_s - epoch_s
        if self._offset_s is None or abs(offset_s - self._offset_s) > _CLOCK_JUMP_S:
            self._offset_s = offset_s
        else:
            grown_s = self._offset_s + _CLOCK_DRIFT * abs(epoch_s - self._last_epoch_s)
            self._offset_s = min(offset_s, grown_s)
        self._last_epoch_s = epoch_s
        return epoch_s + self._offset_s


@dataclass(slots=True)
class _Epoch:
    """What has come of one epoch."""

    epoch_s: float = -1.0
    began_s: float = 0.0
    parts: dict[str, Any] = field(default_factory=dict)


class Neo6m:
    """One receiver. Send what `pending` returns, feed what comes, several times a second each.

    `problem` says in one line what is wrong with receiver or line, None when all is well, as of
    the last `pending`.
    """

    def __init__(self, config: GpsConfig) -> None:
        self._baud = config.baud
        self._latency_s = config.latency_s
        self._splitter = FrameSplitter(config.baud)
        self._commands = configuration(config)
        self._next = 0
        self._tries = 0
        self._asked_s: float | None = None
        self._quiet_since_s: float | None = None
        self._ubx_seen = False
        self._ubx_epoch_s = -math.inf
        self._epoch = _Epoch()
        self._nmea = _Epoch()
        self._nmea_3d = True
        self._ubx_clock = EpochClock()
        self._nmea_clock = EpochClock()
        self._unanswered: str | None = None
        self._refused: str | None = None
        self._started_s: float | None = None
        self._heard_s = self._message_s = self._fix_s = -math.inf  # when the last one came
        self.problem: str | None = None

    @property
    def configured(self) -> bool:
        """Whether every command has been answered."""
        return self._next >= len(self._commands)

    # ------------------------------------------------------------ to the receiver

    def pending(self, now_s: float) -> bytes:
        """What to send now, or nothing: one command at a time, repeated until it is answered.

        Begins anew when whole UBX epochs stay away, as they do after the receiver lost power or when an
        acknowledgement was taken for another's.
        """
        if self.configured:
            self._watch_for_silence(now_s)
        self.problem = self._line_problem(now_s) or self._unanswered or self._refused
        if self.configured or (self._asked_s is not None and now_s - self._asked_s < ANSWER_TIMEOUT_S):
            return b""
        if self._tries >= TRIES:
            self._unanswered = f"NEO-6M: no answer to {_name(self._commands[self._next])}"
            self.problem = self.problem or self._unanswered
            self._next = self._tries = 0
        self._tries += 1
        self._asked_s = now_s
        return self._commands[self._next]

    def _line_problem(self, now_s: float) -> str | None:
        """The first thing that is missing on the way from the receiver's power to a fix."""
        if self._started_s is None:
            self._started_s = now_s
        since_s = now_s - SILENCE_S
        if since_s < self._started_s:
            return None
        if self._heard_s < since_s:
            return "NEO-6M: nothing received: check its power and wiring"
        if self._message_s < since_s:
            return f"NEO-6M: no message in what is received: check that it sends at {self._baud} baud"
        return "NEO-6M: no fix" if self._fix_s < since_s else None

    def _watch_for_silence(self, now_s: float) -> None:
        if self._ubx_seen or self._quiet_since_s is None:
            self._ubx_seen = False
            self._quiet_since_s = now_s
        if now_s - self._quiet_since_s > SILENCE_S:
            self._next = self._tries = 0
            self._asked_s = self._quiet_since_s = None

    def _answered(self, message: bytes) -> None:
        if self.configured or self._asked_s is None or message[6:8] != self._commands[self._next][2:4]:
            return
        if message[2:4] == _ACK_NAK:
            self._refused = f"NEO-6M: refuses {_name(self._commands[self._next])}"
        self._unanswered = None
        self._next += 1
        self._tries = 0
        self._asked_s = None

    # ------------------------------------------------------------ from the receiver

    def feed(self, data: bytes, received_s: float) -> list[GpsFix]:
        """Fixes completed by `data`, whose last byte came at `received_s`. No fix is no message."""
        fixes = []
        self._heard_s = received_s
        for message in self._splitter.feed(data, received_s):
            self._message_s = received_s
            fix = self._feed_ubx(message) if message.is_ubx else self._feed_nmea(message)
            if fix is not None:
                self._fix_s = received_s
                fixes.append(fix)
        return fixes

    def _feed_ubx(self, message: GpsMessage) -> GpsFix | None:
        identity = message.data[2:4]
        if identity in (_ACK_ACK, _ACK_NAK):
            self._answered(message.data)
            return None
        part = _NAV.get(identity)
        if part is None or len(message.data) < 12:
            return None
        # pyubx2 turns iTOW into a time of day: take the milliseconds as they are
        (time_of_week_ms,) = struct.unpack_from("<I", message.data, 6)
        epoch = self._epoch
        if time_of_week_ms / 1000.0 != epoch.epoch_s:
            epoch = self._epoch = _Epoch(time_of_week_ms / 1000.0, message.began_s)
        epoch.parts[part] = UBXReader.parse(message.data)
        if len(epoch.parts) < len(_NAV):
            return None
        self._ubx_seen = True
        self._ubx_epoch_s = epoch.began_s
        time_s = self._ubx_clock.local_s(epoch.epoch_s, epoch.began_s) - self._latency_s
        fix = _fix_from_ubx(time_s, **epoch.parts)
        epoch.parts = {}
        return fix

    def _feed_nmea(self, message: GpsMessage) -> GpsFix | None:
        if message.began_s - self._ubx_epoch_s < SILENCE_S or message.data[3:6] not in (
            b"RMC",
            b"GGA",
            b"GSA",
        ):
            return None
        try:
            sentence = NMEAReader.parse(message.data)
        except (NMEAMessageError, NMEAParseError, NMEATypeError, ValueError):
            return None
        if sentence.msgID == "GSA":
            self._nmea_3d = sentence.navMode == 3
            return None
        if not isinstance(sentence.time, datetime.time):
            return None
        epoch_s = _seconds_of_day(sentence.time)
        if epoch_s != self._nmea.epoch_s:
            self._nmea = _Epoch(epoch_s, message.began_s)
        self._nmea.parts[sentence.msgID] = sentence
        if len(self._nmea.parts) < 2 or not self._nmea_3d:
            return None
        time_s = self._nmea_clock.local_s(epoch_s, self._nmea.began_s) - self._latency_s
        fix = _fix_from_nmea(time_s, **self._nmea.parts)
        self._nmea.parts = {}
        return fix


def _fix_from_ubx(time_s: float, POSLLH: Any, VELNED: Any, SOL: Any) -> GpsFix | None:
    """One fix of an epoch's three messages (mm, cm/s and 1e-7 degrees in u-blox's units)."""
    if SOL.gpsFix not in _FIX_3D or not SOL.gpsfixOK:
        return None
    return GpsFix(
        time_s=time_s,
        latitude_deg=float(POSLLH.lat),
        longitude_deg=float(POSLLH.lon),
        altitude_m=POSLLH.hMSL / 1000.0,
        velocity_ned_m_s=(VELNED.velN / 100.0, VELNED.velE / 100.0, VELNED.velD / 100.0),
        horizontal_accuracy_m=POSLLH.hAcc / 1000.0,
        vertical_accuracy_m=POSLLH.vAcc / 1000.0,
        speed_accuracy_m_s=VELNED.sAcc / 100.0,
        satellites=int(SOL.numSV),
    )


def _fix_from_nmea(time_s: float, RMC: Any, GGA: Any) -> GpsFix | None:
    """One fix of RMC and GGA; the vertical speed is not in them and is given as 0."""
    numbers = (GGA.lat, GGA.lon, GGA.alt, GGA.HDOP, GGA.numSV, RMC.spd)
    if RMC.status != "A" or not GGA.quality or not all(isinstance(n, int | float) for n in numbers):
        return None
    # a receiver at rest leaves the course out
    course = math.radians(RMC.cog) if isinstance(RMC.cog, int | float) else 0.0
    speed_m_s = RMC.spd * _KNOT_M_S if isinstance(RMC.cog, int | float) else 0.0
    accuracy_m = _RANGE_ERROR_M * max(1.0, GGA.HDOP)
    return GpsFix(
        time_s=time_s,
        latitude_deg=float(GGA.lat),
        longitude_deg=float(GGA.lon),
        altitude_m=float(GGA.alt),
        velocity_ned_m_s=(speed_m_s * math.cos(course), speed_m_s * math.sin(course), 0.0),
        horizontal_accuracy_m=accuracy_m,
        vertical_accuracy_m=1.5 * accuracy_m,
        speed_accuracy_m_s=_NMEA_SPEED_ACCURACY_M_S,
        satellites=int(GGA.numSV),
    )


def _seconds_of_day(time: datetime.time) -> float:
    return time.hour * 3600.0 + time.minute * 60.0 + time.second + time.microsecond * 1e-6


def _name(command: bytes) -> str:
    return str(UBXReader.parse(command, msgmode=SET).identity)
