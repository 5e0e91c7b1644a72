"""MAVLink 1 and 2 frames out of bytes, sans I/O; their check sums are right, nothing in them is read yet.

The size and check sum rules are those of the app's codec. A start byte in garbage may claim up to 280 bytes.
When the check sum is wrong, the search continues at the next byte, so that no valid frame inside is lost. In
a datagram a frame never extends beyond its end. In a stream a frame that is not complete within `PATIENCE_S`
is dropped. Source: mavlink.io, "Packet serialization".
"""

import hashlib
import hmac
import math
import re
import struct
from pathlib import Path
from typing import Any, Final, NamedTuple

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from companion.link.codec import MARKER, check_sum_is_right, frame_size, header_bytes, mavlink, message_id_of
from companion.link.signing import (
    SIGNATURE_BYTES,
    SIGNED_FLAG,
    STAMPS_PER_S,
    V2_MARKER,
    secret_from,
    stamp_from_unix,
)

PATIENCE_S: Final = 0.1
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
        return self.data[header_bytes(self.data) + at] if 0 <= at < self.data[1] else 0


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
        while (marker := MARKER.search(buffer, start)) is not None:
            start = marker.start()
            size, have = frame_size(buffer, start), len(buffer) - start
            if size > have and not self._datagrams:
                return frames, start
            frame = _checked_frame(buffer[start : start + size]) if 0 < size <= have else None
            if frame is not None:
                frames.append(frame)
            start += 1 if frame is None else size
        return frames, len(buffer)


def _checked_frame(data: bytearray) -> MavFrame | None:
    """The frame in these bytes; None when its check sum is wrong."""
    message_id = message_id_of(data)
    if not check_sum_is_right(data, message_id):
        return None
    is_v2 = data[0] == V2_MARKER
    system, component = (data[5], data[6]) if is_v2 else (data[3], data[4])
    return MavFrame(bytes(data), message_id, system, component, is_v2 and bool(data[2] & SIGNED_FLAG))


def _target_offsets() -> dict[int, tuple[int, int]]:
    """Where in the payload of each message that has one its target's system and component are (-1: not)."""
    found: dict[int, tuple[int, int]] = {}
    for message_id, kind in mavlink.mavlink_map.items():
        names, types = kind.ordered_fieldnames, _FIELD.findall(kind.unpacker.format)
        at = {name: struct.calcsize("<" + "".join(types[:i])) for i, name in enumerate(names)}
        system = "target" if message_id == mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL else "target_system"
        if system in at:
            found[message_id] = (at[system], at.get("target_component", -1))
    return found


_FIELD: Final = re.compile(r"\d*[a-zA-Z]")
_TARGET_AT: Final = _target_offsets()


def packed(mav: Any, message: Any) -> bytes:
    """A message's frame by a packer of pymavlink's, whose sequence number goes on."""
    data = bytes(message.pack(mav))
    mav.seq = (mav.seq + 1) % 256
    return data


def number(value: float) -> float:
    """A float of a message; NaN, which says "not given", when it is infinite or beyond all that flies."""
    return value if -_BEYOND < value < _BEYOND else math.nan


# ---------------------------------------------------------------- signing
# MAVLink 2 signing, sans I/O: one secret key for all links of a vehicle, and the times on each stream.
#
# A frame is accepted when its signature is right and its time stamp is later than the last one of its stream
# (link id, system, component); a new stream may lag by a minute. The stamps are common to all
# links, so that a frame of one cannot be replayed on another; only right signatures advance them. They
# count 10 µs since 2015-01-01 UTC. Sources: mavlink.io, "Message Signing"; what passes unsigned: ArduPilot's
# GCS_Signing, PX4's mavlink_sign_control.

_NEW_STREAM_MAY_LAG: Final = 60 * STAMPS_PER_S
_TAG_BYTES: Final = 6
_LAST_STAMP: Final = (1 << 48) - 1
UNSIGNED: Final[dict[AutopilotKind, frozenset[int]]] = {
    "px4": frozenset(
        {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
            mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
            mavlink.MAVLINK_MSG_ID_COLLISION,
        }
    ),
    "ardupilot": frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO}),
}


def read_key(path: Path) -> bytes:
    """The key in a file: its 32 bytes, or else the SHA-256 of the passphrase in it, as MAVProxy makes it.

    Raises:
        ConfigError: it cannot be read or is empty.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"--signing-key {path}: {error.strerror}; expected a file with the key") from error
    secret = secret_from(data)
    if secret is None:
        raise ConfigError(f"--signing-key {path}: empty; expected 32 bytes or a passphrase")
    return secret


class Signing:
    """Checks and creates signatures; without a key all frames pass and none is signed."""

    def __init__(self, autopilot: AutopilotKind, key: bytes | None = None) -> None:
        self._unsigned = UNSIGNED[autopilot]
        self._last: dict[tuple[int, int, int], int] = {}
        self.key = key
        self.stamp = 0
        self.refused = 0

    def set_up(self, key: bytes, stamp: int) -> None:
        """SETUP_SIGNING: take another key and begin at `stamp`; a key of zeros ends signing.

        With the same key again, the last stamps stay, so that nothing can be replayed.
        """
        changed = self.key != key
        self.key = key if any(key) else None
        self.stamp = min(max(self.stamp, stamp), _LAST_STAMP)
        if changed:
            self._last.clear()

    def advance(self, unix_s: float) -> None:
        """Advance the own time stamps to a time (s since 1970); they never decrease."""
        self.stamp = max(self.stamp, stamp_from_unix(unix_s))

    def accepts(self, frame: MavFrame) -> bool:
        if self.key is None or (frame.signed and self._is_genuine(frame, self.key)):
            return True
        if frame.message_id in self._unsigned:
            return True
        self.refused += 1
        return False

    def prepare(self, packer: Any, link_id: int) -> None:
        """Set up pymavlink's packer to sign for a link, or not."""
        signing = packer.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = self.key, self.key is not None, link_id
        signing.timestamp = max(signing.timestamp, self.stamp)

    def _is_genuine(self, frame: MavFrame, key: bytes) -> bool:
        data = frame.data
        tag = hashlib.sha256(key + data[:-_TAG_BYTES]).digest()[:_TAG_BYTES]
        if not hmac.compare_digest(tag, data[-_TAG_BYTES:]):
            return False
        link_id = data[-SIGNATURE_BYTES]
        stamp = int.from_bytes(data[1 - SIGNATURE_BYTES : -_TAG_BYTES], "little")
        stream = (link_id, frame.system, frame.component)
        earliest = self._last.get(stream, self.stamp - _NEW_STREAM_MAY_LAG - 1)
        if stamp <= earliest:
            return False
        self._last[stream] = stamp
        self.stamp = max(self.stamp, stamp)
        return True
