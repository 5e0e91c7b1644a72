"""A u-blox receiver's settings as UBX commands (u-blox 6 Receiver Description GPS.G6-SW-10018).

NAV-POSLLH, NAV-VELNED and NAV-SOL at every epoch make a fix; NAV-STATUS and NAV-DOP say how far to trust it
and come as often where the line carries them (190 bytes an epoch in all: at 9600 baud five of them would
fill it), else once a second.
From the M9 on NAV-SOL is gone, and NAV-PVT (u-blox M9 Interface Description UBX-19035940) holds a whole fix.
The M10 takes none of the old commands: CFG-VALSET (u-blox M10 Interface Description UBX-20053845) sets keys
to the same effect. NMEA, which serves until then, is switched off once a receiver has been seen to send the
fixes asked for; one that sends none keeps to NMEA.
"""

import struct
from typing import Any, Final, Literal

from pyubx2 import POLL, SET, UBXMessage, UBXReader

from companion.config import GpsConfig

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
