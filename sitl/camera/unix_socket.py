"""A server at the path of a unix socket that no other simulator and no other file uses.

A socket file that was left behind by a program that has died is replaced; one that answers is not.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from companion.config import ConfigError

MOST_PATH_BYTES: Final = 107  # sockaddr_un.sun_path, less the zero at its end (Linux, unix(7))

Converse = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class UnixServer:
    """A listening socket and its file. Made by `start`."""

    def __init__(self, server: asyncio.Server, path: Path) -> None:
        self._server = server
        self._path = path
        self._file = _identity(path)

    @classmethod
    async def start(cls, converse: Converse, path: Path) -> UnixServer:
        """Listen at `path`.

        Raises:
            ConfigError: the path is too long, something else is there, or it cannot be written.
        """
        if len(os.fsencode(path)) > MOST_PATH_BYTES:
            raise ConfigError(
                f"{path}: too long for a socket; expected a folder with a path of at most "
                f"{MOST_PATH_BYTES - len(path.name) - 1} bytes"
            )
        if _is_in_the_way(path):
            await _check_abandoned(path)
            _remove(path)

        async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            # the loop's end cancels a conversation, which asyncio of some 3.11 reports as an exception
            with suppress(asyncio.CancelledError):
                await converse(reader, writer)

        try:
            return cls(await asyncio.start_unix_server(talk, path), path)
        except OSError as error:
            raise ConfigError(
                f"{path}: {error.strerror}; expected a folder that can be written to"
            ) from error

    def close(self) -> None:
        """Stop listening and remove the file, if it is still ours."""
        self._server.close()
        if self._file is not None and _identity(self._path) == self._file:
            _remove(self._path)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _is_in_the_way(path: Path) -> bool:
    """Whether there is a socket file already; anything else is refused."""
    if path.exists() and not path.is_socket():
        raise ConfigError(f"{path}: is in the way of a socket; expected a folder without a file of that name")
    return path.exists()


async def _check_abandoned(path: Path) -> None:
    try:
        _, writer = await asyncio.open_unix_connection(path)
    except OSError:
        return
    writer.close()
    raise ConfigError(f"{path}: another simulator serves there; expected a folder of its own")


def _remove(path: Path) -> None:
    path.unlink(missing_ok=True)
