"""`companion pad`: a pad checked, printed at its true size, or judged for a camera."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import typer
from rich.console import Console

from companion.base.printing.page import ENDINGS, png_dpi, save
from companion.base.printing.paper import PaperName
from companion.config import CameraConfig, ConfigError, find_file, load_model, validate
from companion.pad import Pad, Sheet, checked, load_pad
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.pads.coverage import HOVER, HoverSpread, predict
from companion.tools.pads.printing import draw_pad
from companion.tools.pads.report import TABLE_HEIGHTS_M, coverage_lines, coverage_table, draw_coverage

HELP: Final = """Check a pad, print it at its true size, or predict how well a camera sees it.

PAD is a name in configs/pads or a .yaml file; else the shipped moving_1300. What cannot be printed, or not be
read from the air, is refused in one line that names the markers.

\b
companion pad mine.yaml
companion pad mine.yaml -o mine.pdf
companion pad mine.yaml --paper a3 -o mine.pdf
companion pad mine.yaml --coverage --camera hd_1280x720 -o coverage.png
"""
DEFAULT_CAMERA: Final = "sitl_640x480"


def pad_command(
    pad: Annotated[str, typer.Argument(metavar="PAD", show_default=False)] = "moving_1300",
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Print here: .pdf, .svg or .png.", metavar="FILE")
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
) -> None:
    """Check, print or judge.

    Raises:
        ConfigError: the pad breaks a rule, or a file cannot be written.
    """
    prepare_opencv()
    console = Console()
    spread = {"offset_m": offset, "tilt_deg": tilt, "speed_m_s": speed}
    given = {name: value for name, value in spread.items() if value is not None}
    if not coverage and (given or camera is not None):
        raise ConfigError("--camera, --offset, --tilt and --speed: expected with --coverage")
    made = load_pad(pad)
    if paper is not None:
        made = on_paper(made, paper, pad)
    _say(console, *summary(made))
    if coverage:
        _judge(made, camera or DEFAULT_CAMERA, replace(HOVER, **given), output, console)
    elif output is not None:
        _print(made, output, console)


def on_paper(pad: Pad, paper: Literal[PaperName, "large"], source: str) -> Pad:
    """The pad on another sheet.

    Raises:
        ConfigError: it cannot be printed on it.
    """
    kept = pad.sheet.model_dump(exclude={"size_m"})
    sheet = validate(Sheet, {**kept, "paper": paper}, f"{source}: sheet")
    return checked(pad.model_copy(update={"sheet": sheet}), f"{source} on {paper}")


def summary(pad: Pad) -> list[str]:
    """A checked pad in a few lines."""
    tiling = pad.tiling()
    kinds = Counter((m.group, m.dictionary, m.side_m) for m in pad.markers)
    width, height = (1e3 * side for side in tiling.page_m)
    sheets = "1 sheet" if tiling.count == 1 else f"{tiling.count} sheets"
    return [
        f"{pad.name}: {1e3 * pad.width_m:g} x {1e3 * pad.length_m:g} mm, {len(pad.markers)} markers, good",
        *(
            f"  {group}: {n} x {1e3 * side:g} mm, {name}"
            for (group, name, side), n in sorted(kinds.items(), key=lambda kind: -kind[0][2])
        ),
        f"  {sheets} of {width:g} x {height:g} mm ({pad.sheet.paper})",
    ]


def _print(pad: Pad, output: Path, console: Console) -> None:
    if output.suffix.lower() not in ENDINGS or not output.parent.is_dir():
        raise ConfigError(f"-o {output}: expected a {', '.join(ENDINGS)} file in an existing folder")
    pages = draw_pad(pad)
    for path in save(pages, output):
        resolution = f" ({png_dpi(pages[0].size_mm)} dots an inch)" if path.suffix.lower() == ".png" else ""
        _say(console, f"{path}{resolution}")
    _say(console, "print at 100 %, and hold a ruler against the one on the sheet")


def _judge(pad: Pad, camera_name: str, spread: HoverSpread, output: Path | None, console: Console) -> None:
    if output is not None and (output.suffix.lower() != ".png" or not output.parent.is_dir()):
        raise ConfigError(f"-o {output}: expected a .png file in an existing folder")
    camera = load_model(CameraConfig, find_file("cameras", camera_name))
    console.print(coverage_table(predict(pad, camera, spread, np.array(TABLE_HEIGHTS_M))))
    everywhere = predict(pad, camera, spread)
    _say(console, f"{camera.name}, {spread.words}:", *coverage_lines(everywhere))
    if output is not None:
        draw_coverage(everywhere, pad, camera, output)
        _say(console, f"picture: {output}")


def _say(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
