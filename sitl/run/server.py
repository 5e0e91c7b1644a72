"""The simulator as a separate process in real time: `companion-sitl` without a command.

Two modes. For users (`serve`) MAVLink is on PX4's and ArduPilot's usual ports, a text describes where
and how to connect, and Ctrl-C ends it. As the app's child (`serve_child`) it takes one free UDP port, reports
where by one line of JSON on standard output (the keys are the app's settings), and flies until standard input
has `finish PHASE`, upon which it scores the flight and writes `report.json` to its folder, or until standard
input ends: the child does not outlive its parent.

Either way the GPS and the ultrasonic are on ptys, the MPU9250's registers and the camera's frames on unix
sockets in its folder.
"""

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from companion.base.clock import Clock, start_unix_s
from companion.base.files import write_atomically
from companion.base.signals import stopping_on_signals
from sitl.devices.neo6m import UNIX_AT_START_S
from sitl.devices.ports import PtyPort
from sitl.devices.socket_servers import FrameServer, serve_registers
from sitl.firmware.spec import FirmwareSpec
from sitl.mavlink.links import TcpServer, UdpServer
from sitl.run import COMPANION_PORT, GROUND_PORT, LOOPBACK, TCP_PORT
from sitl.run.process_control import (
    REPORT_NAME,
    SENSOR_BAUD,
    final_phase,
    print_json,
    run_until_finished,
)
from sitl.run.simulation import Simulation
from sitl.scenario.listing import app_settings_text
from sitl.scenario.scenario import Scenario
from sitl.vehicle import HandMotion

# from which the vehicle sends to those two, as PX4's simulator does; to others it sends from a free one
_OWN_PORTS: Final = {COMPANION_PORT: 14580, GROUND_PORT: 18570}


@dataclass(frozen=True, slots=True)
class Service:
    """Where MAVLink is served: UDP ports at which clients listen (0: they call), and the TCP port."""

    bind: str = LOOPBACK
    companion_port: int = COMPANION_PORT
    ground_port: int = GROUND_PORT
    tcp_port: int = TCP_PORT


async def serve(
    scenario: Scenario,
    seed: int,
    folder: Path,
    service: Service,
    signing_key: bytes | None = None,
    *,
    serve_truth: bool = False,
    motion: HandMotion | None = None,
    settings_path: Path | None = None,
    firmware: FirmwareSpec | None = None,
) -> None:
    """Serve a vehicle until Ctrl-C or SIGTERM; `serve_truth`: clients may request the truth.

    With a `motion` it is carried by hand. The app's settings that lead to it go to `settings_path`.
    """
    async with contextlib.AsyncExitStack() as stack:
        unix_at_start_s = start_unix_s(virtual=False) + Clock().now_s()
        with _kept_free(service):
            simulation, devices = await _plug_in(
                stack,
                scenario,
                seed,
                folder,
                signing_key,
                unix_at_start_s,
                serve_truth=serve_truth,
                keep_truth=False,
                motion=motion,
                firmware=firmware,
            )
        companion_port = await _open_udp(stack, simulation, service.bind, service.companion_port)
        ground_port = await _open_udp(stack, simulation, service.bind, service.ground_port)
        tcp = TcpServer(simulation.line)
        stack.callback(tcp.close)
        tcp_port = await tcp.open(service.bind, service.tcp_port)
        own = (companion_port, ground_port, tcp_port)
        if settings_path is not None:
            connection = f"udp:{LOOPBACK}:{companion_port}"
            write_atomically(settings_path, app_settings_text(scenario, connection, devices))
        with _running(simulation) as flying:
            print(_greeting(scenario, seed, service, own, devices, motion), flush=True)
            if settings_path is not None:
                print(f"The app's settings for it are in {settings_path}", flush=True)
            await asyncio.wait([flying])
        if not flying.cancelled():
            flying.result()


async def serve_child(
    scenario: Scenario,
    seed: int,
    folder: Path,
    motion: HandMotion | None = None,
    firmware: FirmwareSpec | None = None,
) -> None:
    """Run a simulation for a parent process until standard input ends it; see the module's docstring."""
    async with contextlib.AsyncExitStack() as stack:
        simulation, devices = await _plug_in(stack, scenario, seed, folder, motion=motion, firmware=firmware)
        udp_port = await _open_udp(stack, simulation, LOOPBACK, 0)
        print_json({"link": {"connection": f"udp:{LOOPBACK}:{udp_port}"}, **devices})
        await run_until_finished(simulation, folder / REPORT_NAME, final_phase())


