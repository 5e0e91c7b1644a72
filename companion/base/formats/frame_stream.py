"""Reads frames (`companion.base.formats.frame_format`) from whoever serves them: a unix socket, or TCP.

Addresses: "socket:/run/companion/frames", "tcp:127.0.0.1:5600". What goes wrong is an OSError with one line
that says what: nobody there, closed half way, not frames.
"""

from __future__ import annotations

import asyncio
import os
import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.formats.frame_format import HEADER_SIZE, FrameHeader, unpack_header, unpack_image

ADDRESS_FORM: Final = re.compile(r"socket:(?P<path>.+)|tcp:(?P<host>[^:\s]+):(?P<port>\d{1,5})")
CONNECT_TIMEOUT_S: Final = 5.0


class FrameStream(asyncio.BufferedProtocol):
    """An open connection, made by `open`: what comes is written straight into the header or image awaited.

    A read that is cancelled leaves it in the middle of a frame: close it then.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._transport: asyncio.Transport | None = None
        self._into = memoryview(b"")  # what is still missing
        self._whole: asyncio.Future[None] | None = None
        self._closed: Exception | None = None

    @classmethod
    async def open(cls, address: str) -> FrameStream:
        """Connect to "socket:PATH" or "tcp:HOST:PORT".

        Raises:
            ValueError: an address of neither form.
            OSError: nobody serves frames there.
        """
        form = ADDRESS_FORM.fullmatch(address)
        if form is None or not 0 < int(form["port"] or 1) <= 65535:
            raise ValueError(f"'{address}'; expected socket:PATH or tcp:HOST:PORT")
        loop, stream = asyncio.get_running_loop(), cls(address)
        if form["path"] is not None:
            opening = loop.create_unix_connection(lambda: stream, form["path"])
        else:
            opening = loop.create_connection(lambda: stream, form["host"], int(form["port"]))
        try:
            await asyncio.wait_for(opening, CONNECT_TIMEOUT_S)
        except OSError as error:  # TimeoutError is one
            known = error.errno is not None and error.errno > 0
            reason = os.strerror(error.errno or 0) if known else f"{error}" or "no answer"
            raise OSError(f"{address}: {reason}; expected a program that serves frames") from error
        return stream

    async def read_header(self) -> FrameHeader:
        """The next frame's header; to be followed by `read_image`.

        Raises:
            OSError: the connection was closed, or what came is not a frame.
        """
        try:
            return unpack_header(bytes(await self._read(HEADER_SIZE, "a frame's header")))
        except ValueError as error:
            raise OSError(f"{self.address} does not send frames: {error}") from error

    async def read_image(self, header: FrameHeader) -> NDArray[np.uint8]:
        """The image of the header just read, read-only: (height, width) or (height, width, 3).

        Raises:
            OSError: the connection was closed before all of it had come.
        """
        return unpack_image(header, await self._read(header.size, "an image"))

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    async def _read(self, size: int, what: str) -> memoryview:
        """The next so many bytes, read-only; nothing is taken from the socket that nobody waits for."""
        buffer = np.empty(size, np.uint8).data
        self._into, self._whole = buffer, asyncio.get_running_loop().create_future()
        if self._closed is None and self._transport is not None:
            self._transport.resume_reading()
            await self._whole
        if self._into:
            if isinstance(self._closed, OSError):
                raise OSError(f"{self.address}: {self._closed.strerror or self._closed}") from self._closed
            found = size - len(self._into)
            rest = f" after {found} of {size} bytes of {what}" if found else ""
            raise OSError(f"{self.address} was closed by its server{rest}")
        return buffer.toreadonly()

    # ------------------------------------------------------------ asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.pause_reading()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._into

    def buffer_updated(self, nbytes: int) -> None:
        self._into = self._into[nbytes:]
        if not self._into and self._transport is not None:
            self._transport.pause_reading()
            self._wake()

    def connection_lost(self, exc: Exception | None) -> None:
        self._closed = exc or EOFError()
        self._wake()

    def _wake(self) -> None:
        if self._whole is not None and not self._whole.done():
            self._whole.set_result(None)
