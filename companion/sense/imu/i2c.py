"""The register bus that the drivers speak through: the kernel's I2C or SPI (`spi`), or a simulator's socket.

A bus is synchronous: a transaction of a few bytes takes 0.1 to 1 ms at 400 kHz. Where that is too long
for the event loop, the app runs a driver's whole poll off it (`Clock.run`).
"""

import errno
import os
import re
import socket
from pathlib import Path
from typing import Final, Protocol

import smbus2

from companion.base.errors import ConfigError, DeviceMissing
from companion.base.files import take_alone
from companion.base.formats.bus_format import (
    REPLY_HEADER_BYTES,
    BusFormatError,
    ReadRequest,
    WriteRequest,
    decode_reply_header,
    encode_request,
)
from companion.sense.imu.spi import SpiBus

SMBUS_BLOCK_BYTES: Final = 32
SOCKET_TIMEOUT_S: Final = 0.5


class SensorError(Exception):
    """A sensor misbehaves; the text is the one line to show. The driver recovers by itself."""


class RegisterBus(Protocol):
    """Devices with 8-bit registers at 7-bit addresses. OSError on a bus fault."""

    def read(self, address: int, register: int, length: int) -> bytes:
        """Read `length` bytes starting at `register`."""
        ...

    def write(self, address: int, register: int, value: int) -> None:
        """Write one byte."""
        ...


class SmbusBus:
    """A Linux I2C adapter (/dev/i2c-N).

    Plain I2C adapters (the Raspberry Pi's) read any length in one transaction; those that speak SMBus
    alone read 32 bytes at most, and more than that is an OSError rather than a silent second transaction
    that would land elsewhere on a FIFO.

    Raises:
        OSError: there is no such adapter, or another program of ours has it.
    """

    def __init__(self, number: int) -> None:
        self._bus = smbus2.SMBus(number)
        assert self._bus.fd is not None
        try:
            take_alone(self._bus.fd)
        except OSError:
            self._bus.close()
            raise
        self._plain_i2c = bool(self._bus.funcs & smbus2.I2cFunc.I2C)

    def read(self, address: int, register: int, length: int) -> bytes:
        if self._plain_i2c:
            ask = smbus2.i2c_msg.write(address, [register])
            answer = smbus2.i2c_msg.read(address, length)
            self._bus.i2c_rdwr(ask, answer)
            return bytes(answer)
        if length > SMBUS_BLOCK_BYTES:
            raise OSError(errno.EOPNOTSUPP, f"this adapter reads at most {SMBUS_BLOCK_BYTES} bytes at once")
        return bytes(self._bus.read_i2c_block_data(address, register, length))

    def write(self, address: int, register: int, value: int) -> None:
        self._bus.write_byte_data(address, register, value)

    def close(self) -> None:
        self._bus.close()


class SocketBus:
    """A client of `companion.base.formats.bus_format` on a stream socket; reconnects."""

    def __init__(self, path: str | Path) -> None:
        self._path = str(path)
        self._socket: socket.socket | None = None

    def read(self, address: int, register: int, length: int) -> bytes:
        data = self._transact(encode_request(ReadRequest(address, register, length)))
        if len(data) != length:
            raise OSError(errno.EPROTO, f"bus at {self._path}: {len(data)} bytes for {length}")
        return data

    def write(self, address: int, register: int, value: int) -> None:
        self._transact(encode_request(WriteRequest(address, register, value)))

    def close(self) -> None:
        """Close the connection; the next transaction opens a new one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _transact(self, request: bytes) -> bytes:
        try:
            self._connected().sendall(request)
            status, length = decode_reply_header(self._receive(REPLY_HEADER_BYTES))
            data = self._receive(length)
        except (OSError, BusFormatError) as error:
            # after half a reply the stream is out of step: only a new one is in step again
            self.close()
            reason = getattr(error, "strerror", None) or error
            raise OSError(errno.EIO, f"bus at {self._path}: {reason}") from error
        if status:
            raise OSError(status, os.strerror(status))
        return data

    def _connected(self) -> socket.socket:
        if self._socket is None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self._socket.settimeout(SOCKET_TIMEOUT_S)
            self._socket.connect(self._path)
        return self._socket

    def _receive(self, length: int) -> bytes:
        data = b""
        while len(data) < length:
            piece = self._connected().recv(length - len(data))
            if not piece:
                raise OSError(errno.ECONNRESET, "the peer closed the connection")
            data += piece
        return data


def open_bus(spec: str) -> SmbusBus | SpiBus | SocketBus:
    """Open the bus that a setting names: "i2c:1", "spi:0.0", "socket:/run/imu.sock", "spi-socket:PATH".

    Raises:
        ConfigError: none of these forms, or the adapter cannot be opened.
    """
    kind, _, rest = spec.partition(":")
    if kind in ("socket", "spi-socket") and rest:
        return SocketBus(rest)
    if kind == "spi" and (numbers := re.fullmatch(r"(\d+)\.(\d+)", rest, re.ASCII)):
        return SpiBus(int(numbers[1]), int(numbers[2]))
    if kind != "i2c" or not (rest.isascii() and rest.isdigit()):
        raise ConfigError(f"bus '{spec}': expected i2c:NUMBER, spi:BUS.SELECT or socket:PATH")
    try:
        return SmbusBus(int(rest))
    except OSError as error:
        reason = error.strerror or str(error)
        raise DeviceMissing(f"bus '{spec}': /dev/i2c-{rest} cannot be opened: {reason}") from error
