"""`calibrate-mount record`: its options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from calibration.mount.options import SETTINGS, ConfigOption
from companion.base.files import must_be_readable

HELP: Final = """Record IMU samples and pad sightings to DIR/flight.mcap.

Hold the vehicle over the pad with the camera facing it, and move it as the program says. It stops by itself.
It needs no autopilot.

\b
calibrate-mount record swayed
calibrate-mount record swayed --config mine.yaml --serve 8080
"""


def record_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.", show_default=False)],
    *,
    config: ConfigOption = SETTINGS,
    seconds: Annotated[
        float, typer.Option("--seconds", min=5.0, max=1800.0, help="Maximum duration.")
    ] = 180.0,
    serve: Annotated[
        int | None,
        typer.Option("--serve", min=0, max=65535, help="Show the image in a browser on this port."),
    ] = None,
) -> None:
    """Record until the motion is enough.

    Raises:
        ConfigError: the folder holds a recording, or a device does not answer.
        RefusedError: the time was not enough.
    """
    must_be_readable(config)
    from calibration.mount.record.job import record_motion  # noqa: PLC0415 - once the settings are there

    record_motion(config, folder, seconds, serve)
