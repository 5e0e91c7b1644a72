"""A server at the path of a unix socket that no other simulator and no other file uses.

A socket file that was left behind by a program that has died is replaced; one that answers is not.
"""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

from companion.base.formats.bus_format import (
    REQUEST_BYTES,
    BusFormatError,
    ReadRequest,
    decode_request,
    encode_reply,
)
from companion.base.formats.frame_format import pack_frame
from companion.base.messages import Frame
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


# ---------------------------------------------------------------- frame server
# A client that has not taken its last frame yet misses this one: the camera never waits.


class FrameServer:
    """One socket, any number of clients."""

    def __init__(self, where: Path | int) -> None:
        """Serve on a unix socket's path, or on a TCP port of the loopback (0: a free one)."""
        self._where = where
        self._on_client: Callable[[], None] = lambda: None
        self._server: asyncio.Server | UnixServer | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        self._gone: set[asyncio.Event] = set()

    @property
    def client_count(self) -> int:
        return len(self._clients)

    @property
    def address(self) -> str:
        """What a client has to open, as in `sense.vision.source`; once started."""
        if isinstance(self._where, Path):
            return f"socket:{self._where}"
        assert isinstance(self._server, asyncio.Server)
        return f"tcp:127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def start(self, on_client: Callable[[], None] = lambda: None) -> None:
        """Listen, and call `on_client` for each that comes. A socket file left behind is replaced.

        Raises:
            ConfigError: the path cannot be used.
            OSError: the port cannot be used.
        """
        self._on_client = on_client
        if isinstance(self._where, int):
            self._server = await asyncio.start_server(self._serve, "127.0.0.1", self._where)
        else:
            self._server = await UnixServer.start(self._serve, self._where)

    def deliver(self, frame: Frame) -> None:
        free = [c for c in self._clients if c.transport.get_write_buffer_size() == 0]
        if not free:
            return
        data = pack_frame(frame.image, frame.sequence, frame.time_s)
        for client in free:
            client.write(data)

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.transport.abort()
        for gone in tuple(self._gone):
            await gone.wait()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Keep a client until it disconnects; it sends nothing."""
        gone = asyncio.Event()
        self._clients.add(writer)
        self._gone.add(gone)
        self._on_client()
        try:
            while await reader.read(4096):
                pass
        except ConnectionError:
            pass  # gone is gone, however it went
        finally:
            self._clients.discard(writer)
            self._gone.discard(gone)
            gone.set()
            writer.close()


# ---------------------------------------------------------------- register server
# Serves a register bus to an app in another process (`companion.base.formats.bus_format`).


class RegisterDevice(Protocol):
    """What answers on the bus. OSError is a bus fault."""

    def read(self, address: int, register: int, length: int) -> bytes: ...

    def write(self, address: int, register: int, value: int) -> None: ...


def answer(device: RegisterDevice, request: bytes) -> bytes:
    """The reply to one request.

    Raises:
        BusFormatError: not a request.
    """
    asked = decode_request(request)
    try:
        if isinstance(asked, ReadRequest):
            return encode_reply(0, device.read(asked.address, asked.register, asked.length))
        device.write(asked.address, asked.register, asked.value)
    except OSError as error:
        return encode_reply((error.errno or errno.EIO) & 0xFF)
    return encode_reply(0)


async def serve_registers(
    device: RegisterDevice, path: Path, on_client: Callable[[], None] = lambda: None
) -> UnixServer:
    """Start serving `device` at the socket `path`, replacing a stale one; close the server to end.

    `on_client` is called for each client, at its first request.
    """

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await reader.readexactly(REQUEST_BYTES)
            on_client()
            while True:
                writer.write(answer(device, request))
                await writer.drain()
                request = await reader.readexactly(REQUEST_BYTES)
        except (asyncio.IncompleteReadError, ConnectionError, BusFormatError):
            pass  # the app disconnected, or sent an invalid request
        finally:
            writer.close()

    return await UnixServer.start(converse, path)
