"""`companion-sitl hand-held`: a simulated vehicle that is carried by hand, for calibrations, in real time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.files import find_file
from companion.base.signals import run_until_stopped, signals_held_back
from sitl.run.port_options import (
    COMPANION_PORT,
    GROUND_PORT,
    TCP_PORT,
    GroundPortOption,
    PortOption,
    TcpPortOption,
)
from sitl.vehicle.hand_motion import HandMotion

SETTINGS_NAME: Final = "companion.yaml"
HELP: Final = """Serve a vehicle that is carried by hand over its scenario's pad: the same sensors, camera and
MAVLink as in flight, motors off. The same seed has the same motion. The app's settings for it are
written to a file for `--config`, whose path is printed.

\b
  still     stands on the pad
  tumble    turned through all attitudes: for the magnetometer
  faces     laid down on each of its six sides: for the accelerometer
  sway      moved about over the pad, in view: for the camera's mounting
  over-pad  the moves of `companion check --pad`, ten seconds after a program
            has connected to the frames or the IMU's registers

\b
Examples:
  companion-sitl hand-held --motion tumble
  companion-sitl hand-held --motion over-pad --settings hand-held.yaml
  companion-sitl hand-held --motion sway --scenario workshop.yaml --seed 3 \\
      --folder sockets
"""


def hand_held_command(
    *,
    motion: Annotated[HandMotion, typer.Option(help="How it is carried.")],
    scenario: Annotated[str, typer.Option(help="A name in configs/scenarios, or a file.")] = "static",
    seed: Annotated[int, typer.Option(min=0, help="Repeats it.")] = 0,
    folder: Annotated[
        Path | None, typer.Option(help="Where the sockets go; else a temporary folder.", metavar="DIR")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Write the app's settings here; else among the sockets.", metavar="FILE"),
    ] = None,
    port: PortOption = COMPANION_PORT,
    gcs_port: GroundPortOption = GROUND_PORT,
    tcp_port: TcpPortOption = TCP_PORT,
    child: Annotated[bool, typer.Option("--child", hidden=True)] = False,
) -> None:
    """Serve until Ctrl-C; as a child until standard input ends.

    Raises:
        ConfigError: the scenario is wrong, a port is taken, or the folder is none.
    """
    find_file("scenarios", scenario)
    # what simulates is imported once the scenario is there
    from sitl.run.process_control import socket_folder, terminated_as_interrupted  # noqa: PLC0415
    from sitl.run.server import Service, serve, serve_child  # noqa: PLC0415
    from sitl.scenario.scenario import load_scenario  # noqa: PLC0415

    loaded = load_scenario(scenario)
    with terminated_as_interrupted(), signals_held_back(), socket_folder(folder) as place:
        if child:
            run_until_stopped(serve_child(loaded, seed, place, motion))
        else:
            service = Service(companion_port=port, ground_port=gcs_port, tcp_port=tcp_port)
            path = settings or place / SETTINGS_NAME
            run_until_stopped(serve(loaded, seed, place, service, motion=motion, settings_path=path))
