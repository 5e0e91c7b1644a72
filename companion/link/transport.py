"""Byte transports to the autopilot: UDP, TCP, and the choice among them and the serial port.

All queues are bounded, and what does not fit is dropped and counted: a setpoint that waited for a stuck line
is worse than none. `read` gives what came, one byte or more, and raises OSError once the transport is gone.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import math
import os
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

import serial

from companion.base.clock import Clock
from companion.base.errors import ABSENT, ConfigError, DeviceMissing
from companion.base.udp_socket import Inbox, UdpSocket
from companion.config import CONNECTION_FORM
from companion.link.codec import autopilot_heartbeats
from companion.link.signing import LinkSigning

# ---------------------------------------------------------------- a serial port

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


# ---------------------------------------------------------------- within the process


class MemoryTransport:
    """One end of a pipe within the process: bytes arrive `latency_s` of loop time later, in order."""

    def __init__(self, latency_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._latency_s = latency_s
        self._inbox = Inbox()
        self._under_way: deque[bytes] = deque()
        self._peer: MemoryTransport | None = None

    async def read(self) -> bytes:
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        peer = self._peer
        if peer is None or not data:
            return
        # the loop does not promise an order among timers due together, so each takes the oldest
        peer._under_way.append(data)
        self._loop.call_later(self._latency_s, peer._deliver)

    def close(self) -> None:
        """Both ends are closed, as when a cable is pulled."""
        for end in (self, self._peer):
            if end is not None:
                end._peer = None
                end._inbox.fail(OSError("the pipe is closed"))

    def _deliver(self) -> None:
        self._inbox.put(self._under_way.popleft())


def memory_pair(latency_s: float = 0.002) -> tuple[MemoryTransport, MemoryTransport]:
    """The two ends of an in-process pipe; call it inside the loop."""
    one, other = MemoryTransport(latency_s), MemoryTransport(latency_s)
    one._peer, other._peer = other, one
    return one, other


_PEER_SILENCE_S: Final = 3.0
_QUIET_TURNS: Final = 3
_TURNS_TO_READ: Final = 500
_log = logging.getLogger(__name__)


class Transport(Protocol):
    """A stream of bytes both ways."""

    async def read(self) -> bytes:
        """Wait for one byte or more.

        Raises:
            OSError: the transport is closed or gone.
        """

    def write(self, data: bytes) -> None:
        """Send without waiting; dropped when there is no receiver."""

    def close(self) -> None:
        """Give the port back; a waiting `read` ends with OSError."""


class UdpTransport(UdpSocket):
    """UDP: calling a fixed peer, or listening for one. Made by `open_transport`.

    A listener's peer is the first address that an autopilot's heartbeat comes from (of `system_id`; 0: of the
    first one that is received). Others are neither received nor answered, or setpoints would go to whoever
    spoke last; once the peer has been silent for 3 s, as when a router has restarted at another port, the
    next address of the same system follows.

    With `signing` that heartbeat has to be signed, and later than all that was accepted. An autopilot whose
    time stamps are old, as after a start without GPS, moves on once it hears ours: who sends a right
    heartbeat of any age is answered until a fresh one comes, from whatever address.
    """

    def __init__(self, system_id: int = 0, signing: LinkSigning | None = None) -> None:
        super().__init__()
        self._clock = Clock()
        self._system_id, self._signing = system_id, signing
        self._peer_heard_s, self._proven = -math.inf, False
        self.strangers = 0
        self._first_stranger_s = 0.0
        self._stranger_told = False

    def accepts(self, data: bytes, address: tuple[str, int]) -> bool:
        """Whether it comes from the peer, or from the next one that may be it."""
        now_s = self._clock.now_s()
        if not self._is_peer(data, address, now_s):
            self._ignore(address, now_s)
            return False
        self._peer_heard_s = now_s
        return True

    def _is_peer(self, data: bytes, address: tuple[str, int], now_s: float) -> bool:
        """Whether who sent this is the peer, or is from now on."""
        same = address == self._peer
        if self._proven and (same or now_s - self._peer_heard_s <= _PEER_SILENCE_S):
            return same
        for heartbeat in autopilot_heartbeats(data, self._system_id):
            frame = heartbeat.get_msgbuf()
            if self._signing is None or (self._signing.is_right(frame) and self._signing.is_fresh(frame)):
                # once one was found it stays that one: another vehicle's would get our setpoints
                self._proven, self._system_id = True, heartbeat.get_srcSystem()
                return True
            same = same or (not self._proven and self._signing.is_right(frame))
        return same

    def _ignore(self, address: tuple[str, int], now_s: float) -> None:
        self.strangers += 1
        if self.strangers == 1:
            self._first_stranger_s = now_s
        # the peer itself is a stranger until its first heartbeat, which comes once a second
        if not self._stranger_told and now_s - self._first_stranger_s > _PEER_SILENCE_S:
            self._stranger_told = True
            wanted = f"of system {self._system_id}" if self._system_id else "of an autopilot"
            _log.warning("link: %s:%d ignored: no heartbeat %s", *address[:2], wanted)


class TcpTransport:
    """A TCP connection that we have opened, as a simulated autopilot's serial ports are. Made by `open`."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self.dropped_bytes = 0

    @classmethod
    async def open(cls, host: str, port: int) -> TcpTransport:
        """Connect.

        Raises:
            OSError: nobody listens there, or the host is not known.
        """
        return cls(*await asyncio.open_connection(host, port))

    async def read(self) -> bytes:
        data = await self._reader.read(READ_BYTES)
        if not data:
            raise OSError("the TCP connection is closed")
        return data

    def write(self, data: bytes) -> None:
        """See `Transport`: whole writes are dropped while the other side does not take them."""
        transport = self._writer.transport
        if transport.is_closing():
            return
        if transport.get_write_buffer_size() + len(data) > WRITE_QUEUE_BYTES:
            self.dropped_bytes += len(data)
            return
        self._writer.write(data)

    def close(self) -> None:
        self._writer.transport.abort()


