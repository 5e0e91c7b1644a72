"""A serial port to the autopilot as a byte transport."""

import asyncio
import os
from typing import Final

import serial

from companion.base.udp_socket import Inbox

WRITE_QUEUE_BYTES: Final = 2048  # 0.36 s of a line at 57600 baud
READ_BYTES: Final = 4096


class SerialTransport:
    """A serial port, raw, 8N1, without flow control.

    Raises:
        OSError: the port is missing, busy or not a serial port (pyserial's SerialException is one).
    """

    def __init__(self, path: str, baud: int) -> None:
        self._port = serial.Serial(path, baud, timeout=0, exclusive=True)
        self._fd = self._port.fileno()
        os.set_blocking(self._fd, False)
        self._loop = asyncio.get_running_loop()
        self._inbox = Inbox()
        self._outbox = bytearray()
        self.dropped_bytes = 0
        self._loop.add_reader(self._fd, self._read_ready)

    async def read(self) -> bytes:
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """See `Transport`: whole writes are dropped while the line is stuck."""
        if not self._port.is_open:
            return
        if len(self._outbox) + len(data) > WRITE_QUEUE_BYTES:
            self.dropped_bytes += len(data)
            return
        idle = not self._outbox
        self._outbox += data
        if idle:
            self._write_ready()
            if self._outbox:
                self._loop.add_writer(self._fd, self._write_ready)

    def close(self) -> None:
        self._stop(OSError(f"{self._port.name} is closed"))

    def _read_ready(self) -> None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._stop(error)
            return
        if data:
            self._inbox.put(data)
        else:
            self._stop(OSError(f"{self._port.name} is gone"))

    def _write_ready(self) -> None:
        try:
            sent = os.write(self._fd, self._outbox)
        except BlockingIOError:
            return
        except OSError as error:
            self._stop(error)
            return
        del self._outbox[:sent]
        if not self._outbox:
            self._loop.remove_writer(self._fd)

    def _stop(self, error: OSError) -> None:
        self._inbox.fail(error)
        if self._port.is_open:
            self._loop.remove_reader(self._fd)
            self._loop.remove_writer(self._fd)
            self._outbox.clear()
            self._port.close()
