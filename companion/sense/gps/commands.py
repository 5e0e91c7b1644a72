"""A u-blox receiver's settings as UBX commands (u-blox 6 Receiver Description GPS.G6-SW-10018).

NAV-POSLLH, NAV-VELNED and NAV-SOL at every epoch make a fix; NAV-STATUS and NAV-DOP say how far to trust it
and come as often where the line carries them (190 bytes an epoch in all: at 9600 baud five of them would
fill it), else once a second.
From the M9 on NAV-SOL is gone, and NAV-PVT (u-blox M9 Interface Description UBX-19035940) holds a whole fix.
The M10 takes none of the old commands: CFG-VALSET (u-blox M10 Interface Description UBX-20053845) sets keys
to the same effect. NMEA, which serves until then, is switched off once a receiver has been seen to send the
fixes asked for; one that sends none keeps to NMEA.
"""

import itertools
import math
import struct
from collections.abc import Iterator
from typing import Any, Final, Literal

from pyubx2 import POLL, SET, UBXMessage, UBXReader

from companion.config import GpsConfig

# ---------------------------------------------------------------- the baud rate
# A receiver that wakes without its settings talks at 9600 baud; one that has been used elsewhere, at
# anything. At a wrong rate its bytes are garbage, so: listen at the rate that we want; when no message is
# understood there, at the next one; once there is a message, ask the receiver to change (CFG-PRT), go back to
# the wanted rate and listen there. A receiver that says nothing unasked is asked at each rate all the same.

# what a NEO-6M can, the likely ones first, and what ArduPilot leaves in later ones
RATES: Final = (9600, 38400, 57600, 115200, 19200, 4800, 230400, 460800)
LISTEN_S: Final = 1.6  # a receiver without settings talks once a second
SILENCE_S: Final = 3.0  # what was understood has stopped
CHANGES: Final = 3  # so often a receiver may be asked in vain


class BaudRate:
    """The rate of our end. `baud` is what the port is to be set to; `wanted` where the receiver is to go."""

    def __init__(self, wanted: int) -> None:
        self.baud = self.wanted = wanted
        self._others = self._all_others()
        self._since_s = -math.inf
        self._began = False
        self._asked = False
        self._in_vain = 0

    @property
    def there(self) -> bool:
        return self.baud == self.wanted

    def step(self, now_s: float, message_s: float) -> bool:
        """Change `baud` when it is time to.

        Args:
            now_s: the time; call it several times a second.
            message_s: when the last whole message came, at whatever rate.

        Returns:
            Whether to ask the receiver now to change to `wanted`. The next step goes there itself: by then
            the question must have left.
        """
        if not self._began:
            self._began, self._since_s = True, now_s
        if self._asked:
            self._asked = False
            self._go(self.wanted, now_s)
            return False
        understood = message_s > self._since_s
        quiet_s = now_s - max(self._since_s, message_s)
        if self.there:
            if understood:
                self._in_vain = 0
                self._others = self._all_others()
            if quiet_s > (SILENCE_S if understood else LISTEN_S):
                self._go(next(self._others), now_s)
            return False
        return self._ask(understood, quiet_s)

    def _ask(self, understood: bool, quiet_s: float) -> bool:
        if not understood and quiet_s <= LISTEN_S:
            return False
        if understood:  # if it does not follow, it is here
            self._in_vain += 1
            self._others = itertools.chain([self.baud], self._all_others())
        if self._in_vain > CHANGES:
            self.wanted = self.baud
            return False
        self._asked = True
        return True

    def _all_others(self) -> Iterator[int]:
        return itertools.cycle([rate for rate in RATES if rate != self.wanted])

    def _go(self, baud: int, now_s: float) -> None:
        self.baud = baud
        self._since_s = now_s


Dialect = Literal["sol", "pvt", "keys", "nmea"]
NEXT_DIALECT: Final[dict[Dialect, Dialect]] = {"sol": "pvt", "pvt": "keys", "keys": "nmea"}
# what identifies the receiver; asked for once it is heard
VERSION_REQUEST: Final = bytes(UBXMessage("MON", "MON-VER", POLL).serialize())
PVT_MESSAGE: Final = {b"\x01\x07": "PVT"}
FIX_MESSAGES: Final = {b"\x01\x02": "POSLLH", b"\x01\x12": "VELNED", b"\x01\x06": "SOL"}
TRUST_MESSAGES: Final = {b"\x01\x03": "STATUS", b"\x01\x04": "DOP"}

