"""The file of a flight, `flight.mcap`: what its parts are called, and its records in the order of writing.

It is read from the front without the file's index, so that a log cut short by a crash or a flat battery gives
what its whole chunks hold.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Final

import zstandard
from mcap.exceptions import McapError
from mcap.records import Chunk, DataEnd
from mcap.stream_reader import StreamReader, breakup_chunk

LOG_NAMES: Final = ("flight.mcap", "flight.tlog")
SETTINGS_NAME: Final = "settings.yaml"
# the MCAP metadata that a replay needs
SETTINGS_RECORD: Final = "settings"
VERSIONS_RECORD: Final = "versions"
LOSSES_RECORD: Final = "losses"


def log_file(path: Path) -> Path:
    """The log itself, of a path that may be a flight's folder."""
    return path / LOG_NAMES[0] if path.is_dir() else path


def records(stream: IO[bytes], end_early: Callable[[], None]) -> Iterator[Any]:
    """The records up to the end of the data; `end_early` is called when the file stops before that."""
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, DataEnd):
                return
            if isinstance(record, Chunk):
                yield from breakup_chunk(record, validate_crc=True)
            else:
                yield record
    # what a cut or damaged chunk raises, depending on where it is cut
    except (McapError, EOFError, ValueError, struct.error, zstandard.ZstdError):
        pass
    end_early()
