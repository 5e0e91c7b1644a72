"""Serves frames to other processes on a unix socket or a TCP port (companion/base/formats/frame_format.py).

A client that has not taken its last frame yet misses this one: the camera never waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from companion.base.formats.frame_format import pack_frame
from companion.base.messages import Frame
from sitl.camera.unix_socket import UnixServer


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
        """How many are connected."""
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
        """Send a frame to every client that can take it."""
        free = [c for c in self._clients if c.transport.get_write_buffer_size() == 0]
        if not free:
            return
        data = pack_frame(frame.image, frame.sequence, frame.time_s)
        for client in free:
            client.write(data)

    async def close(self) -> None:
        """Stop listening, part from all clients and remove the socket."""
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
