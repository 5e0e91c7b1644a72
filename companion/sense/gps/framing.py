"""Cuts a GPS receiver's byte stream into UBX messages and NMEA sentences, each with the time it began.

Garbage, halves and damaged messages are skipped: after a message that does not check, the search goes on
at its second byte, so that a whole one inside it is not lost.
"""

import datetime
from collections import deque
from dataclasses import dataclass
from typing import Any, Final

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

UBX_SYNC: Final = b"\xb5\x62"
UBX_OVERHEAD: Final = 8  # sync, class, id, length, checksum
_UBX_LONGEST_PAYLOAD: Final = 512  # what we ask for has 52; a garbled length must not hide much
_NMEA_LONGEST: Final = 120  # the standard says 82; receivers with many digits write more
_BITS_PER_BYTE: Final = 10


@dataclass(frozen=True, slots=True)
class GpsMessage:
    """One checked message as it came; `began_s` is when its first bit left the receiver."""

    data: bytes
    began_s: float

    @property
    def is_ubx(self) -> bool:
        """UBX, or else NMEA."""
        return self.data[:1] == UBX_SYNC[:1]


class FrameSplitter:
    """Feed it what comes; it returns the messages that are whole."""

    def __init__(self, baud: int) -> None:
        self._byte_s = _BITS_PER_BYTE / baud
        self._buffer = bytearray()
        self._consumed = 0  # bytes ever taken out of the buffer
        self._chunks: deque[tuple[int, float]] = deque()  # bytes ever received at the chunk's end, and when

    def feed(self, data: bytes, received_s: float) -> list[GpsMessage]:
        """Messages completed by `data`, whose last byte came at `received_s`."""
        self._buffer += data
        self._chunks.append((self._consumed + len(self._buffer), received_s))
        messages = []
        while (start := self._next_start()) >= 0:
            self._drop(start)
            length = self._length()
            if length is None:
                break
            if length == 0:
                self._drop(1)
                continue
            messages.append(GpsMessage(bytes(self._buffer[:length]), self._began_s()))
            self._drop(length)
        self._forget_chunks()
        return messages

    def _next_start(self) -> int:
        starts = [at for at in (self._buffer.find(UBX_SYNC[:1]), self._buffer.find(b"$")) if at >= 0]
        if not starts:
            self._drop(len(self._buffer))
            return -1
        return min(starts)

    def _length(self) -> int | None:
        """Bytes of the message at the buffer's start; 0 if there is none, None if it is not all there."""
        return self._ubx_length() if self._buffer[0] == UBX_SYNC[0] else self._nmea_length()

    def _ubx_length(self) -> int | None:
        buffer = self._buffer
        if not UBX_SYNC.startswith(buffer[:2]):
            return 0
        if len(buffer) < 6:
            return None
        payload = buffer[4] | buffer[5] << 8
        if payload > _UBX_LONGEST_PAYLOAD:
            return 0
        length = payload + UBX_OVERHEAD
        if len(buffer) < length:
            return None
        first = second = 0
        for value in buffer[2 : length - 2]:
            first = (first + value) & 0xFF
            second = (second + first) & 0xFF
        return length if (first, second) == (buffer[length - 2], buffer[length - 1]) else 0

    def _nmea_length(self) -> int | None:
        end = self._buffer.find(b"\n", 0, _NMEA_LONGEST)
        if end < 0:
            return None if len(self._buffer) < _NMEA_LONGEST and self._buffer.isascii() else 0
        body, star, check = bytes(self._buffer[1:end]).rstrip(b"\r").partition(b"*")
        total = 0
        for value in body:
            total ^= value
        return end + 1 if star and check.upper() == b"%02X" % total else 0

    def _began_s(self) -> float:
        for end, received_s in self._chunks:
            if end > self._consumed:
                return received_s - (end - self._consumed) * self._byte_s
        raise AssertionError("a message without a chunk")

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._consumed += count

    def _forget_chunks(self) -> None:
        while self._chunks and self._chunks[0][0] <= self._consumed:
            self._chunks.popleft()


# ---------------------------------------------------------------- sentences

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
