"""MAVLink 2 signing, sans I/O: one secret key for all links of a vehicle, and the times on each stream.

A frame is accepted when its signature is right and its time stamp is later than the last one of its stream
(link id, system, component); a new stream may lag by a minute. The stamps are common to all
links, so that a frame of one cannot be replayed on another; only right signatures advance them. They
count 10 µs since 2015-01-01 UTC. Sources: mavlink.io, "Message Signing"; what passes unsigned: ArduPilot's
GCS_Signing, PX4's mavlink_sign_control.
"""

from __future__ import annotations

import hashlib
import hmac
from pathlib import Path
from typing import Any, Final

from companion.base.autopilot_kind import AutopilotKind
from companion.config import ConfigError
from companion.link.codec import SIGNATURE_BYTES
from companion.link.signing import STAMPS_PER_S, secret_from, stamp_from_unix
from sitl.mavlink.framing import MavFrame, dialect

_NEW_STREAM_MAY_LAG: Final = 60 * STAMPS_PER_S
_TAG_BYTES: Final = 6
_LAST_STAMP: Final = (1 << 48) - 1
UNSIGNED: Final[dict[AutopilotKind, frozenset[int]]] = {
    "px4": frozenset(
        {
            dialect.MAVLINK_MSG_ID_HEARTBEAT,
            dialect.MAVLINK_MSG_ID_RADIO_STATUS,
            dialect.MAVLINK_MSG_ID_ADSB_VEHICLE,
            dialect.MAVLINK_MSG_ID_COLLISION,
        }
    ),
    "ardupilot": frozenset({dialect.MAVLINK_MSG_ID_RADIO_STATUS, dialect.MAVLINK_MSG_ID_RADIO}),
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
        """Whether a frame passes signing."""
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
