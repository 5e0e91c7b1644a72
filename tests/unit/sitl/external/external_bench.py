"""Plays recorded poses to an external world over UDP, as the simulator that flies the vehicle would."""

import asyncio
from typing import Any

from companion.base.clock import Clock
from companion.base.udp_socket import UdpSocket
from companion.link.codec import Codec
from tests.unit.sitl.external.external_vehicle import (
    ARDUPILOT,
    Flight,
    MessageSender,
    heartbeat,
    hil_state,
    sim_state,
)


class Player:
    """Plays a flight's poses from a UDP port, as ArduPilot's or PX4's simulator would tell them."""

    def __init__(self, autopilot: int, flight: Flight, disarm_s: float) -> None:
        self.port = 0
        self.start_s = 0.0
        self._autopilot, self._flight, self._disarm_s = autopilot, flight, disarm_s
        self._end, self._sender = UdpSocket(), MessageSender()

    async def run(self, still_s: float, seconds: float) -> None:
        """Stand for a while and then fly; poses at 100 Hz, heartbeats at 5 Hz."""
        clock = Clock()
        while not self._end.has_peer:  # noqa: ASYNC110 - it has no event for it
            await asyncio.sleep(0.01)
        self.start_s = clock.now_s() + still_s
        for k in range(round((still_s + seconds) * 100.0)):
            await clock.sleep_until(self.start_s - still_s + 0.01 * k)
            time_s = clock.now_s() - self.start_s
            armed = 0.0 <= time_s < self._disarm_s
            position, velocity = self._flight(max(0.0, time_s))
            message = sim_state if self._autopilot == ARDUPILOT else hil_state
            if k % 20 == 0:
                self._end.write(self._sender.pack(heartbeat(self._autopilot, armed=armed)))
            self._end.write(self._sender.pack(message(position, velocity if time_s >= 0.0 else (0.0,) * 3)))

    async def hear(self, kind: str) -> Any:
        """The next message of a kind that comes for the vehicle."""
        codec = Codec(1, 1)
        while True:
            for message in codec.decode(await asyncio.wait_for(self._end.read(), 5.0)):
                if message.get_type() == kind:
                    return message

    def say(self, *messages: Any) -> None:
        self._end.write(self._sender.pack(*messages))

    async def open(self) -> None:
        self.port = await self._end.open("127.0.0.1", 0, listen=True)

    def close(self) -> None:
        self._end.close()
