"""Commands of `companion-sitl`: options and help. Each imports what does the work once the files are there.

`campaign` ends with 0 when every run has its row, 1 when one failed (its process died or hung) or, with
--bars, a bar does not hold, 2 for a user error, 130 interrupted (the same command continues).
"""

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.autopilot_kind import AutopilotKind
from companion.base.errors import ConfigError
from companion.base.files import find_file, must_be_readable
from companion.base.signals import run_until_stopped, signals_held_back
from sitl.campaign import SCENARIOS
from sitl.run import COMPANION_PORT, GROUND_PORT, TCP_PORT
from sitl.vehicle import HandMotion

FolderOption = Annotated[
    Path | None, typer.Option(help="Where the sockets go; else a temporary folder.", metavar="DIR")
]
FirmwareOption = Annotated[
    AutopilotKind | None,
    typer.Option("--firmware", help="Fly the real firmware in lockstep instead of the bundled autopilot."),
]
FirmwarePathOption = Annotated[
    Path | None,
    typer.Option("--firmware-path", help="Its SITL build: the program px4 or arducopter.", metavar="BIN"),
]
FirmwareParamOption = Annotated[
    list[str] | None,
    typer.Option("--firmware-param", help="A parameter of it; may be given often.", metavar="NAME=VALUE"),
]

PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port where companions listen; 0: they call a free one.")
]
GroundPortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port where ground stations listen; 0: likewise.")
]
TcpPortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="TCP port for several clients; 0 takes a free one.")
]

SCENARIOS_HELP: Final = "List the shipped scenarios; with a name or a file, print all its settings."
SCHEMA_HELP: Final = "Print the JSON schema of scenario files, for editors."


def scenarios_command(
    name: Annotated[
        str | None, typer.Argument(help="A name in configs/scenarios, or a file.", show_default=False)
    ] = None,
) -> None:
    if name is not None:
        find_file("scenarios", name)
    from sitl.scenario.listing import listing, settings_text  # noqa: PLC0415 - not for what is not there
    from sitl.scenario.scenario import load_scenario  # noqa: PLC0415

    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    typer.echo(listing(width) if name is None else settings_text(load_scenario(name)), nl=False)


def schema_command() -> None:
    from sitl.scenario.listing import schema_text  # noqa: PLC0415 - as above

    typer.echo(schema_text(), nl=False)


VIEW_HELP: Final = "Show (in a browser) or record the frames that a socket serves."
EXPECTED: Final = "expected a program that serves frames"


def view_command(
    socket: Annotated[str, typer.Argument(help="A socket's path, or tcp:HOST:PORT.")],
    *,
    record: Annotated[
        Path | None, typer.Option(help="Record to FILE.mp4, or to a folder of PNG files.", metavar="PATH")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every N-th frame only.", metavar="N")] = 1,
    frames: Annotated[int, typer.Option(min=0, help="End after N frames taken.", metavar="N")] = 0,
    serve: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Show them in a browser, on this port; 0 takes a free one."),
    ] = None,
) -> None:
    address = socket if socket.startswith(("socket:", "tcp:")) else f"socket:{socket}"
    if address.startswith("socket:") and not Path(address.removeprefix("socket:")).exists():
        raise ConfigError(f"{address}: No such file or directory; {EXPECTED}")
    from sitl.run.view import ViewOptions, run_view  # noqa: PLC0415 - OpenCV is not for what is not there

    run_view(address, ViewOptions(record, every, frames, serve))


SETTINGS_NAME: Final = "companion.yaml"
HAND_HELD_HELP: Final = """Serve a vehicle that is carried by hand over its scenario's pad: the same sensors,
camera and MAVLink as in flight, motors off. The same seed has the same motion. The app's settings for it are
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
    folder: FolderOption = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Write the app's settings here; else among the sockets.", metavar="FILE"),
    ] = None,
    port: PortOption = COMPANION_PORT,
    gcs_port: GroundPortOption = GROUND_PORT,
    tcp_port: TcpPortOption = TCP_PORT,
    child: Annotated[bool, typer.Option("--child", hidden=True)] = False,
) -> None:
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


ALL: Final = "all"
CAMPAIGN_HELP: Final = """Fly scenarios under many seeds: one row per run, tables, plots, the worst runs.

Each run is what 'companion --sitl --fast' flies for that scenario and seed. Give the same command again after
an interruption, and it continues.

\b
companion-sitl campaign --scenarios line circle --runs 20 --out mine
companion-sitl campaign --scenarios all barge.yaml --runs 100 --jobs 4 \\
    --out all
"""


def campaign_command(
    *,
    scenarios: Annotated[
        list[str] | None,
        typer.Option(
            help="Names in configs/scenarios, or files; 'all' is every shipped one.",
            metavar="NAME...",
            show_default=" ".join(SCENARIOS),
        ),
    ] = None,
    more: Annotated[list[str] | None, typer.Argument(hidden=True, metavar="NAME")] = None,
    runs: Annotated[int, typer.Option(min=1, help="Runs of each scenario, one a seed.", metavar="N")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The first of the seeds.", metavar="N")] = 0,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Runs side by side; else as many as there are cores.", metavar="J"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Rows, tables and plots go there; else nothing is kept.", metavar="DIR"),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The app's settings.", metavar="FILE")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Fly on the Dask cluster of this scheduler (extra 'campaign').", metavar="ADDRESS"),
    ] = None,
    firmware: FirmwareOption = None,
    firmware_path: FirmwarePathOption = None,
    firmware_param: FirmwareParamOption = None,
    bars: Annotated[bool, typer.Option("--bars", help="Judge the landings by the project's bars.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No live bar: lines, as for a log.")] = False,
) -> None:
    if scheduler is not None and jobs is not None:
        raise ConfigError("--jobs: the cluster has its own; expected it without --scheduler")
    sources = (*(scenarios or ()), *(more or ())) or SCENARIOS
    _must_exist(sources, config)
    from rich.console import Console  # noqa: PLC0415 - what flies is imported once the files are there

    from sitl.campaign.run import Options, run_campaign  # noqa: PLC0415
    from sitl.firmware.spec import FirmwareSpec  # noqa: PLC0415

    options = Options(
        sources=sources,
        runs=runs,
        first_seed=first_seed,
        jobs=jobs or len(os.sched_getaffinity(0)),
        folder=out,
        config=config,
        scheduler=scheduler,
        bars=bars,
        quiet=quiet,
        firmware=FirmwareSpec.of(firmware, firmware_path, firmware_param or ()),
    )
    raise typer.Exit(run_campaign(options, Console()))


def _must_exist(sources: Sequence[str], config: Path | None) -> None:
    """What is missing is reported before anything heavy is imported."""
    for source in sources:
        if source != ALL:
            find_file("scenarios", source)
    if config is not None:
        must_be_readable(config)
