"""Writes what can be read of an MCAP file into a new one, with an index."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from companion.base.files import replaced
from companion.config import ConfigError
from companion.flightlog.log_file import records


@dataclass(frozen=True, slots=True)
class Repaired:
    """What was saved: messages, the time they span, and whether the source was cut short."""

    messages: int
    seconds: float
    cut: bool


def repair(source: Path, target: Path) -> Repaired:
    """Copy all whole records of `source` to the new file `target`; the source is left as it is.

    Raises:
        ConfigError: nothing can be read of the source, or the target cannot be written.
    """
    try:
        with replaced(target) as part:
            with source.open("rb") as stream, part.open("wb") as new:
                repaired = _copy(stream, new)
                new.flush()
                os.fsync(new.fileno())
            if not repaired.messages:
                raise ConfigError(f"{source}: holds no message that can be read; expected an MCAP log")
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    return repaired


def _copy(stream: IO[bytes], new: IO[bytes]) -> Repaired:
    writer = Writer(new, compression=CompressionType.ZSTD)
    writer.start(profile="", library="companion logs repair")
    cut: list[bool] = []
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    times_ns: list[int] = []
    for record in records(stream, lambda: cut.append(True)):
        if isinstance(record, Schema):
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas.get(record.schema_id, 0), record.metadata
            )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Message) and record.channel_id in channels:
            channel = channels[record.channel_id]
            writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            times_ns.append(record.log_time)
    writer.finish()  # type: ignore[no-untyped-call]
    seconds = 1e-9 * (max(times_ns) - min(times_ns)) if times_ns else 0.0
    return Repaired(len(times_ns), seconds, bool(cut))
