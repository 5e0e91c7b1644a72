"""A pad checked, printed at its true size, or judged for a camera."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from companion.base.command_line import say
from companion.base.files import YAML_SUFFIXES, save_figure, write_atomically
from companion.base.geometry import FloatArray
from companion.base.messages import MarkerGroup
from companion.base.printing.page import ENDINGS, png_dpi, save
from companion.base.printing.paper import PaperName
from companion.config import CameraConfig, ConfigError, find_file, load_model, validate
from companion.pad import Marker, Pad, Sheet, checked, load_pad
from companion.pad.colours import GROUP_COLOURS
from companion.sense.vision.aruco import GROUPS
from companion.sense.vision.opencv import prepare_opencv
from companion.tools.pads.coverage import (
    BLIND_RECALL,
    HOVER,
    HoverSpread,
    PredictedRecall,
    predict,
    seen_between,
)
from companion.tools.pads.printing import draw_pad

TABLE_HEIGHTS_M: Final = (0.05, 0.08, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 4.0, 6.0, 9.0, 12.0, 15.0)
TICKS_M: Final = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SURE_RECALL: Final = 0.99
NAMES: Final[dict[MarkerGroup, str]] = {"F": "F (far)", "M": "M (medium)", "C": "C (close)"}


def coverage_table(coverage: PredictedRecall) -> Table:
    """Recall in per cent, a row a height."""
    made = Table(title="predicted recall (%) by height", title_justify="left")
    there = [g for g in GROUPS if g in coverage.groups]
    for name in ("m", *(NAMES[g] for g in there), "pad"):
        made.add_column(name, justify="right")
    columns = (coverage.groups[g] for g in there)
    for height, *recalls in zip(coverage.heights_m, *columns, coverage.pad, strict=True):
        made.add_row(f"{height:g}", *(f"{100 * r:.1f}" for r in recalls))
    return made


def coverage_lines(coverage: PredictedRecall) -> list[str]:
    """From where to where each group and the pad are seen, the weakest height between, the blind height."""
    rows = [(f"  {NAMES[g]}", coverage.groups[g]) for g in GROUPS if g in coverage.groups]
    lines = [
        f"{name}: {_span(coverage.heights_m, recall)}" for name, recall in [*rows, ("  pad", coverage.pad)]
    ]
    if math.isnan(coverage.blind_height_m):
        return [*lines, "blind at every height"]
    low, high = seen_between(coverage.heights_m, coverage.pad, SURE_RECALL)
    between = (coverage.heights_m >= low) & (coverage.heights_m <= high)
    if between.any():
        weakest = np.flatnonzero(between)[int(np.argmin(coverage.pad[between]))]
        lines.append(
            f"weakest in between: {100 * coverage.pad[weakest]:.2f} % at {coverage.heights_m[weakest]:.2g} m"
        )
    return [*lines, f"blind height: {blind_words(coverage)} (there, seen in less than half of the frames)"]


def blind_words(coverage: PredictedRecall) -> str:
    """How low the pad is seen, where a prediction ends before it is blind: less than that."""
    return f"{'less than' if coverage.seen_at_the_lowest else 'below'} {100 * coverage.blind_height_m:.1f} cm"


def _span(heights_m: FloatArray, recall: FloatArray) -> str:
    words = []
    for least in (SURE_RECALL, BLIND_RECALL):
        low, high = seen_between(heights_m, recall, least)
        span = "nowhere" if math.isnan(low) else f"{low:.2g} to {high:.2g} m"
        words.append(f"{100 * least:g} % {span}")
    return ", ".join(words)


def draw_coverage(coverage: PredictedRecall, pad: Pad, camera: CameraConfig, path: Path) -> None:
    """Recall over the height, a line for each group and the pad."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow

    figure = Figure(figsize=(9.0, 4.6), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.plot(coverage.heights_m, 100.0 * coverage.pad, color="0.7", linewidth=5.0, label="pad")
    for group, recall in coverage.groups.items():
        axes.plot(coverage.heights_m, 100.0 * recall, color=GROUP_COLOURS[group], label=NAMES[group])
    if not (math.isnan(coverage.blind_height_m) or coverage.seen_at_the_lowest):
        words = f"blind: {blind_words(coverage)}"
        axes.axvspan(coverage.heights_m[0], coverage.blind_height_m, color="0.9", label=words)
    axes.set_xscale("log")
    axes.set_xticks(TICKS_M, [f"{h:g}" for h in TICKS_M])
    axes.minorticks_off()
    axes.set(xlim=(coverage.heights_m[0], coverage.heights_m[-1]), ylim=(-2.0, 102.0))
    axes.set(xlabel="height of the camera (m)", ylabel="predicted recall (%)")
    axes.set_title(f"{pad.name} seen by {camera.name}")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    save_figure(figure, path)


# ---------------------------------------------------------------- checked, printed or judged

DEFAULT_CAMERA: Final = "sitl_640x480"


def run_pad(
    pad: str,
    output: Path | None,
    paper: Literal[PaperName, "large"] | None,
    *,
    coverage: bool,
    camera: str | None,
    spread: Mapping[str, float],
    single: Mapping[str, object] | None,
) -> None:
    """Check, print or judge; `single` is the marker of a pad that has but one, None: `pad` is a file."""
    prepare_opencv()
    console = Console()
    made = load_pad(pad) if single is None else single_pad(single)
    if paper is not None:
        made = on_paper(made, paper, pad)
    say(console, *summary(made))
    if coverage:
        _judge(made, camera or DEFAULT_CAMERA, replace(HOVER, **spread), output, console)
    elif output is not None:
        if single is not None:
            path = output.with_suffix(".yaml")
            body = yaml.safe_dump(made.model_dump(mode="json", exclude_defaults=True), sort_keys=False)
            write_atomically(path, f"# Written by companion pad single\n{body}")
            say(console, f"{path}: name it in the settings: pad: {path}")
        if single is None or output.suffix.lower() != YAML_SUFFIXES[0]:
            _print(made, output, console)


def single_pad(marker: Mapping[str, object]) -> Pad:
    """One marker in the middle of a board that is as large as its white needs."""
    given = {"dictionary": "apriltag_36h11", "id": 0, "side_m": 0.4, "position_pad_m": (0.0, 0.0), **marker}
    one = validate(Marker, given, "single")
    board_m = math.ceil(1e3 * (one.side_m + 2.0 * one.quiet_m) - 1e-6) / 1e3
    name = f"{one.dictionary}_{one.id}_{1e3 * one.side_m:.0f}"
    data = {"name": name, "width_m": board_m, "length_m": board_m, "markers": [given]}
    return checked(validate(Pad, data, "single"), "single")


def on_paper(pad: Pad, paper: Literal[PaperName, "large"], source: str) -> Pad:
    kept = pad.sheet.model_dump(exclude={"size_m"})
    sheet = validate(Sheet, {**kept, "paper": paper}, f"{source}: sheet")
    return checked(pad.model_copy(update={"sheet": sheet}), f"{source} on {paper}")


def summary(pad: Pad) -> list[str]:
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
        say(console, f"{path}{resolution}")
    say(console, "print at 100 %, and hold a ruler against the one on the sheet")


def _judge(pad: Pad, camera_name: str, spread: HoverSpread, output: Path | None, console: Console) -> None:
    if output is not None and (output.suffix.lower() != ".png" or not output.parent.is_dir()):
        raise ConfigError(f"-o {output}: expected a .png file in an existing folder")
    camera = load_model(CameraConfig, find_file("cameras", camera_name))
    console.print(coverage_table(predict(pad, camera, spread, np.array(TABLE_HEIGHTS_M))))
    everywhere = predict(pad, camera, spread)
    say(console, f"{camera.name}, {spread.words}:", *coverage_lines(everywhere))
    if output is not None:
        draw_coverage(everywhere, pad, camera, output)
        say(console, f"picture: {output}")
