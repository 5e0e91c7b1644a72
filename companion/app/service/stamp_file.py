"""The last time stamp of the link's signatures, on disk: what was accepted before a restart is not again.

A frame that was recorded and is sent again would be as good as new to a process that has just started: for a
minute, and on a computer whose clock is behind for as long as that is. The file is written at each order and
each new stream of the link, once a minute, and at the end.
"""

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.base.errors import ConfigError
from companion.base.files import cannot_read, write_durably
from companion.link.signing import NEW_STREAM_MAY_LAG_S, LinkSigning

FILE_NAME: Final = "signing.json"


@dataclass(frozen=True, slots=True)
class StampFile:
    """The file in a folder, which is made."""

    folder: Path

    @property
    def path(self) -> Path:
        return self.folder / FILE_NAME

    def read(self) -> int:
        """The last stamp; 0: there is none.

        Raises:
            ConfigError: there is a file, and it cannot be read or says something else.
        """
        try:
            stamp = json.loads(self.path.read_text(encoding="utf-8"))["stamp"]
        except FileNotFoundError:
            return 0
        except OSError as error:
            raise cannot_read(self.path, error) from error
        except (ValueError, KeyError, TypeError):
            stamp = None
        if not isinstance(stamp, int) or stamp < 0:
            raise ConfigError(
                f"{self.path}: unreadable; expected the link's last signing stamp. Where the clock is right, "
                "the file may be deleted"
            )
        return stamp

    def write(self, stamp: int) -> None:
        """Keep a stamp.

        Raises:
            ConfigError: it cannot be written.
        """
        write_durably(self.path, json.dumps({"stamp": stamp}))


class StampKeeper:
    """Writes the link's newest stamp into its file while the app runs; without either it does nothing."""

    def __init__(
        self, file: StampFile | None, signing: LinkSigning | None, warn: Callable[[str], None]
    ) -> None:
        self._file, self._signing, self._warn = file, signing, warn
        self._streams = 0
        self._wanted = asyncio.Event()

    def note(self, *, ordered: bool) -> None:
        """Bytes were received: keep the stamp soon where they held an order, or began a stream."""
        if self._signing is None:
            return
        if ordered or self._signing.streams != self._streams:
            self._streams = self._signing.streams
            self._wanted.set()

    async def run(self) -> None:
        """Keep it from time to time, and at the end. On a disk that is full it goes on with a warning."""
        if self._file is None or self._signing is None:
            return
        try:
            while True:
                self._tell(await asyncio.to_thread(self._kept))
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._wanted.wait(), NEW_STREAM_MAY_LAG_S)
                self._wanted.clear()
        finally:
            self._tell(self._kept())

    def _kept(self) -> str:
        """Why it could not be kept; "" when it was."""
        assert self._file is not None
        assert self._signing is not None
        try:
            self._file.write(self._signing.stamp)
        except ConfigError as error:
            return str(error)
        return ""

    def _tell(self, problem: str) -> None:
        if problem:
            self._warn(f"{problem}; recorded orders could be sent again after a restart")
