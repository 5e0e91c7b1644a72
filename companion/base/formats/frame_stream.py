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
_BUFFER_BYTES: Final = 2**20


class FrameStream:
    """An open connection. Made by `open`."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str) -> None:
        self.address = address
        self._reader, self._writer = reader, writer

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
        if form["path"] is not None:
            opening = asyncio.open_unix_connection(form["path"], limit=_BUFFER_BYTES)
        else:
            opening = asyncio.open_connection(form["host"], int(form["port"]), limit=_BUFFER_BYTES)
        try:
            reader, writer = await asyncio.wait_for(opening, CONNECT_TIMEOUT_S)
        except OSError as error:  # TimeoutError is one
            known = error.errno is not None and error.errno > 0
            reason = os.strerror(error.errno or 0) if known else f"{error}" or "no answer"
            raise OSError(f"{address}: {reason}; expected a program that serves frames") from error
        return cls(reader, writer, address)

    async def read_header(self) -> FrameHeader:
        """The next frame's header; to be followed by `read_image`.

        Raises:
            OSError: the connection was closed, or what came is not a frame.
        """
        try:
            return unpack_header(await self._read(HEADER_SIZE, "a frame's header"))
        except ValueError as error:
            raise OSError(f"{self.address} does not send frames: {error}") from error

    async def read_image(self, header: FrameHeader) -> NDArray[np.uint8]:
        """The image of the header just read, read-only: (height, width) or (height, width, 3).

        Raises:
            OSError: the connection was closed before all of it had come.
        """
        return unpack_image(header, await self._read(header.size, "an image"))

    def close(self) -> None:
        self._writer.close()

    async def _read(self, size: int, what: str) -> bytes:
        try:
            return await self._reader.readexactly(size)
        except asyncio.IncompleteReadError as error:
            found = len(error.partial)
            rest = f" after {found} of {size} bytes of {what}" if found else ""
            raise OSError(f"{self.address} was closed by its server{rest}") from error
        except OSError as error:
            raise OSError(f"{self.address}: {error.strerror or error}") from error
