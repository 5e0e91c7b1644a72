"""The vehicle's MAVLink sockets: UDP and TCP, each client with its own port in the vehicle's network.

UDP as in both autopilots' simulators: the vehicle has its own address, sends to the one where a client
listens (14540, 14550) from the start, and also answers any other sender. Over TCP (5760) it listens. Clients
cannot block it: what a client does not read is dropped, by whole frames.
"""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Sequence
from typing import Any, Final, Protocol

from companion.base.clock import Clock
from companion.config import ConfigError
from sitl.mavlink.framing import FrameReader
from sitl.mavlink.network import Port, Write

Address = tuple[Any, ...]  # host, port; over IPv6 flow and scope, too

MOST_CLIENTS: Final = 16
UDP_SILENCE_S: Final = 60.0  # a client sends a heartbeat once a second; without it for so long it is removed
SWEEP_PERIOD_S: Final = 10.0
DATAGRAM_BYTES: Final = 1400
UNREAD_BYTES: Final = 1 << 18
_NO_ADDRESS: Final = (OSError, OverflowError, UnicodeError)  # the last for an invalid host name


class Vehicle(Protocol):
    """Where the sockets connect clients."""

    def connect(self, write: Write, *, datagrams: bool) -> Port: ...

    def receive(self, port: Port, data: bytes) -> None: ...

    def disconnect(self, port: Port) -> None: ...


class UdpServer(asyncio.DatagramProtocol):
    """One UDP address of the vehicle's; `listener` is where a client is expected to listen, None: nowhere."""

    def __init__(self, vehicle: Vehicle, listener: Address | None = None) -> None:
        self._vehicle = vehicle
        self._listener = listener
        self._clock = Clock()
        self._socket: asyncio.DatagramTransport | None = None
        self._clients: dict[Address, Port] = {}
        self._received_s: dict[Address, float] = {}
        self._write_paused = False
        self._removal_timer: asyncio.TimerHandle | None = None

    async def open(self, host: str, port: int) -> int:
        """Bind, begin to send, and return the port (a free one for 0).

        Raises:
            ConfigError: the port is taken or the host is not ours.
        """
        loop = asyncio.get_running_loop()
        try:
            self._socket, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(host, port))
            if self._listener is not None:
                # numeric, as the sender address of its datagrams: by name it would be another client
                family = self._socket.get_extra_info("socket").family
                found = await loop.getaddrinfo(*self._listener, family=family, type=socket.SOCK_DGRAM)
                self._listener = found[0][4]
                self._add_client(self._listener)
        except _NO_ADDRESS as error:
            self.close()
            raise ConfigError(_refusal("UDP", host, port, error)) from error
        self._remove_periodically()
        return int(self._socket.get_extra_info("sockname")[1])

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """asyncio: a datagram came."""
        port = self._clients.get(addr) or self._add_sender(addr, data)
        if port is not None:
            self._received_s[addr] = self._clock.now_s()
            self._vehicle.receive(port, data)

    def error_received(self, exc: Exception) -> None:
        """asyncio: no listener there yet."""

    def pause_writing(self) -> None:
        """asyncio: the send buffer is full; further datagrams are dropped."""
        self._write_paused = True

    def resume_writing(self) -> None:
        """asyncio: the send buffer has room again."""
        self._write_paused = False

    def close(self) -> None:
        if self._removal_timer is not None:
            self._removal_timer.cancel()
        for address in tuple(self._clients):
            self._remove_client(address)
        if self._socket is not None:
            self._socket.close()

    def _add_sender(self, address: Address, data: bytes) -> Port | None:
        """A port for a sender of MAVLink; None for other data, or with too many clients."""
        if not FrameReader(datagrams=True).read(data, 0.0):
            return None  # a stray datagram is not a client
        self._remove_inactive()
        return self._add_client(address) if len(self._clients) < MOST_CLIENTS else None

    def _remove_periodically(self) -> None:
        self._remove_inactive()
        self._removal_timer = asyncio.get_running_loop().call_later(SWEEP_PERIOD_S, self._remove_periodically)

    def _remove_inactive(self) -> None:
        """Remove clients after a silence; the configured listener stays."""
        now_s = self._clock.now_s()
        for address, received_s in tuple(self._received_s.items()):
            if address != self._listener and now_s - received_s > UDP_SILENCE_S:
                self._remove_client(address)

    def _add_client(self, address: Address) -> Port:
        def write(frames: Sequence[bytes]) -> None:
            if self._socket is None or self._socket.is_closing() or self._write_paused:
                return
            for datagram in in_datagrams(frames):
                self._socket.sendto(datagram, address)

        port = self._clients[address] = self._vehicle.connect(write, datagrams=True)
        return port

    def _remove_client(self, address: Address) -> None:
        self._vehicle.disconnect(self._clients.pop(address))
        self._received_s.pop(address, None)


class TcpServer:
    """The vehicle's TCP port, for several clients."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._server: asyncio.Server | None = None
        self._clients: set[_TcpClient] = set()

    async def open(self, host: str, port: int) -> int:
        """Listen and return the port (a free one for 0).

        Raises:
            ConfigError: the port is taken or the host is not ours.
        """
        try:
            self._server = await asyncio.get_running_loop().create_server(
                lambda: _TcpClient(self._vehicle, self._clients), host, port
            )
        except _NO_ADDRESS as error:
            raise ConfigError(_refusal("TCP", host, port, error)) from error
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for client in tuple(self._clients):
            client.close()


class _TcpClient(asyncio.Protocol):
    def __init__(self, vehicle: Vehicle, clients: set[_TcpClient]) -> None:
        self._vehicle = vehicle
        self._clients = clients
        self._transport: asyncio.Transport | None = None
        self._port: Port | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        if len(self._clients) >= MOST_CLIENTS:
            transport.abort()
            return
        self._transport = transport
        self._clients.add(self)
        self._port = self._vehicle.connect(self._write, datagrams=False)

    def data_received(self, data: bytes) -> None:
        if self._port is not None:
            self._vehicle.receive(self._port, data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._clients.discard(self)
        if self._port is not None:
            self._vehicle.disconnect(self._port)
            self._port = None

    def close(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def _write(self, frames: Sequence[bytes]) -> None:
        transport = self._transport
        if transport is None or transport.is_closing() or transport.get_write_buffer_size() > UNREAD_BYTES:
            return  # it does not read: these frames are dropped
        transport.write(b"".join(frames))


def in_datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Whole frames, grouped into datagrams below the MTU."""
    datagrams: list[bytes] = []
    room = 0
    for frame in frames:
        if len(frame) > room:
            datagrams.append(frame)
            room = DATAGRAM_BYTES - len(frame)
        else:
            datagrams[-1] += frame
            room -= len(frame)
    return datagrams


def _refusal(kind: str, host: str, port: int, error: Exception) -> str:
    """Why an address cannot be bound, in one line."""
    in_use = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
    reason = "already in use" if in_use else getattr(error, "strerror", None) or str(error)
    return f"{kind} port {host}:{port}: {reason}; expected a free port at an address of this computer"
