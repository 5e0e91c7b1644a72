"""`companion pad`: a pad checked, printed at its true size, or judged for a camera."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Final, Literal

import typer
from rich.console import Console

from companion.config import ConfigError, validate
from companion.pad import Pad, Sheet, checked, load_pad
from companion.pads.printing import draw_pad
from companion.page import ENDINGS, png_dpi, save
from companion.paper import PaperName

HELP: Final = """Check a pad, print it at its true size, or predict how well a camera sees it.

PAD is a name in configs/pads or a .yaml file; else the shipped moving_1300. What cannot be printed, or not be
read from the air, is refused in one line that names the markers.

\b
companion pad mine.yaml
companion pad mine.yaml -o mine.pdf
companion pad mine.yaml --paper a3 -o mine.pdf
companion pad mine.yaml --coverage --camera hd_1280x720 -o coverage.png
"""


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
) -> None:
    """Check, print or judge.

    Raises:
        ConfigError: the pad breaks a rule, or a file cannot be written.
    """
    console = Console()
    made = load_pad(pad)
    if paper is not None:
        made = on_paper(made, paper, pad)
    _say(console, *summary(made))
    if output is not None:
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


def _say(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
