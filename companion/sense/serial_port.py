"""A serial port as a byte port on the event loop: tty on the vehicle, pty of a simulator.

pyserial sets the line up (raw, 8N1, baud); reading and writing go through the loop, without a thread.
"""

import asyncio
import errno
import os
import termios
from typing import Final

import serial

from companion.base.errors import ABSENT, ConfigError, DeviceMissing
from companion.base.files import TAKEN

_CHUNK_BYTES: Final = 4096
_BACKLOG_BYTES: Final = 65536


class SerialPort:
    """A BytePort on a tty. Make it inside the running loop; one reader at a time.

    Raises:
        ConfigError: the port cannot be opened, is no serial port, or another program of ours has it.
    """

    def __init__(self, path: str, baud: int) -> None:
        self._path = path
        try:
            # two readers would each have a part of what comes
            self._serial = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            reason = TAKEN if number == errno.EAGAIN else reason
            kind = DeviceMissing if number in ABSENT else ConfigError
            raise kind(f"serial port {path}: cannot be opened at {baud} baud: {reason}") from error
        self._fd = self._serial.fileno()
        os.set_blocking(self._fd, False)
        self._loop = asyncio.get_running_loop()
        self._received = bytearray()
        self._outgoing = bytearray()
        self._arrived = asyncio.Event()
        self._gone: OSError | None = None
        self._loop.add_reader(self._fd, self._on_readable)

    async def read(self) -> bytes:
        """Wait for at least one byte and return all there are.

        Raises:
            OSError: the port is gone, or was closed. Bytes that came before are returned first.
        """
        await self._arrived.wait()
        if not self._received and self._gone is not None:
            raise self._gone
        data = bytes(self._received)
        self._received.clear()
        if self._gone is None:
            self._arrived.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send as fast as the line takes it, without waiting.

        Raises:
            OSError: the port is gone.
        """
        if self._gone is not None:
            raise self._gone
        if len(self._outgoing) + len(data) > _BACKLOG_BYTES:
            raise OSError(errno.ENOBUFS, f"serial port {self._path}: the line does not keep up")
        idle = not self._outgoing
        self._outgoing += data
        if idle:
            self._on_writable()
            if self._gone is not None:
                raise self._gone

    def set_baud(self, baud: int) -> None:
        """Change the rate, at once: what was written before should have left (`baud` / 10 bytes a second).

        Raises:
            OSError: the port is gone, or cannot go at that rate.
        """
        if self._gone is not None:
            raise self._gone
        if baud == self._serial.baudrate:
            return
        try:
            self._serial.baudrate = baud
        except (ValueError, termios.error) as error:
            raise OSError(errno.EINVAL, f"serial port {self._path}: no {baud} baud") from error

    def close(self) -> None:
        """Close the port; a waiting `read` ends with OSError."""
        self._lose(OSError(errno.EBADF, f"serial port {self._path}: closed"))

    def _on_readable(self) -> None:
        try:
            data = os.read(self._fd, _CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(OSError(error.errno, f"serial port {self._path}: {error.strerror}"))
            return
        if not data:
            self._lose(OSError(errno.EIO, f"serial port {self._path}: unplugged"))
            return
        if len(self._received) < _BACKLOG_BYTES:
            self._received += data
        self._arrived.set()

    def _on_writable(self) -> None:
        try:
            sent = os.write(self._fd, self._outgoing)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._lose(OSError(error.errno, f"serial port {self._path}: {error.strerror}"))
            return
        del self._outgoing[:sent]
        if self._outgoing:
            self._loop.add_writer(self._fd, self._on_writable)
        else:
            self._loop.remove_writer(self._fd)

    def _lose(self, error: OSError) -> None:
        if self._gone is not None:
            return
        self._gone = error
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        self._serial.close()
        self._arrived.set()
