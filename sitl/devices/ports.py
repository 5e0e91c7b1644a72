"""Serial lines between a simulated device and the app, paced at the baud rate.

`MemoryPort` joins both in one process, in virtual or real time; `PtyPort` is a pseudo terminal for an app
in another process. The device's side is the same: `send` and `receive`, without waiting. Bytes arrive in
pieces, as out of a UART's own buffer, and each piece when its last bit would have come. Both ends have a
baud rate of their own: where they differ, what arrives is garbage.

What a serial receiver makes of bytes that were sent at another rate: the waveform, sampled wrongly.

8N1: a start bit (low), eight data bits with the least first, a stop bit (high). The receiver waits for a
falling edge and looks at the middle of each of its own bits. A byte whose stop bit is low (a framing error)
reads as 0, as Linux's tty gives it by default (termios(3), neither IGNPAR nor PARMRK).
"""

import asyncio
import contextlib
import errno
import math
import os
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

_SPEEDS: Final = {
    getattr(termios, f"B{baud}"): baud for baud in (4800, 9600, 19200, 38400, 57600, 115200, 230400)
}
_PIECE_BYTES: Final = 64
_BACKLOG_S: Final = 1.0


class PacedLine:
    """One direction: delivers bytes at the baud rate; a backlog of over a second is dropped.

    `baud` is the sender's; `receiver_baud` returns the receiver's at arrival.
    """

    def __init__(self, baud: int, deliver: Callable[[bytes], None], receiver_baud: Callable[[], int]) -> None:
        self.baud = baud
        self._deliver = deliver
        self._receiver_baud = receiver_baud
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
            self._free_s += len(piece) * BITS_PER_BYTE / self.baud
            self._loop.call_at(self._free_s, self._arrive, piece, self.baud)

    def _arrive(self, piece: bytes, sent_baud: int) -> None:
        heard = as_received(piece, sent_baud, self._receiver_baud())
        if heard:
            self._deliver(heard)


class DevicePort(ABC):
    """The device's side of a serial line."""

    _line: PacedLine

    def __init__(self) -> None:
        self._from_app = bytearray()

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Put bytes on the line to the app."""

    def receive(self) -> bytes:
        """What has come from the app since the last call."""
        if not self._from_app:
            return b""
        data = bytes(self._from_app)
        self._from_app.clear()
        return data

    def set_baud(self, baud: int) -> None:
        """Change the device's rate; the app sets its own."""
        self._line.baud = baud

    @abstractmethod
    def close(self) -> None:
        """Unplug the line: the app's end gets OSError."""


class AppEnd:
    """The app's end of a MemoryPort: a BytePort."""

    def __init__(self, baud: int, deliver: Callable[[bytes], None], device_baud: Callable[[], int]) -> None:
        self._line = PacedLine(baud, deliver, device_baud)
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

    @property
    def baud(self) -> int:
        """The app's rate."""
        return self._line.baud

    def set_baud(self, baud: int) -> None:
        """Change the app's rate. OSError when unplugged or closed."""
        if self._closed:
            raise _unplugged()
        self._line.baud = baud

    def close(self) -> None:
        """Close; a waiting `read` ends with OSError."""
        self._closed = True
        self._arrived.set()

    def deliver(self, data: bytes) -> None:
        """Bytes come off the line."""
        if not self._closed:
            self._received += data
            self._arrived.set()


class MemoryPort(DevicePort):
    """A serial line within one process. Make it inside the running loop."""

    def __init__(self, baud: int) -> None:
        super().__init__()
        self.app = AppEnd(baud, self._from_app.extend, lambda: self._line.baud)
        self._line = PacedLine(baud, self.app.deliver, lambda: self.app.baud)

    def send(self, data: bytes) -> None:
        if data:
            self._line.send(data)

    def close(self) -> None:
        self.app.close()


class PtyPort(DevicePort):
    """A serial line as a pseudo terminal; the app opens `path`. Make it inside the running loop.

    A pseudo terminal has no baud rate, but it stores the one that the app has set.
    """

    def __init__(self, baud: int) -> None:
        super().__init__()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        settings = termios.tcgetattr(self._slave)
        settings[4] = settings[5] = getattr(termios, f"B{baud}")
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)
        os.set_blocking(self._master, False)
        # our own handle on the slave stays open: without it reading fails while the app has not opened it
        self.path = os.ttyname(self._slave)
        self._loop = asyncio.get_running_loop()
        self._line = PacedLine(baud, self._deliver, self._app_baud)
        self._open = True
        self._loop.add_reader(self._master, self._on_readable)

    def send(self, data: bytes) -> None:
        if data and self._open:
            self._line.send(data)

    def close(self) -> None:
        if self._open:
            self._open = False
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)

    def _app_baud(self) -> int:
        if not self._open:
            return self._line.baud
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5], 0) or self._line.baud

    def _deliver(self, piece: bytes) -> None:
        if not self._open:
            return
        # without a reader, a UART would lose them too
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, piece)

    def _on_readable(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        self._from_app += as_received(data, self._app_baud(), self._line.baud)


def _unplugged() -> OSError:
    return OSError(errno.EIO, "serial line unplugged")


BITS_PER_BYTE: Final = 10


def as_received(data: bytes, sent_baud: int, receiver_baud: int) -> bytes:
    """The bytes that a receiver at `receiver_baud` gets of `data` sent in one go at `sent_baud`."""
    if sent_baud == receiver_baud or not data:
        return data
    wave = _waveform(data)
    ratio = sent_baud / receiver_baud  # bits of the sender in one of the receiver's
    heard = bytearray()
    at = _falling_edge(wave, 0)
    while at is not None:
        bits = [_level(wave, at + (k + 0.5) * ratio) for k in range(BITS_PER_BYTE)]
        value = sum(bit << k for k, bit in enumerate(bits[1:9]))
        stop = bits[9]
        if bits[0]:
            at = _falling_edge(wave, math.ceil(at + 0.5 * ratio))  # a spike, no start bit
            continue
        heard.append(value if stop else 0)
        at = _falling_edge(wave, math.ceil(at + (BITS_PER_BYTE - 0.5) * ratio))
    return bytes(heard)


def _waveform(data: bytes) -> list[int]:
    wave = [1]
    for byte in data:
        wave += [0, *(byte >> k & 1 for k in range(8)), 1]
    return wave


def _level(wave: list[int], at: float) -> int:
    """The line rests high before and after."""
    index = int(at)
    return wave[index] if index < len(wave) else 1


def _falling_edge(wave: list[int], start: int) -> int | None:
    for index in range(max(1, start), len(wave)):
        if wave[index - 1] and not wave[index]:
            return index
    return None
