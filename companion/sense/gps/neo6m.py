"""A u-blox GPS receiver (NEO-6M to M10): its settings as UBX commands, its bytes to fixes. No I/O.

It wakes up at 1 Hz with NMEA at 9600 baud; its baud rate is found and moved to `config.baud` (`BaudRate`),
then it is asked for NAV-POSLLH, -VELNED, -SOL, -STATUS and -DOP at `config.rate_hz` and no NMEA
(`commands`; u-blox 6 Receiver Description GPS.G6-SW-10018). The messages of one epoch carry the same time
of week (iTOW) and make one fix (`fixes`). One that refuses NAV-SOL or does not send it (M9 and later) is
asked for NAV-PVT, one that refuses that as well by keys (CFG-VALSET, M10). Until fixes come so, or on a
receiver that knows none of it, NMEA's RMC and GGA serve; on one that sends NAV-SOL and no other position,
that.
"""

import math
import struct
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Any, Final

from pyubx2 import UBXReader

from companion.base.messages import GpsFix
from companion.config import GpsConfig
from companion.sense.gps.commands import (
    FIX_MESSAGES,
    NEXT_DIALECT,
    PVT_MESSAGE,
    SILENCE_S,
    TRUST_MESSAGES,
    VERSION_REQUEST,
    BaudRate,
    Dialect,
    baud_commands,
    command_name,
    conclusion,
    receiver_name,
    trial,
)
from companion.sense.gps.fixes import (
    EpochClock,
    fix_from_nmea,
    fix_from_pvt,
    fix_from_sol,
    fix_from_ubx,
    has_fix,
)
from companion.sense.gps.framing import (
    UBX_OVERHEAD,
    FrameSplitter,
    GpsMessage,
    parse_sentence,
    seconds_of_day,
)

ANSWER_TIMEOUT_S: Final = 1.0  # at 9600 baud a receiver's second of NMEA stands before the answer
TRIES: Final = 5

_ACK_ACK, _ACK_NAK = b"\x05\x01", b"\x05\x00"
_VERSION: Final = b"\x0a\x04"
_BY_KEYS: Final = b"\x06\x8a"  # CFG-VALSET
_REFUSED_FIX: Final = frozenset(FIX_MESSAGES) | frozenset(PVT_MESSAGE)
_PARTS: Final = FIX_MESSAGES | PVT_MESSAGE | TRUST_MESSAGES
# what makes a fix, in each dialect
_PVT_FIX: Final = frozenset(PVT_MESSAGE.values())
_SOL_FIX: Final = frozenset(FIX_MESSAGES.values())
_NMEA_FIX: Final = frozenset({"RMC", "GGA"})
# NAV-PVT grew from 84 bytes (u-blox 7) to 92 (u-blox 8 on)
_LENGTHS: Final = {
    "PVT": (84, 92),
    "POSLLH": (28,),
    "STATUS": (16,),
    "DOP": (18,),
    "SOL": (52,),
    "VELNED": (36,),
}
_SENTENCES: Final = (b"RMC", b"GGA", b"GSA")
NMEA_SERVES: Final = "NMEA serves, without vertical speed"
ONLY_NMEA: Final = f"sends no UBX fixes; {NMEA_SERVES}"
UNHEARD: Final = f"its RX is not wired, or it is no u-blox; {NMEA_SERVES}"
ABOVE_ELLIPSOID: Final = (
    "sends NAV-SOL alone: altitudes are above the ellipsoid, up to 110 m from sea level's"
)
_SOL_ONLY_EPOCHS: Final = 2  # so many without another position are no accident of the line


@dataclass(slots=True)
class _Epoch:
    """What has come of one epoch."""

    epoch_s: float = -1.0
    began_s: float = 0.0
    parts: dict[str, Any] = field(default_factory=dict)
    fixed: bool = False

    def take(self, wanted: AbstractSet[str]) -> dict[str, Any] | None:
        """Its parts, as soon as those wanted are there, and once.

        A receiver that has hung may repeat itself: a time that stands still is no new fix.
        """
        if self.fixed or not self.parts.keys() >= wanted:
            return None
        self.fixed = True
        return self.parts


