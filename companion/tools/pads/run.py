"""A pad checked, printed at its true size, or judged for a camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from rich.console import Console

from companion.base.printing.page import ENDINGS, png_dpi, save
from companion.base.printing.paper import PaperName
from companion.config import CameraConfig, ConfigError, find_file, load_model, validate
from companion.pad import Pad, Sheet, checked, load_pad
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.pads.coverage import HOVER, HoverSpread, predict
from companion.tools.pads.printing import draw_pad
from companion.tools.pads.report import TABLE_HEIGHTS_M, coverage_lines, coverage_table, draw_coverage

DEFAULT_CAMERA: Final = "sitl_640x480"


@dataclass(frozen=True, slots=True)
class PadOptions:
    """What to do with a pad: the sheet, where the print or the picture goes, and for whom it is judged."""

    output: Path | None
    paper: Literal[PaperName, "large"] | None
    coverage: bool
    camera: str | None
    spread: Mapping[str, float]


def run_pad(pad: str, options: PadOptions) -> None:
    """Check, print or judge.

    Raises:
        ConfigError: the pad breaks a rule, or a file cannot be written.
    """
    prepare_opencv()
    console = Console()
    made = load_pad(pad)
    if options.paper is not None:
        made = on_paper(made, options.paper, pad)
    _say(console, *summary(made))
    if options.coverage:
        spread = replace(HOVER, **options.spread)
        _judge(made, options.camera or DEFAULT_CAMERA, spread, options.output, console)
    elif options.output is not None:
        _print(made, options.output, console)


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
