"""Serial lines between a simulated device and the app, paced at the baud rate.

`MemoryPort` joins both in one process, in virtual or real time; `PtyPort` is a pseudo terminal for an app
in another process. The device's side is the same: `send` and `receive`, without waiting. Bytes arrive in
pieces, as out of a UART's own buffer, and each piece when its last bit would have come.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import tty
from collections.abc import Callable
from typing import Final, Protocol

_BITS_PER_BYTE: Final = 10
_PIECE_BYTES: Final = 64
_BACKLOG_S: Final = 1.0


class DevicePort(Protocol):
    """The device's side of a serial line."""

    def send(self, data: bytes) -> None:
        """Put bytes on the line."""
        ...

    def receive(self) -> bytes:
        """What has come from the app since the last call."""
        ...

    def close(self) -> None:
        """Unplug the line."""
        ...


class PacedLine:
    """One direction: hands bytes on as fast as the line carries them; what waits over a second is dropped."""

    def __init__(self, baud: int, deliver: Callable[[bytes], None]) -> None:
        self._byte_s = _BITS_PER_BYTE / baud
        self._deliver = deliver
        self._loop = asyncio.get_running_loop()
        self._free_s = 0.0

    def send(self, data: bytes) -> None:
        """Put bytes on the line after those that are still waiting."""
        now_s = self._loop.time()
        if self._free_s - now_s > _BACKLOG_S:
            return
        self._free_s = max(self._free_s, now_s)
        for start in range(0, len(data), _PIECE_BYTES):
            piece = data[start : start + _PIECE_BYTES]
            self._free_s += len(piece) * self._byte_s
            self._loop.call_at(self._free_s, self._deliver, piece)


class AppEnd:
    """The app's end of a MemoryPort: a BytePort."""

    def __init__(self, baud: int, deliver: Callable[[bytes], None]) -> None:
        self._line = PacedLine(baud, deliver)
        self._received = bytearray()
        self._arrived = asyncio.Event()
        self._closed = False

    async def read(self) -> bytes:
        """Wait for at least one byte and return all there are. OSError when unplugged or closed."""
        await self._arrived.wait()
        if not self._received:
            raise _unplugged()
        data = bytes(self._received)
        self._received.clear()
        if not self._closed:
            self._arrived.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send to the device. OSError when unplugged or closed."""
        if self._closed:
            raise _unplugged()
        self._line.send(data)

    def close(self) -> None:
        """Close; a waiting `read` ends with OSError."""
        self._closed = True
        self._arrived.set()

    def deliver(self, data: bytes) -> None:
        """Bytes come off the line."""
        if not self._closed:
            self._received += data
            self._arrived.set()


class MemoryPort:
    """A serial line within one process. Make it inside the running loop."""

    def __init__(self, baud: int) -> None:
        self._from_app = bytearray()
        self.app = AppEnd(baud, self._from_app.extend)
        self._line = PacedLine(baud, self.app.deliver)

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the app."""
        if data:
            self._line.send(data)

    def receive(self) -> bytes:
        """What has come from the app since the last call."""
        data = bytes(self._from_app)
        self._from_app.clear()
        return data

    def close(self) -> None:
        """Unplug the line: the app's end gets OSError."""
        self.app.close()


class PtyPort:
    """A serial line as a pseudo terminal; the app opens `path`. Make it inside the running loop."""

    def __init__(self, baud: int) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        # our own handle on the slave stays open: without it reading fails while the app has not opened it
        self.path = os.ttyname(self._slave)
        self._loop = asyncio.get_running_loop()
        self._from_app = bytearray()
        self._line = PacedLine(baud, self._deliver)
        self._open = True
        self._loop.add_reader(self._master, self._on_readable)

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the app."""
        if data and self._open:
            self._line.send(data)

    def receive(self) -> bytes:
        """What has come from the app since the last call."""
        data = bytes(self._from_app)
        self._from_app.clear()
        return data

    def close(self) -> None:
        """Unplug the line: the app's end gets OSError."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)

    def _deliver(self, piece: bytes) -> None:
        if not self._open:
            return
        # when nobody reads, a UART would lose them too
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, piece)

    def _on_readable(self) -> None:
        try:
            self._from_app += os.read(self._master, 4096)
        except BlockingIOError:
            return
        except OSError:
            self.close()


def _unplugged() -> OSError:
    return OSError(errno.EIO, "serial line unplugged")
