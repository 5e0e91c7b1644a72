"""MAVLink 1 and 2 frames out of bytes, sans I/O; their check sums are right, nothing in them is read yet.

A start byte in garbage claims up to 280 bytes that follow it. They are not believed: when the check sum is
wrong the search goes on at the next byte, so that no good frame inside is lost. In a datagram a frame never
goes beyond its end; in a stream one that is not completed within `PATIENCE_S` is no frame.

The app's codec frames by itself: a fault there must not be repeated here and so stay unseen. The dialect is
ardupilotmega, which holds common. Source: mavlink.io, "Packet serialization".
"""

from __future__ import annotations

import math
import re
import struct
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega

dialect: Any = ardupilotmega

PATIENCE_S: Final = 0.1
_MARKER: Final = re.compile(b"[\xfd\xfe]")
_V2_MARKER: Final = 0xFD
_V1_HEADER_BYTES: Final = 6
_V2_HEADER_BYTES: Final = 10
_CRC_BYTES: Final = 2
_SIGNED: Final = 0x01
SIGNATURE_BYTES: Final = 13
_BEYOND: Final = 1e7


class MavFrame(NamedTuple):
    """One whole frame: its bytes, the message's id, who sent it, whether it bears a signature."""

    data: bytes
    message_id: int
    system: int
    component: int
    signed: bool

    @property
    def target(self) -> tuple[int, int]:
        """System and component that it is meant for; 0 is all of them, as in messages without a target."""
        at_system, at_component = _TARGET_AT.get(self.message_id, (-1, -1))
        return self._payload_byte(at_system), self._payload_byte(at_component)

    def _payload_byte(self, at: int) -> int:
        """A byte of the payload; MAVLink 2 does not send zeros at its end."""
        is_v2 = self.data[0] == _V2_MARKER
        header, size = _V2_HEADER_BYTES if is_v2 else _V1_HEADER_BYTES, self.data[1]
        return self.data[header + at] if 0 <= at < size else 0


class FrameReader:
    """Cuts what comes over one link into frames. `datagrams`: every call of `read` brings whole frames."""

    def __init__(self, *, datagrams: bool = False) -> None:
        self._datagrams = datagrams
        self._buffer = bytearray()
        self._begun_s = 0.0
        self.skipped_bytes = 0

    @property
    def waits(self) -> bool:
        """Whether the beginning of what may be a frame is kept."""
        return bool(self._buffer)

    def read(self, data: bytes, now_s: float) -> list[MavFrame]:
        """The frames that these bytes complete, in order; without bytes, those that waiting has freed."""
        stale = bool(self._buffer) and now_s - self._begun_s > PATIENCE_S
        idle = not self._buffer
        self._buffer += data
        frames, used = self._cut(1 if stale else 0)
        self.skipped_bytes += used - sum(len(frame.data) for frame in frames)
        del self._buffer[:used]
        if idle or used:
            self._begun_s = now_s
        return frames

    def _cut(self, start: int) -> tuple[list[MavFrame], int]:
        """Frames in the buffer from `start` on, and how many of its bytes are done with."""
        buffer = self._buffer
        frames: list[MavFrame] = []
        while (marker := _MARKER.search(buffer, start)) is not None:
            start = marker.start()
            size = _frame_size(buffer, start)
            if size > len(buffer) - start and not self._datagrams:
                return frames, start
            frame = _whole_frame(buffer[start : start + size]) if size else None
            if frame is not None:
                frames.append(frame)
            start += 1 if frame is None else size
        return frames, len(buffer)


def _frame_size(buffer: bytearray, start: int) -> int:
    """Bytes that a frame beginning here would have; 0 when none can begin here."""
    have = len(buffer) - start
    if buffer[start] != _V2_MARKER:
        if have < _V1_HEADER_BYTES:
            return _V1_HEADER_BYTES
        known = buffer[start + 5] in dialect.mavlink_map
        return _V1_HEADER_BYTES + buffer[start + 1] + _CRC_BYTES if known else 0
    if have < _V2_HEADER_BYTES:
        return _V2_HEADER_BYTES
    flags = buffer[start + 2]
    message_id = int.from_bytes(buffer[start + 7 : start + 10], "little")
    if flags & ~_SIGNED or message_id not in dialect.mavlink_map:
        return 0
    signature = SIGNATURE_BYTES if flags & _SIGNED else 0
    return _V2_HEADER_BYTES + buffer[start + 1] + _CRC_BYTES + signature


def _whole_frame(data: bytearray) -> MavFrame | None:
    """The frame in these bytes; None when they are too few or their check sum is wrong."""
    is_v2 = data[0] == _V2_MARKER
    header = _V2_HEADER_BYTES if is_v2 else _V1_HEADER_BYTES
    if len(data) < header + _CRC_BYTES or len(data) < header + data[1] + _CRC_BYTES:
        return None
    signed = is_v2 and bool(data[2] & _SIGNED)
    message_id = int.from_bytes(data[7:10], "little") if is_v2 else data[5]
    system, component = (data[5], data[6]) if is_v2 else (data[3], data[4])
    end = header + data[1]
    if signed and len(data) < end + _CRC_BYTES + SIGNATURE_BYTES:
        return None
    covered = data[1:end]
    covered.append(dialect.mavlink_map[message_id].crc_extra)
    if dialect.x25crc(covered).crc != int.from_bytes(data[end : end + _CRC_BYTES], "little"):
        return None
    return MavFrame(bytes(data), message_id, system, component, signed)


def _target_offsets() -> dict[int, tuple[int, int]]:
    """Where in the payload of each message that has one its target's system and component are (-1: not)."""
    found: dict[int, tuple[int, int]] = {}
    for message_id, kind in dialect.mavlink_map.items():
        names, types = kind.ordered_fieldnames, _FIELD.findall(kind.unpacker.format)
        at = {name: struct.calcsize("<" + "".join(types[:i])) for i, name in enumerate(names)}
        system = "target" if message_id == dialect.MAVLINK_MSG_ID_MANUAL_CONTROL else "target_system"
        if system in at:
            found[message_id] = (at[system], at.get("target_component", -1))
    return found


_FIELD: Final = re.compile(r"\d*[a-zA-Z]")
_TARGET_AT: Final = _target_offsets()


def number(value: float) -> float:
    """A float of a message; NaN, which says "not given", when it is infinite or beyond all that flies."""
    return value if -_BEYOND < value < _BEYOND else math.nan
