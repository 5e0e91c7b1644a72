"""The rows of a bench that goes on where it was interrupted, a line of JSON each: what is there is not flown
again."""

import hashlib
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from companion.config import CONFIG_FOLDER
from sitl.campaign.manifest import code_digest

_KEY_LENGTH: Final = 12


def flights_key(bench: Path, code: str | None = None, configs: Path = CONFIG_FOLDER) -> str:
    """Digest of all that decides a row: the program, the settings and scenarios, the bench's own folder."""
    total = hashlib.sha256((code or code_digest()).encode())
    for folder, pattern in ((bench, "*.py"), (configs, "*")):
        for path in sorted(path for path in folder.rglob(pattern) if path.is_file()):
            for part in (str(path.relative_to(folder)).encode(), path.read_bytes()):
                total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:_KEY_LENGTH]


class KeptRow(Protocol):
    """A dataclass that knows which state of the code it is of."""

    @property
    def code(self) -> str:
        """`flights_key` when it was flown."""


Row = TypeVar("Row", bound=KeptRow)


class RowsFile(Generic[Row]):
    """The file; a line that an interruption has cut short counts as not flown."""

    def __init__(self, path: Path, kind: type[Row]) -> None:
        self._path, self._rows = path, TypeAdapter(kind)

    def read(self, code: str) -> list[Row]:
        """The rows of this state of the code."""
        data = self._path.read_bytes() if self._path.exists() else b""
        return [row for row in map(self._row, data.split(b"\n")) if row is not None and row.code == code]

    def append(self, row: Row) -> None:
        """Add one, at once."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        cut = self._path.exists() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("ab") as file:
            file.write(b"\n" * cut + self._rows.dump_json(row) + b"\n")

    def _row(self, line: bytes) -> Row | None:
        try:
            return self._rows.validate_json(line)
        except ValidationError:
            return None
