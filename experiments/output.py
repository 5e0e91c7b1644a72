"""Whether a file can be written, asked before the minutes of flying that it is for."""

from pathlib import Path

from companion.base.errors import ConfigError


def writable(path: Path, suffix: str, option: str) -> None:
    """Make sure by opening it: permissions show nothing of a folder by that name or a read-only disk.

    Raises:
        ConfigError: it cannot be written, or has another suffix.
    """
    expected = f"{option} {path}: expected a {suffix} file in a folder that can be written"
    if path.suffix.lower() != suffix:
        raise ConfigError(expected)
    existed = path.exists()
    try:
        path.open("ab").close()
        if not existed:
            path.unlink()
    except OSError as error:
        raise ConfigError(f"{expected}: {error.strerror}") from error
