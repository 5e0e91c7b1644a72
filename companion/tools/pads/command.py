"""`companion pad`: its options and help. What draws and judges is imported once the files are there."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer

from companion.base.errors import ConfigError
from companion.base.files import find_file
from companion.base.printing.paper import PaperName

HELP: Final = """Check a pad, print it at its true size, or predict how well a camera sees it.

PAD is a name in configs/pads or a .yaml file; else the shipped moving_1300; or 'single', one marker alone,
whose .yaml file -o writes beside the print. What cannot be printed, or not be read from the air, is refused
in one line that names the markers.

\b
companion pad mine.yaml
companion pad mine.yaml -o mine.pdf
companion pad mine.yaml --paper a3 -o mine.pdf
companion pad mine.yaml --coverage --camera hd_1280x720 -o coverage.png
companion pad single --family apriltag_36h11 --id 0 --size 0.4 -o tag.pdf
"""
SINGLE: Final = "single"


def pad_command(
    pad: Annotated[str, typer.Argument(metavar="PAD", show_default=False)] = "moving_1300",
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Print here: .pdf, .svg or .png; single: or .yaml alone.", metavar="FILE"
        ),
    ] = None,
    paper: Annotated[
        Literal[PaperName, "large"] | None,
        typer.Option("--paper", help="Instead of the pad's own sheet: tiles, or one large sheet."),
    ] = None,
    coverage: Annotated[
        bool, typer.Option("--coverage", help="Predict the recall by height; -o: a .png of it.")
    ] = False,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera", help="With --coverage: a name in configs/cameras, or a file.", metavar="CAM"
        ),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option("--offset", help="With --coverage: off the middle (m), a standard deviation.", min=0.0),
    ] = None,
    tilt: Annotated[
        float | None, typer.Option("--tilt", help="The same of the tilt (degrees).", min=0.0, max=45.0)
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", help="Across the pad (m/s), which blurs.", min=0.0)
    ] = None,
    family: Annotated[
        str | None, typer.Option("--family", help="single: 4x4_50, ... Default: apriltag_36h11.")
    ] = None,
    number: Annotated[int | None, typer.Option("--id", help="single: its id. Default: 0.", min=0)] = None,
    size: Annotated[
        float | None, typer.Option("--size", help="single: side of its black square (m). Default: 0.4.")
    ] = None,
) -> None:
    """Check, print or judge.

    Raises:
        ConfigError: the pad breaks a rule, or a file cannot be written.
    """
    given = _given(offset_m=offset, tilt_deg=tilt, speed_m_s=speed)
    if not coverage and (given or camera is not None):
        raise ConfigError("--camera, --offset, --tilt and --speed: expected with --coverage")
    alone = _given(dictionary=family, id=number, side_m=size)
    if pad != SINGLE:
        if alone:
            raise ConfigError("--family, --id and --size: expected with single")
        find_file("pads", pad)
    if camera is not None:
        find_file("cameras", camera)
    from companion.tools.pads.run import run_pad  # noqa: PLC0415 - see above

    single = alone if pad == SINGLE else None
    run_pad(pad, output, paper, coverage=coverage, camera=camera, spread=given, single=single)


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
