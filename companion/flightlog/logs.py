"""The recorded flights as a list, one as an archive or as tables, a cut log made whole.

Our own tools read a cut log as it is; others', Foxglove and the seeking reader of the `mcap` package among
them, look for the index at its end.
"""

import os
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Final

import typer
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from companion.base.errors import ConfigError
from companion.base.files import cannot_read, replaced
from companion.flightlog.flights import pack, recorded_flights
from companion.flightlog.log_file import REPAIRED_NAME, records
from companion.flightlog.summary import summary_of
from companion.flightlog.tables import TableFormat, convert

MEGABYTE: Final = 1_000_000


def list_flights(root: Path) -> None:
    try:
        flights = recorded_flights(root)
    except OSError as error:
        raise cannot_read(root, error, expected="a folder of flights") from error
    total = 0
    if flights:
        typer.echo(
            f"{'flight':<18} {'began':<16} {'time':>7} {'off the pad':>10} {'size':>8}  outcome", err=True
        )
    for folder in flights:
        try:
            summary = summary_of(folder)
        except (OSError, ValueError, KeyError) as error:
            typer.echo(f"{folder.name:<18} cannot be read: {error}")
            continue
        total += summary.size_bytes
        date = "no date (clock)"
        if summary.start_unix_s is not None:
            date = f"{datetime.fromtimestamp(summary.start_unix_s, UTC):%Y-%m-%d %H:%M}"
        about = "~" if summary.estimated else ""
        error_text = "-" if summary.lateral_m is None else f"{about}{100.0 * summary.lateral_m:.1f} cm"
        cut = ", log cut short" if summary.cut else ""
        typer.echo(
            f"{folder.name:<18} {date:<16} {summary.seconds:5.0f} s {error_text:>10} "
            f"{summary.size_bytes / MEGABYTE:6.0f} MB  {summary.outcome}{cut}"
        )
    count = "1 flight" if len(flights) == 1 else f"{len(flights)} flights"
    typer.echo(f"{count} in {root}, {total / MEGABYTE:.0f} MB; times in UTC; ~: by the pad filter's estimate")


def export(folder: Path, output: Path | None) -> None:
    """Put a flight's folder into one zip file."""
    target = _new(output or Path(f"{folder.resolve().name}.zip"))
    try:
        with replaced(target) as part, part.open("wb") as archive:
            archive.writelines(pack(folder, zipfile.ZIP_DEFLATED))
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    typer.echo(f"{target}: {target.stat().st_size / MEGABYTE:.1f} MB, all of {folder}")


def convert_log(source: Path, output: Path | None, form: TableFormat) -> None:
    """Write a log's tables into a new folder."""
    folder = _new(output or source.with_name("tables"))
    written = convert(source, folder, form)
    typer.echo(f"{folder}: {len(written)} tables, {sum(written.values())} rows of {source}")


def repair(source: Path, output: Path | None) -> None:
    """Write what can be read of a log into a new one, with an index; the log is left as it is."""
    target = _new(output or source.with_name(REPAIRED_NAME))
    try:
        with replaced(target) as part:
            with source.open("rb") as stream, part.open("wb") as new:
                times_ns, cut = _copy(stream, new)
                new.flush()
                os.fsync(new.fileno())
            if not times_ns:
                raise ConfigError(f"{source}: holds no message that can be read; expected an MCAP log")
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}") from error
    seconds, was = 1e-9 * (max(times_ns) - min(times_ns)), "cut short" if cut else "whole"
    typer.echo(f"{target}: {len(times_ns)} messages over {seconds:.1f} s; {source} was {was}")


def _copy(stream: IO[bytes], new: IO[bytes]) -> tuple[list[int], bool]:
    """Copy all whole records; returns the times of the messages (ns), and whether the source is cut short."""
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
    return times_ns, bool(cut)


def _new(target: Path) -> Path:
    if target.is_file() or target.is_dir():
        raise ConfigError(f"{target}: exists already; expected a new one, by --output")
    return target
