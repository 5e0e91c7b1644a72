"""`calibrate-mount camera`: its options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from calibration.mount.options import ForceOption, OutputOption, check_output
from companion.base.files import find_file, must_exist

HELP: Final = """Solve for the camera's rotation, position and time offset from a recording.

LOG is the folder or flight.mcap of 'calibrate-mount record', or of a flight that hovered over the pad.

\b
calibrate-mount camera swayed -o mount.yaml
calibrate-mount camera flights/hover -o mount.yaml --plots pictures
calibrate-mount camera swayed -o mount.yaml --camera my_camera.yaml
"""
EXPECTED: Final = "expected the folder or the flight.mcap of 'calibrate-mount record' or of a flight"


def camera_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Recording to solve.", show_default=False)],
    *,
    output: OutputOption = Path("mount.yaml"),
    camera: Annotated[
        str | None,
        typer.Option("--camera", help="Camera file to use instead of the recording's.", metavar="FILE"),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", help="Write plots to this folder.", metavar="DIR")
    ] = None,
    position_std: Annotated[
        float,
        typer.Option(
            "--position-std", min=0.001, max=1.0, help="Standard deviation of the configured position, m."
        ),
    ] = 0.02,
    max_rotation_deg: Annotated[
        float,
        typer.Option(
            "--max-rotation-deg", min=0.1, max=180.0, help="Maximum rotation from the configured mount."
        ),
    ] = 10.0,
    force: ForceOption = False,
) -> None:
    """Solve, show, judge and write.

    Raises:
        ConfigError: the recording is none, or the file cannot be written.
        RefusedError: it is not good enough.
    """
    check_output(output)
    must_exist(log, EXPECTED)
    lens = None if camera is None else find_file("cameras", camera)
    from calibration.mount.solve.job import SolveJob, solve_mount  # noqa: PLC0415 - once the files are there

    solve_mount(SolveJob(log, output, lens, plots, position_std, max_rotation_deg, force=force))
