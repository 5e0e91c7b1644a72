"""The MAVLink line between the vehicle and its clients, with the scenario's loss, delay and reordering."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from sitl.faults.lines import LinkChannel, LinkSettings
from sitl.firmware.vehicle import FirmwareNetwork
from sitl.mavlink.network import Network, Write
from sitl.run.tick_timer import TickTimer


class ByteLink(Protocol):
    """The vehicle's end of a MAVLink line."""

    async def read(self) -> bytes:
        """Wait for at least one byte."""
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        ...


class MavlinkLine:
    """Both directions of the line. `network` is set before the first client connects."""

    network: Network | FirmwareNetwork

    def __init__(
        self, ways: tuple[LinkSettings, LinkSettings], rng: np.random.Generator, timer: TickTimer
    ) -> None:
        """`ways`: of the one to the app and of the one to the vehicle."""
        to_app_rng, to_vehicle_rng = rng.spawn(2)
        self.to_app = LinkChannel(ways[0], to_app_rng)
        self.to_vehicle = LinkChannel(ways[1], to_vehicle_rng)
        self._timer = timer
        # called with what clients send, before the line loses or delays it, and the time (s)
        self.listeners: list[Callable[[bytes, float], None]] = []

    def connect(self, write: Write, *, datagrams: bool) -> Any:
        """Connect a client. `write` takes whole frames and must not wait."""

        def send(frames: Sequence[bytes]) -> None:
            self._carry(self.to_app, lambda: write(frames))

        return self.network.connect(send, datagrams=datagrams)

    def disconnect(self, port: Any) -> None:
        self.network.disconnect(port)

    def receive(self, port: Any, data: bytes) -> None:
        for hear in self.listeners:
            hear(data, self._timer.elapsed_s)

        def deliver() -> None:
            self.network.receive(port, data, self._timer.elapsed_s)

        self._carry(self.to_vehicle, deliver)

    async def serve(self, link: ByteLink) -> None:
        """Serve a client in this process until cancelled."""

        def write(frames: Sequence[bytes]) -> None:
            link.write(b"".join(frames))

        port = self.connect(write, datagrams=False)
        while True:
            self.receive(port, await link.read())

    def _carry(self, way: LinkChannel, deliver: Callable[[], None]) -> None:
        """Deliver a datagram when it arrives, if it does."""
        now_s = self._timer.now_s
        arrival_s = way.arrival_s(now_s)
        if arrival_s is None:
            return
        if arrival_s <= now_s:
            deliver()
        else:
            asyncio.get_running_loop().call_at(arrival_s, deliver)
