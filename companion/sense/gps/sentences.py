"""NMEA sentences, as far as a fix needs them. Pure."""

import datetime
from typing import Any, Final

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

_FIELDS: Final = {
    "GSA": ("navMode",),
    "RMC": ("time", "status", "spd", "cog"),
    "GGA": ("time", "lat", "lon", "alt", "HDOP", "numSV", "quality"),
}


def parse_sentence(data: bytes) -> Any | None:
    """A sentence, if it can be read, holds the fields that are used and, unless it is GSA, tells the time."""
    try:
        sentence = NMEAReader.parse(data)
    except (NMEAMessageError, NMEAParseError, NMEATypeError, ValueError):
        return None
    if sentence is None or sentence.msgID not in _FIELDS:
        return None  # the parser does not know it, or takes its first letters for a maker's
    # a short sentence with a right check sum is parsed without the fields that it lacks
    if not all(hasattr(sentence, name) for name in _FIELDS[sentence.msgID]):
        return None
    return sentence if sentence.msgID == "GSA" or isinstance(sentence.time, datetime.time) else None


def seconds_of_day(time: datetime.time) -> float:
    """UTC, as seconds since midnight."""
    return time.hour * 3600.0 + time.minute * 60.0 + time.second + time.microsecond * 1e-6
