"""Writing files so that nobody ever sees half of one."""

from __future__ import annotations

from pathlib import Path

from companion.config import ConfigError


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a file whole, text as UTF-8, or leave what was there.

    Raises:
        ConfigError: it cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
