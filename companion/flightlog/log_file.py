"""The file of a flight, `flight.mcap`: what its parts are called, and what it holds in the order of writing.

It is read from the front without the file's index, so that a log cut short by a crash or a flat battery gives
what its whole chunks hold.
"""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Final, TypeVar

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from companion.base.errors import ConfigError
from companion.base.files import cannot_read

T = TypeVar("T")

# what a cut or damaged log raises, depending on where it is cut
DAMAGE: Final = (McapError, EOFError, ValueError, struct.error, zstandard.ZstdError)

LOG_NAMES: Final = ("flight.mcap", "flight.tlog")
REPAIRED_NAME: Final = "flight-repaired.mcap"
OF_A_FOLDER: Final = (LOG_NAMES[0], REPAIRED_NAME)  # logs whose flight's other files lie beside them
SETTINGS_NAME: Final = "settings.yaml"
# the MCAP metadata that a replay needs
SETTINGS_RECORD: Final = "settings"
VERSIONS_RECORD: Final = "versions"
LOSSES_RECORD: Final = "losses"


MAGIC: Final = b"\x89MCAP0\r\n"
EXPECTED: Final = "a flight's folder, its flight.mcap or exported zip, or another recording as .mcap"


def log_file(path: Path) -> Path:
    """The log itself, of a path that may be a flight's folder."""
    return path / LOG_NAMES[0] if path.is_dir() else path


def log_name(path: Path) -> str:
    """What to call a log: its file's name, or its folder's where all files are called alike."""
    file = log_file(path.resolve())
    return file.parent.name if file.name in OF_A_FOLDER else file.stem


def find_log(path: Path) -> Path:
    """The log itself, seen to be one by its first bytes, whatever it is called.

    Raises:
        ConfigError: it cannot be read, or is of another kind.
    """
    file = log_file(path)
    try:
        with file.open("rb") as stream:
            start = stream.read(len(MAGIC))
    except OSError as error:
        raise cannot_read(file, error, expected=EXPECTED) from error
    if start != MAGIC:
        raise ConfigError(f"{file}: no recording of flights; expected {EXPECTED}")
    return file


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
    except DAMAGE:
        pass
    end_early()


class LogReader:
    """One pass over a log from its front; once `messages` has ended, `metadata` and `cut` are complete.

    Topics go without their leading slash.
    """

    def __init__(self, path: Path) -> None:
        self.path = log_file(path)
        self.metadata: dict[str, dict[str, str]] = {}
        self._schemas: dict[str, Schema] = {}
        self.cut = False

    def messages(self) -> Iterator[tuple[str, Message]]:
        schemas, topics = dict[int, Schema](), dict[int, str]()
        try:
            with self.path.open("rb") as stream:
                for record in records(stream, self._end_early):
                    if isinstance(record, Message):
                        if (topic := topics.get(record.channel_id)) is not None:
                            yield topic, record
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        topic = topics[record.id] = record.topic.removeprefix("/")
                        if record.schema_id in schemas:
                            self._schemas[topic] = schemas[record.schema_id]
                    elif isinstance(record, Metadata):
                        self.metadata[record.name] = record.metadata
        except OSError as error:
            raise cannot_read(self.path, error, expected=EXPECTED) from error

    def decoded(self, kind: type[T], topic: str, message: Message) -> T:
        """A message of a topic as ours."""
        from companion.base.message_json import decode  # noqa: PLC0415 - NumPy; a wrong name is reported first

        content = self.content(topic, message)
        try:
            return decode(kind, content)
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigError(
                f"{self.path}: a message of /{topic} is not a {kind.__name__}: {error}; "
                "expected a log of this program's version"
            ) from error

    def content(self, topic: str, message: Message) -> Any:
        """What a message of a topic holds."""
        return self._parsed(message.data, f"a message of /{topic}")

    def schema(self, topic: str) -> dict[str, Any]:
        """The JSON schema of a topic that has come; an empty one where it has none."""
        schema = self._schemas.get(topic)
        if schema is None or schema.encoding != "jsonschema":
            return {}
        content = self._parsed(schema.data, f"the schema of /{topic}")
        return content if isinstance(content, dict) else {}

    @property
    def settings(self) -> dict[str, Any]:
        """What was flown with, by the names of its files; nothing in a log that does not say."""
        texts = self.metadata.get(SETTINGS_RECORD, {})
        return {name: self._parsed(text, f"settings: {name}") for name, text in texts.items()}

    def _parsed(self, text: str | bytes, what: str) -> Any:
        try:
            return json.loads(text)
        except ValueError as error:
            raise ConfigError(
                f"{self.path}: {what}: cannot be read: {error}; expected JSON, as this program logs it"
            ) from error

    def _end_early(self) -> None:
        self.cut = True
