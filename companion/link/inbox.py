"""A pipe within the process: the transport to a simulated autopilot in the same event loop."""

import asyncio
from collections import deque

from companion.base.udp_socket import Inbox


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
