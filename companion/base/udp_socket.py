"""A UDP socket as a stream of bytes, and the queue of received bytes. For app and simulator alike."""

import asyncio
from typing import Final

READ_QUEUE_BYTES: Final = 1 << 16


class Inbox:
    """Received bytes that were not read yet; for one reader."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._changed = asyncio.Event()
        self._error: OSError | None = None

    def put(self, data: bytes) -> None:
        """Take bytes in; unread ones are dropped when the queue is full."""
        if len(self._data) + len(data) > READ_QUEUE_BYTES:
            self._data.clear()
        self._data += data
        self._changed.set()

    def fail(self, error: OSError) -> None:
        """The transport is gone: the reader gets the error once the queue is empty."""
        self._error = self._error or error
        self._changed.set()

    async def read(self) -> bytes:
        """Wait for one byte or more.

        Raises:
            OSError: the transport is gone.
        """
        while not self._data:
            if self._error is not None:
                raise self._error
            await self._changed.wait()
            self._changed.clear()
        data = bytes(self._data)
        self._data.clear()
        return data


class UdpSocket(asyncio.DatagramProtocol):
    """One UDP socket: it calls a fixed peer, or listens and answers the last sender that it `accepts`."""

    def __init__(self) -> None:
        self._inbox = Inbox()
        self._socket: asyncio.DatagramTransport | None = None
        self._peer: tuple[str, int] | None = None
        self._calls = False

    @property
    def has_peer(self) -> bool:
        """Whether anybody has sent something that was accepted."""
        return self._peer is not None

    async def open(self, host: str, port: int, *, listen: bool) -> int:
        """Bind to (listen) or call host and port; returns our port.

        Raises:
            OSError: the port is taken, or the host is not known.
        """
        self._calls = not listen
        address = (host, port)
        self._socket, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=address if listen else None, remote_addr=None if listen else address
        )
        ours: tuple[str, int] = self._socket.get_extra_info("sockname")
        return ours[1]

    def accepts(self, data: bytes, address: tuple[str, int]) -> bool:
        """Whether a listener takes this datagram and answers its sender from now on; here: always."""
        return True

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        # a calling socket is connected: the system passes on what the peer sent and nothing else
        if self._calls or self.accepts(data, addr):
            self._peer = addr
            self._inbox.put(data)

    def error_received(self, exc: Exception) -> None:
        """asyncio: the peer is not there yet (ICMP refused); it may come, so go on."""

    def connection_lost(self, exc: Exception | None) -> None:
        self._inbox.fail(OSError(f"the UDP socket is closed{f': {exc}' if exc else ''}"))

    async def read(self) -> bytes:
        """Wait for one byte or more.

        Raises:
            OSError: the socket is closed.
        """
        return await self._inbox.read()

    def write(self, data: bytes) -> None:
        """Send to the peer without waiting; a listener that has no peer yet drops it."""
        if self._socket is None or not data or self._socket.is_closing():
            return
        if self._calls:
            self._socket.sendto(data)
        elif self._peer is not None:
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Give the port back; a waiting `read` ends with OSError."""
        if self._socket is not None:
            self._socket.close()
