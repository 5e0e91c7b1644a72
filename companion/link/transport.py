"""Byte transports to the autopilot: serial port, UDP, TCP, and an in-process pipe for virtual time.

All queues are bounded, and what does not fit is dropped and counted: a setpoint that waited for a stuck line
is worse than none. `read` gives what came, one byte or more, and raises OSError once the transport is gone.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

import serial

from companion.base.clock import Clock
from companion.config import CONNECTION_FORM, ConfigError
from companion.link.codec import has_autopilot_heartbeat

_READ_QUEUE_BYTES: Final = 1 << 16
_WRITE_QUEUE_BYTES: Final = 2048  # 0.36 s of a line at 57600 baud
_READ_BYTES: Final = 4096
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
        """Send without waiting; dropped when nobody can take it."""

    def close(self) -> None:
        """Give the port back; a waiting `read` ends with OSError."""


class _Inbox:
    """What came and was not read yet; for one reader."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._changed = asyncio.Event()
        self._error: OSError | None = None
        self.dropped_bytes = 0

    def put(self, data: bytes) -> None:
        if len(self._data) + len(data) > _READ_QUEUE_BYTES:
            self.dropped_bytes += len(self._data)
            self._data.clear()
        self._data += data
        self._changed.set()

    def fail(self, error: OSError) -> None:
        self._error = self._error or error
        self._changed.set()

    async def read(self) -> bytes:
        while not self._data:
            if self._error is not None:
                raise self._error
            await self._changed.wait()
            self._changed.clear()
        data = bytes(self._data)
        self._data.clear()
        return data


class MemoryTransport:
    """One end of a pipe within the process: bytes arrive `latency_s` of loop time later, in order."""

    def __init__(self, latency_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._latency_s = latency_s
        self._inbox = _Inbox()
        self._under_way: deque[bytes] = deque()
        self._peer: MemoryTransport | None = None

    async def read(self) -> bytes:
        """See `Transport`."""
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """See `Transport`."""
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


class UdpTransport(asyncio.DatagramProtocol):
    """UDP: calling a fixed peer, or listening for one. Made by `open_transport`.

    A listener's peer is the first address that an autopilot's heartbeat comes from (of `system_id`; 0: of
    any). Others are neither heard nor answered, or setpoints would go to whoever spoke last; once the peer
    has been silent for 3 s, as when a router has restarted at another port, the next such address follows.
    """

    def __init__(self, system_id: int = 0) -> None:
        self._clock = Clock()
        self._system_id = system_id
        self._peer_heard_s = -math.inf
        self.strangers = 0
        self._inbox = _Inbox()
        self._socket: asyncio.DatagramTransport | None = None
        self._peer: tuple[str, int] | None = None
        self._calls = False

    async def open(self, host: str, port: int, *, listen: bool) -> None:
        """Bind to (listen) or call host and port.

        Raises:
            OSError: the port is taken, or the host is not known.
        """
        self._calls = not listen
        address = (host, port)
        self._socket, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self,
            local_addr=address if listen else None,
            remote_addr=None if listen else address,
        )

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """asyncio: a datagram came."""
        now_s = self._clock.now_s()
        # a calling socket is connected: the system passes on what the peer sent and nothing else
        if not self._calls and addr != self._peer and not self._may_follow(data, now_s):
            self._ignore(addr)
            return
        self._peer, self._peer_heard_s = addr, now_s
        self._inbox.put(data)

    def error_received(self, exc: Exception) -> None:
        """asyncio: the peer is not there yet (ICMP refused); it may come, so go on."""

    def connection_lost(self, exc: Exception | None) -> None:
        """asyncio: the socket is closed."""
        self._inbox.fail(OSError(f"the UDP socket is closed{f': {exc}' if exc else ''}"))

    async def read(self) -> bytes:
        """See `Transport`."""
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """See `Transport`; a listener that has heard nobody has nobody to tell."""
        if self._socket is None or not data or self._socket.is_closing():
            return
        if self._calls:
            self._socket.sendto(data)
        elif self._peer is not None:
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """See `Transport`."""
        if self._socket is not None:
            self._socket.close()

    def _may_follow(self, data: bytes, now_s: float) -> bool:
        """Whether who sent this may be the peer from now on."""
        silent = now_s - self._peer_heard_s > _PEER_SILENCE_S
        return silent and has_autopilot_heartbeat(data, self._system_id)

    def _ignore(self, address: tuple[str, int]) -> None:
        self.strangers += 1
        if self.strangers == 1:
            wanted = f"of system {self._system_id}" if self._system_id else "of an autopilot"
            _log.warning("link: %s:%d is not heard: no heartbeat %s", *address[:2], wanted)


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
        """See `Transport`."""
        data = await self._reader.read(_READ_BYTES)
        if not data:
            raise OSError("the TCP connection is closed")
        return data

    def write(self, data: bytes) -> None:
        """See `Transport`: whole writes are dropped while the other side does not take them."""
        transport = self._writer.transport
        if transport.is_closing():
            return
        if transport.get_write_buffer_size() + len(data) > _WRITE_QUEUE_BYTES:
            self.dropped_bytes += len(data)
            return
        self._writer.write(data)

    def close(self) -> None:
        """See `Transport`."""
        self._writer.transport.abort()


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
        self._inbox = _Inbox()
        self._outbox = bytearray()
        self.dropped_bytes = 0
        self._loop.add_reader(self._fd, self._read_ready)

    async def read(self) -> bytes:
        """See `Transport`."""
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """See `Transport`: whole writes are dropped while the line is stuck."""
        if not self._port.is_open:
            return
        if len(self._outbox) + len(data) > _WRITE_QUEUE_BYTES:
            self.dropped_bytes += len(data)
            return
        idle = not self._outbox
        self._outbox += data
        if idle:
            self._write_ready()
            if self._outbox:
                self._loop.add_writer(self._fd, self._write_ready)

    def close(self) -> None:
        """See `Transport`."""
        self._stop(OSError(f"{self._port.name} is closed"))

    def _read_ready(self) -> None:
        try:
            data = os.read(self._fd, _READ_BYTES)
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


async def open_transport(spec: str, system_id: int = 0) -> Transport:
    """Open `serial:PATH:BAUD`; `udp:HOST:PORT` or `tcp:HOST:PORT` (we call); `udpin:HOST:PORT` (we listen).

    A listener takes the autopilot of `system_id` for its peer; 0 takes the first one heard.

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
        transport = UdpTransport(system_id)
        await transport.open(form["host"], int(form["port"]), listen=form["kind"] == "udpin")
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(f"link.connection: {spec}: {_reason(error)}") from error
    return transport


def _reason(error: Exception) -> str:
    """What went wrong in one short clause."""
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, serial.SerialException) and "exclusively lock" in str(error):
        return "busy; expected a port that no other program has open"
    if number is not None and number > 0:
        return os.strerror(number)
    return str(error)
