"""The NEO-6M's settings as UBX commands (u-blox 6 Receiver Description GPS.G6-SW-10018).

NAV-POSLLH, NAV-VELNED and NAV-SOL at every epoch make a fix; NAV-STATUS and NAV-DOP say how far to trust it
and come as often where the line carries them (190 bytes an epoch in all: at 9600 baud five of them would
fill it), else once a second.
"""

from __future__ import annotations

import struct
from typing import Any, Final

from pyubx2 import SET, UBXMessage, UBXReader

from companion.config import GpsConfig

FIX_MESSAGES: Final = {b"\x01\x02": "POSLLH", b"\x01\x12": "VELNED", b"\x01\x06": "SOL"}
TRUST_MESSAGES: Final = {b"\x01\x03": "STATUS", b"\x01\x04": "DOP"}

_NMEA_SENTENCES: Final = (0x01, 0x02, 0x03, 0x05, 0x04, 0x00)  # GLL, GSA, GSV, VTG, RMC, GGA
_AIRBORNE_2G: Final = 7
_UART1: Final = 1
_MODE_8N1: Final = 0x08D0
_UBX_AND_NMEA: Final = 0x0003
_SLOWEST_FOR_ALL_BAUD: Final = 19200


def configuration(config: GpsConfig, baud: int) -> list[bytes]:
    """The commands, in the order to send them on a line at `baud`; each is acknowledged."""
    seldom = config.rate_hz if baud < _SLOWEST_FOR_ALL_BAUD else 1
    messages = [_message_rate(0xF0, sentence, 0) for sentence in _NMEA_SENTENCES]
    messages += [_message_rate(0x01, identity[1], 1) for identity in FIX_MESSAGES]
    messages += [_message_rate(0x01, identity[1], seldom) for identity in TRUST_MESSAGES]
    messages += [
        UBXMessage("CFG", "CFG-NAV5", SET, dyn=1, dynModel=_AIRBORNE_2G),
        UBXMessage("CFG", "CFG-RATE", SET, measRate=1000 // config.rate_hz, navRate=1, timeRef=1),
    ]
    return [port_command(baud), *(bytes(message.serialize()) for message in messages)]


def port_command(baud: int) -> bytes:
    """CFG-PRT: UART 1 at `baud`, 8N1, UBX and NMEA both ways. Its answer comes at the new rate."""
    payload = struct.pack("<BBHIIHHHH", _UART1, 0, 0, _MODE_8N1, baud, _UBX_AND_NMEA, _UBX_AND_NMEA, 0, 0)
    return bytes(UBXMessage("CFG", "CFG-PRT", SET, payload=payload).serialize())


def command_name(command: bytes) -> str:
    """For people, "CFG-MSG"."""
    return str(UBXReader.parse(command, msgmode=SET).identity)


def _message_rate(message_class: int, message_id: int, rate: int) -> Any:
    return UBXMessage("CFG", "CFG-MSG", SET, msgClass=message_class, msgID=message_id, rateUART1=rate)
