"""MAVLink 2 message signing: the key from its file, and which frames are right. Pure but for the key's file.

With a key every frame that we send is signed, and what comes unsigned, with a wrong signature or with an old
time stamp is refused. Time stamps count 10 µs since 2015-01-01 UTC and only increase; the first signed frame
of the autopilot moves ours on to its time: a clock that is wrong at boot does no harm. The check is ours:
pymavlink's advances a stream's time before it has verified, so that one forged frame silences that stream.
Source: mavlink.io, "Message Signing".
"""

import hashlib
import hmac
import stat
from pathlib import Path
from typing import Final

from companion.config import ConfigError, LinkConfig

KEY_BYTES: Final = 32
EPOCH_UNIX_S: Final = 1_420_070_400
STAMPS_PER_S: Final = 100_000
NEW_STREAM_MAY_LAG_S: Final = 60  # the protocol's own
_NEW_STREAM_MAY_LAG: Final = NEW_STREAM_MAY_LAG_S * STAMPS_PER_S
V2_MARKER: Final = 0xFD
SIGNED_FLAG: Final = 0x01
SIGNATURE_BYTES: Final = 13  # link id, six bytes of stamp, six of the hash
_HASH_BYTES: Final = 6
_LAST_STAMP: Final = (1 << 48) - 1
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


class LinkSigning:
    """What is right on a link, by the time stamps of its streams (link id, system, component).

    `stamp` is the newest of our own, of what was accepted, and of the clock's. The transport asks before the
    session takes a frame in, so that `is_right` and `is_fresh` change nothing; `accepts` does.
    """

    def __init__(self, secret: bytes, stamp: int, kept_stamp: int = 0) -> None:
        """Begin at a stamp. What an earlier process accepted, up to `kept_stamp`, is not accepted again."""
        self.secret, self._kept_stamp = secret, kept_stamp
        self.stamp = self._began = max(stamp, kept_stamp)
        self._began_s: float | None = None
        self._streams: dict[tuple[int, int, int], int] = {}

    @property
    def streams(self) -> int:
        return len(self._streams)

    def advance(self, now_s: float) -> None:
        """Move our stamps on with the clock: what was recorded a while ago is old, however little we send."""
        if self._began_s is None:
            self._began_s = now_s
        by_clock = self._began + int((now_s - self._began_s) * STAMPS_PER_S)
        self.stamp = min(max(self.stamp, by_clock), _LAST_STAMP)

    def next_stamp(self) -> int:
        """The stamp of the next frame that we send."""
        self.stamp = min(self.stamp + 1, _LAST_STAMP)
        return self.stamp

    def is_right(self, frame: bytes | bytearray) -> bool:
        """Whether whoever sent this whole frame has the key, now or at any time before."""
        if frame[0] != V2_MARKER or not frame[2] & SIGNED_FLAG:
            return False
        found = hashlib.sha256(self.secret + bytes(frame[:-_HASH_BYTES])).digest()[:_HASH_BYTES]
        return hmac.compare_digest(found, bytes(frame[-_HASH_BYTES:]))

    def is_fresh(self, frame: bytes | bytearray) -> bool:
        """Whether a right frame is later than all that was accepted of its stream.

        A new stream may lag by a minute, but not behind what an earlier process has accepted.
        """
        latest = max(self._kept_stamp, self.stamp - _NEW_STREAM_MAY_LAG - 1)
        return _stamp_of(frame) > self._streams.get(_stream_of(frame), latest)

    def accepts(self, frame: bytes | bytearray) -> bool:
        """Whether a whole frame is right and fresh; then its stream's time advances."""
        if not self.is_right(frame) or not self.is_fresh(frame):
            return False
        stamp = _stamp_of(frame)
        self._streams[_stream_of(frame)] = stamp
        self.stamp = max(self.stamp, stamp)
        return True


def _stamp_of(frame: bytes | bytearray) -> int:
    return int.from_bytes(frame[1 - SIGNATURE_BYTES : -_HASH_BYTES], "little")


def _stream_of(frame: bytes | bytearray) -> tuple[int, int, int]:
    return frame[-SIGNATURE_BYTES], frame[5], frame[6]


def stamp_from_unix(unix_s: float) -> int:
    """Seconds since 1970 as a signing time stamp, 0 before 2015."""
    return max(0, int((unix_s - EPOCH_UNIX_S) * STAMPS_PER_S))


def secret_from(data: bytes) -> bytes | None:
    """The secret in a file's bytes: 32 bytes, or else the SHA-256 of the passphrase, as MAVProxy makes it."""
    if len(data) == KEY_BYTES:
        return data
    return hashlib.sha256(data.strip()).digest() if data.strip() else None


def read_signing_key(path: Path, unix_s: float, kept_stamp: int = 0) -> LinkSigning:
    """The signing by the app's key; only its owner may read the file. `kept_stamp`: see `LinkSigning`.

    Raises:
        ConfigError: it cannot be read, is empty, or others may read it.
    """
    try:
        data, mode = path.read_bytes(), path.stat().st_mode
    except OSError as error:
        raise ConfigError(
            f"link.signing_key {path}: {error.strerror}; expected a file with the key"
        ) from error
    if mode & _OTHERS:
        raise ConfigError(
            f"link.signing_key {path}: mode {stat.S_IMODE(mode):04o}, others may read it; expected 0600"
        )
    secret = secret_from(data)
    if secret is None:
        raise ConfigError(f"link.signing_key {path}: empty; expected 32 bytes or a passphrase")
    return LinkSigning(secret, stamp_from_unix(unix_s), kept_stamp)


def signing_of(config: LinkConfig, unix_s: float, kept_stamp: int = 0) -> LinkSigning | None:
    """The signing of the link that the settings describe; None: it is not signed.

    Raises:
        ConfigError: the key cannot be read, is empty, or others may read it.
    """
    if config.signing_key is None:
        return None
    return read_signing_key(config.signing_key, unix_s, kept_stamp)
