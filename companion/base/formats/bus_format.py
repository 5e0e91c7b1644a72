"""Register transactions over a byte stream: how a simulator in another process serves an I2C bus.

One request, one reply, in order, over a unix stream socket; all numbers little-endian.

    request  5 bytes: operation (0x52 'R' read, 0x57 'W' write), device address, register,
                      u16 length to read (1..1024) or value to write (0..255)
    reply    3 bytes: status (0, or the errno of the bus fault), u16 length of the data that follows;
                      the data of a read, nothing for a write or a fault

Reads run on from the register as the device itself does (most step on, a FIFO's register stays).
Pure: no socket in here.
"""

import struct
from dataclasses import dataclass
from typing import Final

_REQUEST: Final = struct.Struct("<BBBH")
_REPLY_HEADER: Final = struct.Struct("<BH")
_READ: Final = 0x52
_WRITE: Final = 0x57
REQUEST_BYTES: Final = _REQUEST.size
REPLY_HEADER_BYTES: Final = _REPLY_HEADER.size
MAXIMUM_READ: Final = 1024


class BusFormatError(ValueError):
    """The stream does not hold this format: close it, there is no way to find the next message."""


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """Read `length` bytes from `register` of the device at `address`."""

    address: int
    register: int
    length: int


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """Write one byte to `register` of the device at `address`."""

    address: int
    register: int
    value: int


def encode_request(request: ReadRequest | WriteRequest) -> bytes:
    """The request's 5 bytes.

    Raises:
        BusFormatError: a number does not fit its field.
    """
    if isinstance(request, ReadRequest):
        if not 1 <= request.length <= MAXIMUM_READ:
            raise BusFormatError(f"length of a read: expected 1 to {MAXIMUM_READ}, found {request.length}")
        operation, number = _READ, request.length
    else:
        if not 0 <= request.value <= 0xFF:
            raise BusFormatError(f"value to write: expected 0 to 255, found {request.value}")
        operation, number = _WRITE, request.value
    try:
        return _REQUEST.pack(operation, request.address, request.register, number)
    except struct.error as error:
        raise BusFormatError(f"address or register is no byte: {error}") from error


def decode_request(data: bytes) -> ReadRequest | WriteRequest:
    """The request in exactly `REQUEST_BYTES` bytes.

    Raises:
        BusFormatError: wrong size, an unknown operation, or a number out of range.
    """
    if len(data) != REQUEST_BYTES:
        raise BusFormatError(f"request: expected {REQUEST_BYTES} bytes, found {len(data)}")
    operation, address, register, number = _REQUEST.unpack(data)
    if operation == _READ and 1 <= number <= MAXIMUM_READ:
        return ReadRequest(address, register, number)
    if operation == _WRITE and number <= 0xFF:
        return WriteRequest(address, register, number)
    raise BusFormatError(f"request: operation 0x{operation:02x} with number {number}")


def encode_reply(status: int, data: bytes = b"") -> bytes:
    """A reply: status 0 with the data read, or an errno (1..255) without data.

    Raises:
        BusFormatError: the status is no byte, or there is too much data.
    """
    if not 0 <= status <= 0xFF or len(data) > MAXIMUM_READ:
        raise BusFormatError(f"reply: status {status} with {len(data)} bytes")
    return _REPLY_HEADER.pack(status, len(data)) + data


def decode_reply_header(data: bytes) -> tuple[int, int]:
    """Status and length of the data that follows, from exactly `REPLY_HEADER_BYTES` bytes.

    Raises:
        BusFormatError: wrong size, or a length over `MAXIMUM_READ`.
    """
    if len(data) != REPLY_HEADER_BYTES:
        raise BusFormatError(f"reply: expected {REPLY_HEADER_BYTES} bytes, found {len(data)}")
    status, length = _REPLY_HEADER.unpack(data)
    if length > MAXIMUM_READ:
        raise BusFormatError(f"reply: length {length}")
    return status, length
