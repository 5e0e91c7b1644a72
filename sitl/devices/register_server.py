"""Serves a register bus to an app in another process (`companion.base.formats.bus_format`)."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from companion.base.formats.bus_format import (
    REQUEST_BYTES,
    BusFormatError,
    ReadRequest,
    decode_request,
    encode_reply,
)
from sitl.camera.unix_socket import UnixServer


class RegisterDevice(Protocol):
    """What answers on the bus. OSError is a bus fault."""

    def read(self, address: int, register: int, length: int) -> bytes:
        """Read registers."""
        ...

    def write(self, address: int, register: int, value: int) -> None:
        """Write one register."""
        ...


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

    Raises:
        ConfigError: the path cannot be used.
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
