"""The board on paper at its true size: a PDF (and PNG) with a ruler to check the print by.

Coordinates on the sheet are millimetres from its lower left corner, as PDF has them.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

from calibration.camera.board import Board
from companion.config import ConfigError
from companion.files import write_atomically

# width and height upright (mm)
PAPERS: Final = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
# no printer reaches the very edge; the pattern needs white around it as well
QUIET_MM: Final = 10.0
# below the pattern, for the ruler and what is written
FOOT_MM: Final = 14.0
RULER_MM: Final = 100
MM_PER_INCH: Final = 25.4
PNG_DPI: Final = 300


def sheet_mm(board: Board, paper: str) -> tuple[float, float]:
    """Width and height of the sheet, turned so that the board fits.

    Raises:
        ConfigError: it fits neither way.
    """
    short, long = PAPERS[paper]
    width, height = (1e3 * side for side in board.size_m)
    for sheet in ((long, short), (short, long)):
        if width <= sheet[0] - 2 * QUIET_MM and height <= sheet[1] - 2 * QUIET_MM - FOOT_MM:
            return sheet
    raise ConfigError(
        f"--paper {paper}: a board of {width:g}x{height:g} mm does not fit; expected "
        f"{long - 2 * QUIET_MM:g}x{short - 2 * QUIET_MM - FOOT_MM:g} mm or less, or a larger paper"
    )


def write_board(board: Board, path: Path, paper: str) -> list[Path]:
    """Write the PDF, and beside it the PNG and the board's own file; returns what was written.

    Raises:
        ConfigError: it does not fit the paper, or a file cannot be written.
    """
    sheet = sheet_mm(board, paper)
    figure = _draw(board, sheet)
    written = []
    for kind in ("pdf", "png"):
        data = io.BytesIO()
        # no date: the same board gives the same file
        metadata = {"CreationDate": None} if kind == "pdf" else None
        figure.savefig(data, format=kind, dpi=PNG_DPI, metadata=metadata)
        written.append(_write(path.with_suffix(f".{kind}"), data.getvalue()))
    own = path.with_suffix(".yaml")
    write_atomically(own, board_yaml(board))
    return [*written, own]


def board_yaml(board: Board) -> str:
    """The board's own file, which is given to the calibration."""
    import yaml  # noqa: PLC0415

    unused = {"charuco": {"gap_m"}, "grid": {"square_m", "legacy_pattern"}}.get(
        board.pattern, {"marker_m", "gap_m", "dictionary", "legacy_pattern"}
    )
    text = yaml.safe_dump(board.model_dump(mode="json", exclude=unused), sort_keys=False)
    return f"# {board.text}\n{text}"


def _write(path: Path, data: bytes) -> Path:
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def _draw(board: Board, sheet: tuple[float, float]) -> Any:
    """A figure of the sheet's size whose data coordinates are millimetres on it."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow
    from matplotlib.patches import PathPatch  # noqa: PLC0415
    from matplotlib.path import Path as Outline  # noqa: PLC0415

    figure = Figure(figsize=(sheet[0] / MM_PER_INCH, sheet[1] / MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, sheet[0]), ylim=(0.0, sheet[1]))
    axes.axis("off")
    left, top = pattern_corner_mm(board, sheet)
    outlines = []
    for x0, y0, x1, y1 in board.black_rectangles():
        a, b, c, d = left + 1e3 * x0, top - 1e3 * y0, left + 1e3 * x1, top - 1e3 * y1
        outlines.append(Outline([(a, b), (c, b), (c, d), (a, d), (a, b)], closed=True))
    # one shape: between two, a viewer may show a hairline
    whole = PathPatch(Outline.make_compound_path(*outlines), facecolor="black", edgecolor="none")
    whole.set_snap(False)
    axes.add_patch(whole)
    _foot(axes, board, sheet)
    return figure


def pattern_corner_mm(board: Board, sheet: tuple[float, float]) -> tuple[float, float]:
    """Where the pattern's top left corner is on the sheet."""
    width, height = (1e3 * side for side in board.size_m)
    return 0.5 * (sheet[0] - width), 0.5 * (sheet[1] + FOOT_MM + height)


def _foot(axes: Any, board: Board, sheet: tuple[float, float]) -> None:
    left = 0.5 * (sheet[0] - RULER_MM)
    foot = QUIET_MM
    axes.plot((left, left + RULER_MM), (foot, foot), color="black", linewidth=0.5)
    for mm in range(RULER_MM + 1):
        length = 4.0 if mm % 10 == 0 else 2.0
        axes.plot((left + mm, left + mm), (foot, foot + length), color="black", linewidth=0.3)
        if mm % 10 == 0:
            axes.text(left + mm, foot + 4.5, f"{mm}", fontsize=5, ha="center", va="bottom")
    told = f"{board.text}.  Print at 100 %: the ruler is {RULER_MM} mm long.  Glue it to something flat."
    axes.text(0.5 * sheet[0], foot - 1.5, told, fontsize=6, ha="center", va="top")