async def backlog_read(heard: Callable[[], int]) -> None:
    """Run the event loop until nothing more comes in; `heard` counts what has been taken from a transport.

    The loop takes in one datagram a turn, and hands it on in the next.
    """
    quiet = 0
    for _ in range(_TURNS_TO_READ):
        before = heard()
        await asyncio.sleep(0.0)
        quiet = quiet + 1 if heard() == before else 0
        if quiet == _QUIET_TURNS:
            return


async def open_transport(spec: str, system_id: int = 0, signing: LinkSigning | None = None) -> Transport:
    """Open `serial:PATH:BAUD`; `udp:HOST:PORT` or `tcp:HOST:PORT` (we call); `udpin:HOST:PORT` (we listen).

    A listener takes the autopilot of `system_id` for its peer; 0 takes the first one received. With `signing`
    it has to have the key.

    Raises:
        ConfigError: the form is none of these, or the port cannot be opened; one line that says why.
    """
    form = CONNECTION_FORM.fullmatch(spec)
    if form is None:
        raise ConfigError(
            "link.connection: expected serial:PATH:BAUD, udp:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT, "
            f"found '{spec}'"
        )
    try:
        if form["path"] is not None:
            return SerialTransport(form["path"], int(form["baud"]))
        if form["kind"] == "tcp":
            return await TcpTransport.open(form["host"], int(form["port"]))
        transport = UdpTransport(system_id, signing)
        await transport.open(form["host"], int(form["port"]), listen=form["kind"] == "udpin")
    except (OSError, ValueError, OverflowError) as error:
        kind = DeviceMissing if _may_come(error) else ConfigError
        raise kind(f"link.connection: {spec}: {_reason(error)}") from error
    return transport


def _may_come(error: Exception) -> bool:
    """Whether it may open later: a port to be plugged in, whoever is called over a network.

    A port of ours that another program has is for the user to mend.
    """
    if isinstance(error, serial.SerialException):
        return error.errno in ABSENT
    return isinstance(error, OSError) and error.errno != errno.EADDRINUSE


def _reason(error: Exception) -> str:
    """What went wrong in one short clause."""
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, serial.SerialException) and "exclusively lock" in str(error):
        return "busy; expected a port that no other program has open"
    if number is not None and number > 0:
        return os.strerror(number)
    return str(error)
