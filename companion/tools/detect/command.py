"""`companion detect`: photos and videos in; markers, pose and its error out, and drawn on them.

Only the options are here: OpenCV is imported once the files are known to be there.
"""

from pathlib import Path
from typing import Annotated, Final

import typer

from companion.base.errors import ConfigError
from companion.base.files import DEFAULT_SETTINGS, find_file, must_be_readable, must_exist

HELP: Final = """Find the pad in your own photos and videos, by the vision that flies.

SOURCE is a photo, a video or a folder of them, taken with the calibrated camera at the calibrated size. One
line for each picture: the markers that the pose is made of, the distance with its stated error, and the time
that it took. --out draws markers, pad and axes on the pictures.

\b
companion detect photo.jpg --pad indoor_400 --camera camera.yaml --out seen
companion detect frames --camera camera.yaml
companion detect --config companion.yaml flight.mp4 --out seen

Exit codes: 0 the pad was seen, 1 in no picture, 2 something to correct.
"""
Source = Annotated[
    list[Path],
    typer.Argument(metavar="SOURCE", help="Photos, videos or folders of them.", show_default=False),
]


def detect_command(
    sources: Source,
    *,
    pad: Annotated[
        str | None,
        typer.Option("--pad", help="A name in configs/pads, or a file; else the settings'.", metavar="NAME"),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera", help="The calibration: a name in configs/cameras, or a file; else the settings'."
        ),
    ] = None,
    config: Annotated[
        Path, typer.Option("--config", help="The app's settings.", metavar="FILE")
    ] = DEFAULT_SETTINGS,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the overlays to this folder.", metavar="DIR")
    ] = None,
    sends: Annotated[
        bool,
        typer.Option(
            "--send", help="Send each as LANDING_TARGET to the autopilot at the settings' link.connection."
        ),
    ] = False,
) -> None:
    """Look for the pad in each picture, and show what was found.

    Raises:
        ConfigError: something the user can correct.
        Exit: with 1 when the pad is in none.
    """
    for source in sources:
        must_exist(source, "expected a photo, a video or a folder of them")
    for folder, name in (("pads", pad), ("cameras", camera)):
        if name is not None:
            find_file(folder, name)
    must_be_readable(config)
    if out is not None and out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: a file; expected a folder")
    from companion.tools.detect.run import detect_all, find_with  # noqa: PLC0415 - see above

    finder = find_with(config, pad, camera)
    if not sends:
        raise typer.Exit(0 if detect_all(sources, finder, out) else 1)
    from companion.config import load_config  # noqa: PLC0415 - see above
    from companion.tools.detect.send import TargetLink  # noqa: PLC0415 - see above

    with TargetLink(load_config(config)).opened() as link:
        raise typer.Exit(0 if detect_all(sources, finder, out, link.send) else 1)
