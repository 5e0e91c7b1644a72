"""The flight log: every message that crossed a border, as MCAP for people and as lists for the score.

`FlightLog` keeps the topics that scoring needs in memory; with a folder it also streams every message to
`flight.mcap` (JSON with a JSON schema for each topic, and beside ours the messages that Foxglove knows by
itself) and the MAVLink traffic to `flight.tlog` (the format of MAVProxy and pymavlink: 8 bytes of
microseconds since 1970, then the packet).
A log cut short by a crash or a flat battery still reads up to its last finished chunk: in flight one is
finished, and written through to the card, every half second.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import struct
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any, Final, Literal, NamedTuple

from mcap.writer import CompressionType, Writer
from pydantic import BaseModel
from pydantic_core import to_json

from companion.base.message_json import encode, schema_of
from companion.base.messages import Frame
from companion.config import ConfigError
from companion.flightlog.disk import DiskWriter
from companion.flightlog.foxglove.parts import WellKnown
from companion.flightlog.foxglove.schemas import SCHEMAS
from companion.flightlog.foxglove.translator import Translator
from companion.flightlog.log_file import (
    LOG_NAMES,
    LOSSES_RECORD,
    SETTINGS_NAME,
    SETTINGS_RECORD,
    VERSIONS_RECORD,
)
from companion.flightlog.version import SettingsRecord
from companion.link.codec import MARKER, frame_length


def split_packets(data: bytes) -> tuple[list[bytes], bytes]:
    """Cut a run of MAVLink bytes into whole packets and the unfinished rest; garbage is passed over."""
    packets: list[bytes] = []
    at = 0
    while (marker := MARKER.search(data, at)) is not None:
        at = marker.start()
        if at + 3 > len(data) or (end := at + frame_length(data, at)) > len(data):
            return packets, data[at:]
        packets.append(data[at:end])
        at = end
    return packets, b""


# What the score and the plots read again; the rest (IMU samples, frames) would only fill the memory.
KEPT_TOPICS: Final = frozenset(
    {"vehicle", "pad", "sighting", "frame_report", "setpoint", "plan", "notice", "control_report", "truth"}
    | {"action_result"}
)
# What is lost last when the disk does not keep up: it explains the flight.
EXPLAINING: Final = frozenset(
    {"notice", "plan", "action", "action_result", "vehicle", "pad", "control_report"}
)
FRAME_PERIOD_S: Final = 0.2  # of the camera's frames on disk
# a process that is killed, or a Raspberry Pi without power, loses no more than this
FLUSHED_S: Final = 0.5
# a flush ends a chunk before that; each leaves an index in memory until the log ends
MCAP_CHUNK_BYTES: Final = 1024 * 1024


class BufferedCall(NamedTuple):
    """A call to a log that is made later: the name of its method, and what with."""

    time_s: float
    method: Literal["write", "write_frame", "write_mavlink"]
    arguments: tuple[Any, ...]


class Tap:
    """Who hears of all that is logged, on the control loop: whatever it does delays control. Here: nobody."""

    def know(self, settings: Mapping[str, BaseModel]) -> None:
        """The settings that the app flies with."""

    def note(self, topic: str, message: Any, time_s: float) -> None:
        """A message was logged."""

    def frame(self, frame: Frame) -> None:
        """A camera frame, before vision looks at it."""


class FlightLog:
    """Takes every message with the time it was written; hands back the kept ones by topic."""

    def __init__(
        self,
        folder: Path | None,
        start_unix_s: float,
        *,
        virtual: bool = False,
        keeps: bool = True,
    ) -> None:
        """Open the log.

        Args:
            folder: where to leave flight.mcap and flight.tlog; None keeps nothing on disk.
            start_unix_s: seconds since 1970 at loop time 0.
            virtual: in virtual time; the flight waits for the disk, and nothing is written through.
            keeps: whether `kept` collects what the score reads.

        Raises:
            ConfigError: the folder cannot be made or written.
        """
        self.kept: defaultdict[str, list[Any]] = defaultdict(list)
        self._keeps = keeps
        self._next_frame_s = float("-inf")
        self.folder = folder
        self._made_folder = folder is not None and not folder.exists()
        self._files: _Files | None = None
        self._disk: DiskWriter | None = None
        self.tap = Tap()
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                flushed_s = math.inf if virtual else FLUSHED_S
                mcap = _McapFile(folder / LOG_NAMES[0], flushed_s)
                tlog = _TlogFile(folder / LOG_NAMES[1], flushed_s)
            except OSError as error:
                raise ConfigError(
                    f"--record {folder}: cannot be written: {error.strerror}; expected a folder"
                ) from error
            self._disk = DiskWriter(waits=virtual)
            self._files = _Files(self._disk, mcap, tlog, folder, start_unix_s)

    @property
    def flight_folder(self) -> Path | None:
        """Where the flight under way is recorded."""
        return self.folder

    @property
    def problem(self) -> str | None:
        """What has stopped the log on disk, or made it lose messages; None when it is whole."""
        return None if self._disk is None else self._disk.problem

    def write(self, topic: str, message: Any, time_s: float) -> None:
        """Log one message (a dataclass of companion.base.messages) under a topic."""
        self.tap.note(topic, message, time_s)
        if self._keeps and topic in KEPT_TOPICS:
            self.kept[topic].append(message)
        if (files := self._files) is not None:
            files.disk.put(files.write, topic, message, time_s, bulky=topic not in EXPLAINING)

    def write_settings(self, **settings: BaseModel) -> None:
        """Log the settings that the app flies with, and our versions: with them a flight can be replayed.

        They also stand in a file of their own, `settings.yaml`.
        """
        self.tap.know(settings)
        self._put_settings(lambda: SettingsRecord.of(settings))

    def _put_settings(self, record: Callable[[], SettingsRecord]) -> None:
        if (files := self._files) is not None:
            files.disk.put(files.write_settings, record)

    def write_frame(self, frame: Frame, time_s: float) -> None:
        """Log a camera frame as a compressed image, at the log's own rate."""
        self.tap.frame(frame)
        if (files := self._files) is None or time_s < self._next_frame_s:
            return
        self._next_frame_s = time_s + FRAME_PERIOD_S
        files.disk.put(files.write_frame, frame, time_s, bulky=True, size_bytes=frame.image.nbytes)

    def write_mavlink(self, data: bytes, time_s: float, direction: Literal["in", "out"]) -> None:
        """Log MAVLink bytes as they came or went; a packet cut by a read is joined with its rest."""
        if (files := self._files) is not None:
            files.disk.put(files.write_mavlink, data, time_s, direction, bulky=True)

    def write_before(
        self, record: Callable[[], SettingsRecord], calls: deque[BufferedCall], lost: int
    ) -> None:
        """Log what happened before the log began, under its settings; `calls` is emptied, `lost` are missing.

        The log's thread does all of it, resting between slices, and writes it through to the card once: by
        its messages' times a minute would be due a hundred times, while the flight waits to be logged.
        """
        self._put_settings(record)
        if (files := self._files) is not None:
            files.disk.lost += lost
            files.disk.put(files.write_all, calls)

    def close(self, *, wait: bool = True) -> None:
        """Finish the files, without waiting for the disk if so wished; the log takes nothing after that."""
        if (files := self._files) is not None:
            self._files = None
            files.disk.finish(files.write_losses, files.mcap.close, files.tlog.close, wait=wait)

    def join(self, *, hurries: bool = False) -> None:
        """Wait until a log that was closed without waiting is written; see `DiskWriter.join`."""
        if self._disk is not None:
            self._disk.join(hurries=hurries)

    def discard(self) -> None:
        """Close the log and remove its files: nothing was flown, and the folder is free for the next try."""
        self.close()
        if self.folder is not None:
            for name in (*LOG_NAMES, SETTINGS_NAME):
                (self.folder / name).unlink(missing_ok=True)
            if self._made_folder:
                self.folder.rmdir()