class Neo6m:
    """One receiver. Set the port to `baud`, send what `pending` returns, feed what comes.

    `problem` says in one line what is wrong with receiver or line, None when all is well, as of
    the last `pending`.
    """

    def __init__(self, config: GpsConfig) -> None:
        self._config = config
        self._line = BaudRate(config.baud)
        self._splitter = FrameSplitter(config.baud)
        self._dialect: Dialect = "sol"
        self._commands = trial(config, config.baud)
        self._concluded = False
        self._tried_s: float | None = None
        self._fix_refused = False
        self.name = "NEO-6M"  # until it says what it is
        self._named = False
        self._next = 0
        self._tries = 0
        self._asked_s: float | None = None
        self._quiet_since_s: float | None = None
        self._ubx_seen = self._nmea_seen = False  # whole epochs
        self._ubx_epoch_s = -math.inf
        self._epoch = _Epoch()
        self._status_ok = True
        self._dop: float | None = None  # horizontal
        self._dop_s = -math.inf
        self._sol_only_epochs = 0
        self._separation_m: float | None = None
        self._nmea = _Epoch()
        self._nmea_3d = True
        self._ubx_clock = EpochClock()
        self._nmea_clock = EpochClock()
        self._unanswered: str | None = None
        self._refused: str | None = None
        self._started_s: float | None = None
        # when the last one came
        self._heard_s = self._message_s = self._fix_s = self._doubted_s = -math.inf
        self.problem: str | None = None

    @property
    def baud(self) -> int:
        """What the port is to be set to before `pending`'s bytes are written."""
        return self._line.baud

    @property
    def configured(self) -> bool:
        """Whether every command has been answered, and fixes come as asked for."""
        return self._concluded and self._next >= len(self._commands)

    # ------------------------------------------------------------ to the receiver

    def pending(self, now_s: float) -> bytes:
        """What to send now, or nothing: one command at a time, repeated until it is answered.

        Begins anew when whole UBX epochs stay away, as they do after the receiver lost power or when an
        acknowledgement was taken for another's.
        """
        change = self._find_rate(now_s)
        if self.configured:
            self._watch_for_silence(now_s)
        self.problem = (
            self._line_problem(now_s) or self._altitude_problem or self._unanswered or self._refused
        )
        if not self._line.there:
            return baud_commands(self._line.wanted) if change else b""
        if not self._concluded and self._next >= len(self._commands):
            return self._judge_trial(now_s)
        if self.configured or (self._asked_s is not None and now_s - self._asked_s < ANSWER_TIMEOUT_S):
            return b""
        if self._tries >= TRIES:
            self._unanswered = f"{self.name}: no answer to {command_name(self._commands[self._next])}"
            if self._nmea_seen:
                self._unanswered += f": {UNHEARD}"
            self.problem = self.problem or self._unanswered
            # none of the old ones knows keys: silence is an answer too
            self._begin_anew("nmea" if self._dialect == "keys" else "sol")
        self._tries += 1
        self._asked_s = now_s
        return self._commands[self._next]

    def _find_rate(self, now_s: float) -> bool:
        """Whether the receiver is to be asked now to change its rate."""
        before, wanted = self._line.baud, self._line.wanted
        change = self._line.step(now_s, self._message_s)
        if self._line.wanted != wanted:
            self._refused = f"{self.name}: stays at {self._line.wanted} baud, asked for {wanted}"
        if self._line.baud != before:
            self._splitter = FrameSplitter(self._line.baud)
            self._begin_anew()
        return change

    def _judge_trial(self, now_s: float) -> bytes:
        """All that asks for fixes is answered: see whether they come, else ask for others."""
        if self._tried_s is None:
            self._tried_s, self._ubx_seen, self._nmea_seen = now_s, False, False
            return b"" if self._named else VERSION_REQUEST
        if self._nmea_seen if self._dialect == "nmea" else self._ubx_seen:
            self._commands = self._commands + conclusion(self._config, self._dialect)
            self._concluded = True
            if self._dialect != "sol":
                self._refused = f"{self.name}: {ONLY_NMEA}" if self._dialect == "nmea" else None
        elif self._fix_refused or now_s - self._tried_s > SILENCE_S:
            if not self._named:
                self.name = "GPS receiver, no NEO-6M"
            self._begin_anew(NEXT_DIALECT.get(self._dialect, "sol"))
        return b""

    def _begin_anew(self, dialect: Dialect = "sol") -> None:
        self._dialect, self._commands = dialect, trial(self._config, self._line.wanted, dialect)
        self._concluded, self._tried_s, self._fix_refused = False, None, False
        self._next = self._tries = 0
        self._asked_s = self._quiet_since_s = None

    def _line_problem(self, now_s: float) -> str | None:
        """The first thing that is missing on the way from the receiver's power to a fix."""
        if self._started_s is None:
            self._started_s = now_s
        since_s = now_s - SILENCE_S
        if since_s < self._started_s:
            return None
        if self._heard_s < since_s:
            return f"{self.name}: nothing received: check its power and wiring"
        if self._message_s < since_s:
            return f"{self.name}: no message at {self._config.baud} baud: trying other rates"
        if self._fix_s >= since_s:
            return None
        return f"{self.name}: no fix" + (" to trust" if self._doubted_s >= since_s else "")

    @property
    def _altitude_problem(self) -> str | None:
        by_sol = self._sol_only_epochs >= _SOL_ONLY_EPOCHS and self._separation_m is None
        return f"{self.name}: {ABOVE_ELLIPSOID}" if by_sol else None

    def _watch_for_silence(self, now_s: float) -> None:
        if self._ubx_seen or self._nmea_seen or self._quiet_since_s is None:
            self._ubx_seen = self._nmea_seen = False
            self._quiet_since_s = now_s
        if now_s - self._quiet_since_s > SILENCE_S:
            self._begin_anew()

    def _answered(self, message: bytes) -> None:
        if self.configured or self._asked_s is None or message[6:8] != self._commands[self._next][2:4]:
            return
        if message[2:4] == _ACK_NAK:
            command = self._commands[self._next]
            asked_fix = command[2:4] == b"\x06\x01" and command[6:8] in _REFUSED_FIX
            self._fix_refused |= asked_fix or command[2:4] == _BY_KEYS
            if not self._concluded or self._refused is None:  # else what serves, and lacks, is said already
                self._refused = f"{self.name}: refuses {command_name(command)}"
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
        if identity == _VERSION:
            self.name, self._named = receiver_name(message.data[6:-2]), True
            return None
        part = _PARTS.get(identity)
        if part is None or len(message.data) - UBX_OVERHEAD not in _LENGTHS[part]:
            return None
        # pyubx2 turns iTOW into a time of day: take the milliseconds as they are
        (time_of_week_ms,) = struct.unpack_from("<I", message.data, 6)
        ended = None
        if time_of_week_ms / 1000.0 != self._epoch.epoch_s:
            ended = self._fix_of_sol_alone()
            self._epoch = _Epoch(time_of_week_ms / 1000.0, message.began_s)
            self._status_ok = True  # unless it says otherwise
        parsed = UBXReader.parse(message.data)
        if part == "STATUS":
            self._status_ok = bool(parsed.gpsFixOk)
        elif part == "DOP":
            self._dop, self._dop_s = float(parsed.hDOP), message.began_s
        if part in TRUST_MESSAGES.values():
            return ended
        self._epoch.parts[part] = parsed
        return self._fix_of_epoch() or ended

    def _fix_of_epoch(self) -> GpsFix | None:
        epoch = self._epoch
        parts = epoch.take(_PVT_FIX) or epoch.take(_SOL_FIX)
        if parts is None:
            return None
        self._ubx_seen = True
        self._ubx_epoch_s = epoch.began_s
        if (pvt := parts.get("PVT")) is not None:
            time_s = self._time_s(self._ubx_clock, epoch, bool(pvt.gnssFixOk))
            return self._trusted(fix_from_pvt(time_s, pvt), epoch.began_s)
        self._sol_only_epochs = 0
        self._separation_m = (parts["POSLLH"].height - parts["POSLLH"].hMSL) / 1000.0
        time_s = self._time_s(self._ubx_clock, epoch, has_fix(parts["SOL"]))
        fix = fix_from_ubx(time_s, parts["POSLLH"], parts["VELNED"], parts["SOL"])
        return self._trusted(fix, epoch.began_s)

    def _time_s(self, clock: EpochClock, epoch: _Epoch, valid: bool) -> float:
        """When an epoch with a valid fix was measured, on our clock; of any other it is no matter."""
        return (
            clock.local_s(epoch.epoch_s, epoch.began_s) - self._config.latency_s if valid else epoch.began_s
        )

    def _fix_of_sol_alone(self) -> GpsFix | None:
        """The fix of an epoch that has ended with a NAV-SOL and no other position, if that is the rule."""
        epoch = self._epoch
        if set(epoch.parts) != {"SOL"} or epoch.began_s - self._ubx_epoch_s < SILENCE_S:
            self._sol_only_epochs = 0
            return None
        self._sol_only_epochs += 1
        if self._sol_only_epochs < _SOL_ONLY_EPOCHS:
            return None
        self._ubx_seen = True
        sol = epoch.parts["SOL"]
        time_s = self._time_s(self._ubx_clock, epoch, has_fix(sol))
        return self._trusted(fix_from_sol(time_s, sol, self._separation_m), epoch.began_s)

    def _trusted(self, fix: GpsFix | None, began_s: float) -> GpsFix | None:
        """The fix, unless this epoch's NAV-STATUS or a NAV-DOP of late speaks against it."""
        if fix is None:
            self._dop = None  # that of a lost fix says nothing of the next one
            return None
        dop = self._dop if began_s - self._dop_s < SILENCE_S else None
        if not self._status_ok or (dop is not None and dop > self._config.maximum_hdop):
            self._doubted_s = began_s
            return None
        return fix

    def _feed_nmea(self, message: GpsMessage) -> GpsFix | None:
        if message.began_s - self._ubx_epoch_s < SILENCE_S or message.data[3:6] not in _SENTENCES:
            return None
        sentence = parse_sentence(message.data)
        if sentence is None:
            return None
        if sentence.msgID == "GSA":
            self._nmea_3d = sentence.navMode == 3
            return None
        epoch_s = seconds_of_day(sentence.time)
        if epoch_s != self._nmea.epoch_s:
            self._nmea = _Epoch(epoch_s, message.began_s)
        self._nmea.parts[sentence.msgID] = sentence
        return self._fix_of_sentences()

    def _fix_of_sentences(self) -> GpsFix | None:
        epoch = self._nmea
        parts = epoch.take(_NMEA_FIX) if self._nmea_3d else None
        if parts is None:
            return None
        self._nmea_seen = True
        time_s = self._time_s(self._nmea_clock, epoch, parts["RMC"].status == "A")
        fix = fix_from_nmea(time_s, parts["RMC"], parts["GGA"])
        hdop = parts["GGA"].HDOP
        if fix is not None and hdop > self._config.maximum_hdop:
            self._doubted_s = epoch.began_s
            return None
        return fix
