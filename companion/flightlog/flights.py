"""The folders of many flights under one root, `flight-0001` and on, and room for the next.

Names are numbers, not dates: they sort by time also where the clock was wrong at boot, as on a Raspberry Pi
without a network. The newest flight always stays, so no number comes twice.
"""

import io
import shutil
import zipfile
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

from companion.base.errors import ConfigError
from companion.flightlog.log_file import LOG_NAMES

PREFIX: Final = "flight-"
# what a removal that was cut short leaves behind; the next one ends it
REMOVED_PREFIX: Final = ".removed-"
PIECE_BYTES: Final = 1 << 18  # of a file that is packed


def number_of(folder: Path) -> int | None:
    """The number in a flight's name; None for any other name."""
    digits = folder.name.removeprefix(PREFIX)
    return int(digits) if folder.name.startswith(PREFIX) and digits.isdecimal() else None


def numbered_flights(root: Path) -> list[Path]:
    """The folders of flights, oldest first; what else is in the root is none of them."""
    numbered = [(number_of(path), path) for path in root.glob(f"{PREFIX}*") if path.is_dir()]
    return [path for number, path in sorted((n, p) for n, p in numbered if n is not None)]


def next_flight_folder(root: Path) -> Path:
    """The folder for the next flight; not made here."""
    last = number_of(flights[-1]) if (flights := numbered_flights(root)) else 0
    return root / f"{PREFIX}{(last or 0) + 1:04d}"


def recorded_flights(root: Path) -> list[Path]:
    """All folders in the root that hold a log: the numbered ones, oldest first, then others by name."""
    others = sorted(path for path in root.iterdir() if path.is_dir() and number_of(path) is None)
    return [path for path in (*numbered_flights(root), *others) if (path / LOG_NAMES[0]).is_file()]


def size_bytes(folder: Path) -> int:
    """What the files of a folder hold; one that has gone, or cannot be read any more, holds nothing."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total


def pack(folder: Path, compression: int = zipfile.ZIP_STORED) -> Iterator[bytes]:
    """All of a flight's folder as one zip file, piece by piece; the log is compressed already."""
    pieces = _Pieces()
    with zipfile.ZipFile(pieces, "w", compression, compresslevel=1) as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            name = Path(folder.resolve().name) / path.relative_to(folder)
            # a clock that is not set at boot gives files of 1970, and a zip file begins in 1980
            entry = zipfile.ZipInfo.from_file(path, name, strict_timestamps=False)
            entry.compress_type = compression
            with path.open("rb") as file, archive.open(entry, "w") as packed:
                while piece := file.read(PIECE_BYTES):
                    packed.write(piece)
                    yield pieces.taken()
    yield pieces.taken()


class _Pieces(io.RawIOBase):
    """What was written since it was last taken; a file that is only written to, and not sought in."""

    def __init__(self) -> None:
        self._written: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._written.append(bytes(data))
        return len(self._written[-1])

    def taken(self) -> bytes:
        written, self._written = self._written, []
        return b"".join(written)


def make_room(root: Path, cap_bytes: float, free_bytes: float, keep: Collection[Path] = ()) -> list[Path]:
    """Remove the oldest flights until they hold no more than `cap_bytes` and the disk has `free_bytes` free.

    The newest flight and those in `keep` (the one being written) stay, whatever the limits say; a flight
    that cannot be removed is passed over. None is removed for free room that all of them would not make.
    Returns what was removed.

    Raises:
        ConfigError: `free_bytes` cannot be reached; `cap_bytes` is kept to all the same.
    """
    for rest in root.glob(f"{REMOVED_PREFIX}*"):
        shutil.rmtree(rest, ignore_errors=True)
    flights = numbered_flights(root)
    kept = {path.resolve() for path in (*keep, *flights[-1:])}
    sizes = {path: size_bytes(path) for path in flights}
    removable = sum(sizes[path] for path in flights if path.resolve() not in kept)
    most_free = shutil.disk_usage(root).free + removable
    total, removed = sum(sizes.values()), []
    for path in flights:
        if total <= cap_bytes and (free_bytes > most_free or shutil.disk_usage(root).free >= free_bytes):
            break
        if path.resolve() in kept:
            continue
        if _remove(path):
            removed.append(path)
            total -= sizes[path]
        else:
            most_free -= sizes[path]
    if free_bytes > most_free:
        raise ConfigError(
            f"record.free_mb {free_bytes / 1e6:.6g}: without all old flights {most_free / 1e6:.0f} MB would "
            "be free, so none is removed for it; expected other files removed, or less"
        )
    return removed


def _remove(folder: Path) -> bool:
    """Take a flight out of the list in one step, then its files; False where that is not allowed."""
    doomed = folder.with_name(REMOVED_PREFIX + folder.name)
    try:
        folder.rename(doomed)
    except OSError:
        return False
    shutil.rmtree(doomed, ignore_errors=True)
    return True