class _FlushDue:
    """Whether so long has passed, by the messages' own times, since it last was due."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._last_s = -math.inf
        self.paused = False

    def at(self, time_s: float) -> bool:
        if self.paused or not time_s - self._last_s >= self._every_s:
            return False
        self._last_s = time_s
        return True


class _McapFile:
    """One MCAP file, a channel for each topic: our messages and Foxglove's well-known ones."""

    def __init__(self, path: Path, flushed_s: float) -> None:
        self._stream = path.open("xb")
        self.flush_due = _FlushDue(flushed_s)
        self._writer = Writer(self._stream, chunk_size=MCAP_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="companion")
        self._channels: dict[str, int] = {}
        self._translator = Translator()

    def know(self, settings: Mapping[str, BaseModel]) -> None:
        """What the flight is flown with, for the messages that need it."""
        self._translator.know(settings)

    def write(self, topic: str, message: Any, unix_ns: int) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._register(topic, type(message).__name__, schema_of(type(message)))
        self._writer.add_message(channel, log_time=unix_ns, publish_time=unix_ns, data=encode(message))
        for known in self._translator.message(message, unix_ns):
            self._write_known(known, unix_ns, unix_ns)
        if self.flush_due.at(1e-9 * unix_ns):
            self.flush()

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._stream.fileno())

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, dict(values))

    def write_image(self, frame: Frame, exposure_unix_ns: int, unix_ns: int) -> None:
        for known in self._translator.frame(frame, exposure_unix_ns):
            self._write_known(known, exposure_unix_ns, unix_ns)

    def close(self) -> None:
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _write_known(self, known: WellKnown, publish_unix_ns: int, unix_ns: int) -> None:
        channel = self._channels.get(known.topic)
        if channel is None:
            channel = self._register(known.topic, known.schema, SCHEMAS[known.schema])
        data = to_json(known.message)
        self._writer.add_message(channel, log_time=unix_ns, publish_time=publish_unix_ns, data=data)

    def _register(self, topic: str, name: str, schema: dict[str, Any]) -> int:
        schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        self._channels[topic] = self._writer.register_channel(f"/{topic}", "json", schema_id)
        return self._channels[topic]


