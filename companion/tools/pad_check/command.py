"""`companion check`: the preflight check; with --pad the first-flight check, held over the pad."""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import DEFAULT_SETTINGS, must_be_readable, must_be_writable

HELP: Final = """Check, before a flight, all that can be checked of a vehicle that stands there disarmed.

Settings, calibrations, camera, IMU, GPS, ultrasonic, link, the autopilot's parameters, clock, disk and
service: a line each, with what to do about it. Nothing is written to the autopilot. Exit code 0: nothing
fails, 1: something does, 2: it could not be checked.

With --pad, before a first flight, that right is right, forward is forward and down is down: take the
propellers off, keep the vehicle disarmed and hold it over the pad. Instructions say what to do (hold, raise,
move right and forward, turn, tilt), each move is recognised by itself, and camera, IMU, ultrasonic and
compass are held against it and against one another. What is wrong is named with the setting that mends it.

\b
Examples:
  companion check --config mine.yaml
  companion check --config mine.yaml --json -
  companion check --config mine.yaml --write-params changes.params
  companion check --pad --config mine.yaml
  companion check --pad --config mine.yaml --no-link --json check.json
  companion check --pad --config mine.yaml --serve 8080
"""


def check_command(
    *,
    pad: Annotated[bool, typer.Option("--pad", help="Held by hand over the pad.")] = False,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = DEFAULT_SETTINGS,
    no_link: Annotated[
        bool, typer.Option("--no-link", help="Without an autopilot, which else has to be there and disarmed.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Write the result here; '-': to standard output.", metavar="FILE"),
    ] = None,
    params_file: Annotated[
        Path | None,
        typer.Option(
            "--write-params",
            help="Write the autopilot's parameters that differ here, for QGroundControl and Mission Planner.",
            metavar="FILE",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="Where flights are kept; else the service's folder.", metavar="DIR"),
    ] = None,
    serve: Annotated[
        int | None,
        typer.Option(
            "--serve",
            min=0,
            max=65535,
            help="With --pad: the picture with its arrows for browsers at 127.0.0.1:PORT (0: a free one).",
            metavar="PORT",
        ),
    ] = None,
) -> None:
    """Check, show and write.

    Raises:
        ConfigError: something the user can correct.
        Exit: with 1 when something is not well.
    """
    must_be_readable(config)
    if json_file is not None and str(json_file) != "-":
        must_be_writable("--json", json_file)
    if params_file is not None:
        must_be_writable("--write-params", params_file)
    if params_file is not None and (pad or no_link):
        other = "--pad" if pad else "--no-link"
        raise ConfigError(f"--write-params: reads the autopilot's parameters; expected it without {other}")
    if serve is not None and not pad:
        raise ConfigError("--serve: belongs to --pad; expected both, or neither")
    from companion.tools.pad_check.job import check_over_pad, check_vehicle  # noqa: PLC0415 - once all is there

    if pad:
        check_over_pad(config, json_file, linked=not no_link, port=serve)
    else:
        check_vehicle(config, json_file, record, linked=not no_link, params_file=params_file)