async def _plug_in(
    stack: contextlib.AsyncExitStack,
    scenario: Scenario,
    seed: int,
    folder: Path,
    signing_key: bytes | None = None,
    unix_at_start_s: float = UNIX_AT_START_S,
    *,
    serve_truth: bool = False,
    keep_truth: bool = True,
    motion: HandMotion | None = None,
    firmware: FirmwareSpec | None = None,
) -> tuple[Simulation, dict[str, Any]]:
    """A simulation with everything but MAVLink connected, and the app's settings that lead to its devices.

    The stack takes it all down.
    """
    gps_port, range_port = PtyPort(SENSOR_BAUD), PtyPort(SENSOR_BAUD)
    stack.callback(gps_port.close)
    stack.callback(range_port.close)
    frames = FrameServer(folder / "camera")
    simulation = Simulation(
        scenario,
        seed,
        gps_port=gps_port,
        range_port=range_port,
        deliver_frame=frames.deliver,
        camera_wanted=lambda: frames.client_count > 0,
        signing_key=signing_key,
        unix_at_start_s=unix_at_start_s,
        serve_truth=serve_truth,
        keep_truth=keep_truth,
        motion=motion,
        hands_wait=True,
        firmware=firmware,
    )
    stack.callback(simulation.close)
    await frames.start(simulation.begin_motion)
    stack.push_async_callback(frames.close)
    registers = await serve_registers(simulation.imu_bus, folder / "registers", simulation.begin_motion)
    stack.callback(registers.close)
    bus = "spi-socket" if scenario.sensors.imu_interface == "spi" else "socket"
    settings = {
        "sense": {
            "imu": {"bus": f"{bus}:{folder / 'registers'}"},
            "gps": {"port": gps_port.path},
            "range": {"port": range_port.path},
            "vision": {"source": f"socket:{folder / 'camera'}"},
        }
    }
    return simulation, settings


@contextlib.contextmanager
def _kept_free(service: Service) -> Iterator[None]:
    """While inside, no firmware takes the ports to be served: its instances use the same defaults."""
    udp = (_OWN_PORTS.get(port, port) for port in (service.companion_port, service.ground_port))
    wanted = [*((socket.SOCK_DGRAM, port) for port in udp), (socket.SOCK_STREAM, service.tcp_port)]
    with contextlib.ExitStack() as stack:
        for kind, port in wanted:
            kept = stack.enter_context(socket.socket(socket.AF_INET, kind))
            with contextlib.suppress(OSError):  # it is in use, which is reported when it is opened
                kept.bind((LOOPBACK, port))
        yield


async def _open_udp(
    stack: contextlib.AsyncExitStack, simulation: Simulation, bind: str, client_port: int
) -> int:
    """Send to a client's port, if there is to be one, and return the vehicle's own."""
    # what is bound to one address of this computer cannot be reached at another
    client_host = bind if bind not in ("0.0.0.0", "") else LOOPBACK
    server = UdpServer(simulation.line, (client_host, client_port) if client_port else None)
    stack.callback(server.close)
    return await server.open(bind, _OWN_PORTS.get(client_port, 0))


def _greeting(
    scenario: Scenario,
    seed: int,
    service: Service,
    own: tuple[int, int, int],
    settings: dict[str, Any],
    motion: HandMotion | None,
) -> str:
    """The text for users: where and how to connect."""
    name = {"px4": "PX4", "ardupilot": "ArduPilot"}[scenario.autopilot]
    host = LOOPBACK if service.bind == "0.0.0.0" else service.bind
    companion, ground, tcp = own
    sense = settings["sense"]
    lines = [
        f"companion-sitl: a quadrotor with {name}'s profile, scenario {scenario.name}, seed {seed}"
        + ("" if motion is None else f", carried by hand: {motion}"),
        *_udp_lines("companions", "MAVSDK udpin://0.0.0.0:{}", host, service.companion_port, companion),
        *_udp_lines("ground stations", "QGroundControl, mavproxy.py --master udp:127.0.0.1:{}", host,
                    service.ground_port, ground),
        f"  TCP {tcp:<6} MAVLink for several clients: mavproxy.py --master tcp:{host}:{tcp}",
        f"  camera     {sense['vision']['source']}",
        f"  IMU        {sense['imu']['bus']}",
        f"  GPS        {sense['gps']['port']}",
        f"  ultrasonic {sense['range']['port']}",
        "Ctrl-C stops it.",
    ]  # fmt: skip
    return "\n".join(lines)


def _udp_lines(whom: str, example: str, host: str, client_port: int, own_port: int) -> list[str]:
    """Where clients listen, and where they may connect to."""
    calling = f"call udpout:{host}:{own_port}"
    if not client_port:
        return [f"  UDP {own_port:<6} MAVLink for {whom}: {calling}"]
    return [
        f"  UDP {client_port:<6} MAVLink for {whom}: listen there ({example.format(client_port)}),",
        f"             or {calling}",
    ]


@contextlib.contextmanager
def _running(simulation: Simulation) -> Iterator[asyncio.Task[None]]:
    """A running simulation, which Ctrl-C, SIGTERM and SIGHUP cancel while inside."""
    flying = asyncio.create_task(simulation.run())
    with stopping_on_signals(flying.cancel):
        yield flying