class _TlogFile:
    """One .tlog file; each direction is cut into packets by itself."""

    def __init__(self, path: Path, flushed_s: float) -> None:
        self._stream: IO[bytes] = path.open("xb")
        self.flush_due = _FlushDue(flushed_s)
        self._rest = {"in": b"", "out": b""}

    def write(self, data: bytes, unix_us: int, direction: str) -> None:
        stamp = struct.pack(">Q", unix_us)
        packets, self._rest[direction] = split_packets(self._rest[direction] + data)
        for packet in packets:
            self._stream.write(stamp + packet)
        if self.flush_due.at(1e-6 * unix_us):
            self.flush()

    def flush(self) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        self._stream.close()


@dataclasses.dataclass(frozen=True, slots=True)
class _Files:
    """What is open, and the thread that writes to it."""

    disk: DiskWriter
    mcap: _McapFile
    tlog: _TlogFile
    folder: Path
    start_unix_s: float

    def write(self, topic: str, message: Any, time_s: float) -> None:
        self.mcap.write(topic, message, self._unix_ns(time_s))

    def write_frame(self, frame: Frame, time_s: float) -> None:
        self.mcap.write_image(frame, self._unix_ns(frame.time_s), self._unix_ns(time_s))

    def write_mavlink(self, data: bytes, time_s: float, direction: Literal["in", "out"]) -> None:
        self.tlog.write(data, self._unix_ns(time_s) // 1000, direction)

    def write_all(self, calls: deque[BufferedCall]) -> None:
        """Empty `calls`; nothing is written through to the card meanwhile, and all of it at the end."""
        self.mcap.flush_due.paused = self.tlog.flush_due.paused = True
        while calls:
            _, method, arguments = calls.popleft()
            getattr(self, method)(*arguments)
            self.disk.rest()
        self.mcap.flush()
        self.tlog.flush()
        self.mcap.flush_due.paused = self.tlog.flush_due.paused = False

    def _unix_ns(self, time_s: float) -> int:
        return int((self.start_unix_s + time_s) * 1e9)

    def write_losses(self) -> None:
        """How much is missing, if anything is."""
        if missing := self.disk.lost + self.disk.failed:
            self.mcap.write_metadata(LOSSES_RECORD, {"messages": str(missing)})

    def write_settings(self, made: Callable[[], SettingsRecord]) -> None:
        """Into the metadata, and beside the log for people."""
        record = made()
        self.mcap.know(record.settings)
        self.mcap.write_metadata(SETTINGS_RECORD, record.models)
        self.mcap.write_metadata(VERSIONS_RECORD, record.versions)
        (self.folder / SETTINGS_NAME).write_text(record.text, encoding="utf-8")