_NMEA_SENTENCES: Final = (0x01, 0x02, 0x03, 0x05, 0x04, 0x00)  # GLL, GSA, GSV, VTG, RMC, GGA
_NMEA_FIX: Final = (0x02, 0x04, 0x00)  # GSA, RMC, GGA
_AIRBORNE_2G: Final = 7
_UART1: Final = 1
_MODE_8N1: Final = 0x08D0
_UBX_AND_NMEA: Final = 0x0003
_SLOWEST_FOR_ALL_BAUD: Final = 19200
_IN_RAM: Final = 1  # until the receiver loses power, as with the old commands


def trial(config: GpsConfig, baud: int, dialect: Dialect = "sol") -> list[bytes]:
    """What asks for the fixes, beside NMEA and once a second as after power-up."""
    seldom = config.rate_hz if baud < _SLOWEST_FOR_ALL_BAUD else 1
    if dialect == "keys":
        sent = {"PVT": 1, "STATUS": seldom, "DOP": seldom}
        rates = {f"CFG_MSGOUT_UBX_NAV_{name}_UART1": rate for name, rate in sent.items()}
        return [_keys_command(rates | {"CFG_NAVSPG_DYNMODEL": _AIRBORNE_2G})]
    if dialect == "nmea":
        messages = [_message_rate(0xF0, sentence, 1) for sentence in _NMEA_FIX]
    else:
        fixes = FIX_MESSAGES if dialect == "sol" else PVT_MESSAGE
        messages = [_message_rate(0x01, identity[1], 1) for identity in fixes]
        messages += [_message_rate(0x01, identity[1], seldom) for identity in TRUST_MESSAGES]
    messages.append(UBXMessage("CFG", "CFG-NAV5", SET, dyn=1, dynModel=_AIRBORNE_2G))
    return [port_command(baud), *(bytes(message.serialize()) for message in messages)]


def conclusion(config: GpsConfig, dialect: Dialect = "sol") -> list[bytes]:
    """What follows once fixes come as asked for: the rate, and no NMEA that is not needed."""
    period_ms = 1000 // config.rate_hz
    if dialect == "keys":
        return [_keys_command({"CFG_UART1OUTPROT_NMEA": 0, "CFG_RATE_MEAS": period_ms})]
    silent = [] if dialect == "nmea" else [_message_rate(0xF0, sentence, 0) for sentence in _NMEA_SENTENCES]
    rate = UBXMessage("CFG", "CFG-RATE", SET, measRate=period_ms, navRate=1, timeRef=1)
    return [bytes(message.serialize()) for message in (*silent, rate)]


def port_command(baud: int) -> bytes:
    """CFG-PRT: UART 1 at `baud`, 8N1, UBX and NMEA both ways. Its answer comes at the new rate."""
    payload = struct.pack("<BBHIIHHHH", _UART1, 0, 0, _MODE_8N1, baud, _UBX_AND_NMEA, _UBX_AND_NMEA, 0, 0)
    return bytes(UBXMessage("CFG", "CFG-PRT", SET, payload=payload).serialize())


def baud_commands(baud: int) -> bytes:
    """The change to `baud`, as old receivers take it and as the M10 does: the other is refused."""
    return port_command(baud) + _keys_command({"CFG_UART1_BAUDRATE": baud})


def _keys_command(values: dict[str, int]) -> bytes:
    """CFG-VALSET of some keys."""
    return bytes(UBXMessage.config_set(_IN_RAM, 0, list(values.items())).serialize())


def command_name(command: bytes) -> str:
    """For people, "CFG-MSG"."""
    return str(UBXReader.parse(command, msgmode=SET).identity)


def _message_rate(message_class: int, message_id: int, rate: int) -> Any:
    return UBXMessage("CFG", "CFG-MSG", SET, msgClass=message_class, msgID=message_id, rateUART1=rate)


def receiver_name(version: bytes) -> str:
    """What MON-VER's payload says of the module: 30 and 10 bytes of versions, then lines of 30 bytes."""
    lines = [version[40 + 30 * k : 70 + 30 * k].split(b"\0")[0] for k in range((len(version) - 40) // 30)]
    module = next((line[4:] for line in lines if line.startswith(b"MOD=")), None)
    words = module or b"u-blox hardware " + version[30:40].split(b"\0")[0]
    return words.decode("ascii", "replace").strip()
