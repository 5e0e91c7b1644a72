"""The world around an external vehicle as a process: `companion-sitl --external`.

It flies nothing: it watches the vehicle of an ArduPilot or PX4 SITL over MAVLink and puts a pad, a camera
and an ultrasonic about it, in real time. It says by one line of JSON on standard output where these are
once the vehicle is found (the keys are the app's settings), and on standard error what it waits for. Ctrl-C
ends it and has the last landing judged. As the app's child it judges when standard input says `finish PHASE`,
and ends with standard input, as the bundled simulator does.

The app may share the connection: `link.connection` of that line is a UDP port behind which the vehicle is.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from pathlib import Path
from typing import Any

from companion.base.messages import Phase
from companion.base.signals import stopping_on_signals
from sitl.camera.frame_server import FrameServer
from sitl.devices.ports import PtyPort
from sitl.external.link import check_connection, open_link, open_relay
from sitl.external.session import ExternalConnections, ExternalSimulation
from sitl.run.process_control import final_phase, print_json, run_until_finished
from sitl.run.server import REPORT_NAME, SENSOR_BAUD
from sitl.scenario.home import magnetic_field_ned_ut
from sitl.scenario.scenario import Scenario


async def serve_external(
    scenario: Scenario, seed: int, folder: Path, connection: str, *, child: bool = False
) -> None:
    """Run the world until standard input or a signal ends it; see the module's docstring.

    Raises:
        ConfigError: the connection is none, a port is taken, or the scenario does not suit.
    """
    check_connection(connection, "--external")
    async with contextlib.AsyncExitStack() as stack:
        link = await open_link(connection, tell)
        stack.callback(link.close)
        relay, relay_port = await open_relay()
        stack.callback(relay.close)
        range_port = PtyPort(SENSOR_BAUD)
        stack.callback(range_port.close)
        frames = FrameServer(folder / "camera")
        await frames.start()
        stack.push_async_callback(frames.close)
        simulation = ExternalSimulation(
            scenario, seed, ExternalConnections(link, relay, range_port, frames), tell
        )
        stopped = asyncio.Event()
        if not child:
            stack.enter_context(stopping_on_signals(stopped.set))
        ending = final_phase() if child else _landed_once(stopped)
        _tell_pad(scenario)
        tell(f"waiting for a vehicle on {connection}")
        endpoints = _endpoints(relay_port, range_port.path, frames.address)
        telling = asyncio.create_task(_tell_once_found(simulation, endpoints))
        stack.callback(telling.cancel)
        await run_until_finished(simulation, folder / REPORT_NAME, ending)


def _endpoints(relay_port: int, range_path: str, frames: str) -> dict[str, Any]:
    """The app's settings that lead here."""
    return {
        "link": {"connection": f"udp:127.0.0.1:{relay_port}"},
        "sense": {
            "source": "autopilot",
            "autopilot": {"range_source": "boards"},
            "range": {"port": range_path},
            "vision": {"source": frames},
        },
    }


async def _tell_once_found(simulation: ExternalSimulation, endpoints: dict[str, Any]) -> None:
    await simulation.ready.wait()
    assert simulation.place is not None  # chosen with the first pose
    # both autopilots' simulators take their field from the magnetic model at the place where they stand;
    # with another place's field the app's heading would be wrong by the difference of the declinations
    field_ned_ut = magnetic_field_ned_ut(simulation.place)
    print_json({**endpoints, "estimate": {"magnetic_field_ned_ut": list(field_ned_ut)}})


async def _landed_once(stopped: asyncio.Event) -> Phase:
    """The final phase is unknown: the truth alone decides."""
    await stopped.wait()
    return Phase.LANDED


def _tell_pad(scenario: Scenario) -> None:
    height_m = scenario.pad.surface_height_m
    if height_m > 0.0:
        tell(
            f"scenario '{scenario.name}': pad.surface_height_m {height_m:g} is taken as 0: the ground of an "
            "external simulator is flat, so the pad lies flush with it"
        )


def tell(text: str) -> None:
    """One line for people, on standard error."""
    print(f"companion-sitl: {text}", file=sys.stderr, flush=True)
