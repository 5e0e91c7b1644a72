"""The simulator as a process of its own, in real time: what `companion-sitl` does when told nothing else.

It serves MAVLink on a UDP port, the GPS and the ultrasonic on ptys, the MPU9250's registers and the
camera's frames on unix sockets, and tells where by one line of JSON on standard output (the keys are the
app's settings). Then it flies until standard input says `finish PHASE`, which makes it judge the flight
and write `report.json` to its folder, or until standard input ends: a simulator whose parent has died
does not stay behind.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any, Final

from companion.config import ConfigError
from companion.messages import Phase
from sitl.devices.ports import PtyPort
from sitl.devices.register_server import serve_registers
from sitl.frame_server import FrameServer
from sitl.report import write_report
from sitl.scenario import Scenario
from sitl.simulation import Simulation

REPORT_NAME: Final = "report.json"
SENSOR_BAUD: Final = 9600


class UdpLink(asyncio.DatagramProtocol):
    """The vehicle's end of MAVLink over UDP: listens, and answers whoever spoke last."""

    def __init__(self) -> None:
        self._inbox: asyncio.Queue[bytes] = asyncio.Queue(maxsize=1000)
        self._socket: asyncio.DatagramTransport | None = None
        self._peer: tuple[str, int] | None = None

    async def open(self, host: str, port: int) -> int:
        """Bind and return the port (a free one for 0).

        Raises:
            ConfigError: the port is taken or the host is not ours.
        """
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: self, local_addr=(host, port)
            )
        except (OSError, OverflowError) as error:
            in_use = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
            reason = "already in use" if in_use else getattr(error, "strerror", None) or str(error)
            raise ConfigError(f"UDP port {host}:{port}: {reason}; expected a free port") from error
        self._socket = transport
        address: tuple[str, int] = transport.get_extra_info("sockname")
        return address[1]

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """asyncio: a datagram came."""
        self._peer = addr
        with contextlib.suppress(asyncio.QueueFull):
            self._inbox.put_nowait(data)

    def error_received(self, exc: Exception) -> None:
        """asyncio: the peer is gone; the next one may come."""

    async def read(self) -> bytes:
        """Wait for a datagram."""
        return await self._inbox.get()

    def write(self, data: bytes) -> None:
        """Send to the last peer, if there has been one."""
        if self._socket is not None and self._peer is not None:
            self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Give the port back."""
        if self._socket is not None:
            self._socket.close()


async def serve(scenario: Scenario, seed: int, folder: Path, port: int) -> None:
    """Run a simulation until standard input says so; see the module's docstring.

    Raises:
        ConfigError: a port is taken, or a settings file that the scenario names is wrong.
    """
    async with contextlib.AsyncExitStack() as stack:
        link = UdpLink()
        udp_port = await link.open("127.0.0.1", port)
        stack.callback(link.close)
        gps_port, range_port = PtyPort(SENSOR_BAUD), PtyPort(SENSOR_BAUD)
        stack.callback(gps_port.close)
        stack.callback(range_port.close)
        frames = FrameServer(folder / "camera")
        await frames.start()
        stack.push_async_callback(frames.close)
        simulation = Simulation(
            scenario,
            seed,
            link=link,
            gps_port=gps_port,
            range_port=range_port,
            deliver_frame=frames.deliver,
        )
        registers = await serve_registers(simulation.imu_bus, folder / "registers")
        stack.callback(registers.close)
        bus = "spi-socket" if scenario.sensors.imu_interface == "spi" else "socket"
        _say(_endpoints(udp_port, gps_port.path, range_port.path, f"{bus}:{folder / 'registers'}", folder))
        await _fly_until_told(simulation, folder)


def _endpoints(udp_port: int, gps_path: str, range_path: str, bus: str, folder: Path) -> dict[str, Any]:
    """The app's settings that lead here."""
    return {
        "link": {"connection": f"udp:127.0.0.1:{udp_port}"},
        "sense": {
            "imu": {"bus": bus},
            "gps": {"port": gps_path},
            "range": {"port": range_path},
            "vision": {"source": f"socket:{folder / 'camera'}"},
        },
    }


async def _fly_until_told(simulation: Simulation, folder: Path) -> None:
    flying = asyncio.create_task(simulation.run())
    listening = asyncio.create_task(_final_phase())
    await asyncio.wait([flying, listening], return_when=asyncio.FIRST_COMPLETED)
    if flying.done():
        listening.cancel()
        flying.result()
    phase = listening.result()
    flying.cancel()
    await asyncio.wait([flying])
    if phase is not None:
        write_report(simulation.report(phase), folder / REPORT_NAME)
        _say({"report": str(folder / REPORT_NAME)})


async def _final_phase() -> Phase | None:
    """Wait for `finish PHASE` on standard input; None when it ends without."""
    loop = asyncio.get_running_loop()
    said: asyncio.Future[str] = loop.create_future()

    def settle(line: str) -> None:
        if not said.done():
            said.set_result(line)

    def listen() -> None:
        # a thread, since a loop cannot watch a standard input that is a file or /dev/null; unbuffered, since
        # a buffer's lock that a waiting thread holds breaks the end of the interpreter
        line = b""
        while b"\n" not in line and (data := os.read(sys.stdin.fileno(), 100)):
            line += data
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(settle, line.decode(errors="replace"))

    threading.Thread(target=listen, name="standard input", daemon=True).start()
    word, _, phase = (await said).strip().partition(" ")
    return Phase(phase) if word == "finish" and phase in set(Phase) else None


def _say(message: dict[str, Any]) -> None:
    print(json.dumps(message), flush=True)
