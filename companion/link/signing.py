"""The key of MAVLink 2 message signing, from its file.

With a key every frame that we send is signed, and what comes unsigned or with a wrong signature is refused
(pymavlink's own implementation does both). Time stamps count 10 µs since 2015-01-01 UTC and only increase;
the first signed frame of the autopilot moves ours on to its time: a clock that is wrong at boot does no harm.
Source: mavlink.io, "Message Signing".
"""

from __future__ import annotations

import hashlib
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.config import ConfigError

KEY_BYTES: Final = 32
EPOCH_UNIX_S: Final = 1_420_070_400
STAMPS_PER_S: Final = 100_000
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


@dataclass(frozen=True, slots=True)
class SigningKey:
    """The secret, and the time stamp to begin with."""

    secret: bytes
    stamp: int


def stamp_from_unix(unix_s: float) -> int:
    """Seconds since 1970 as a signing time stamp, 0 before 2015."""
    return max(0, int((unix_s - EPOCH_UNIX_S) * STAMPS_PER_S))


def secret_from(data: bytes) -> bytes | None:
    """The secret in a file's bytes: 32 bytes, or else the SHA-256 of the passphrase, as MAVProxy makes it."""
    if len(data) == KEY_BYTES:
        return data
    return hashlib.sha256(data.strip()).digest() if data.strip() else None


def read_signing_key(path: Path, unix_s: float) -> SigningKey:
    """The app's key; only its owner may read the file.

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
    return SigningKey(secret, stamp_from_unix(unix_s))
