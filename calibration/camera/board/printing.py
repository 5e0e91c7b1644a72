"""The board on paper at its true size: a PDF (and PNG) with a ruler to check the print by.

Coordinates on the sheet are millimetres from its lower left corner, as PDF has them.
"""

from __future__ import annotations

from pathlib import Path

from calibration.camera.board.board import CalibrationBoard
from companion.base.files import write_atomically
from companion.base.printing.page import RULER_MM, Page, save
from companion.base.printing.paper import FOOT_MM, MARGIN_MM, PAPERS_MM, PaperName
from companion.config import ConfigError


def sheet_mm(board: CalibrationBoard, paper: PaperName) -> tuple[float, float]:
    """Width and height of the sheet, turned so that the board fits.

    Raises:
        ConfigError: it fits neither way.
    """
    short, long = PAPERS_MM[paper]
    width, height = (1e3 * side for side in board.size_m)
    for sheet in ((long, short), (short, long)):
        if width <= sheet[0] - 2 * MARGIN_MM and height <= sheet[1] - 2 * MARGIN_MM - FOOT_MM:
            return sheet
    raise ConfigError(
        f"--paper {paper}: a board of {width:g}x{height:g} mm does not fit; expected "
        f"{long - 2 * MARGIN_MM:g}x{short - 2 * MARGIN_MM - FOOT_MM:g} mm or less, or a larger paper"
    )


def write_board(board: CalibrationBoard, path: Path, paper: PaperName) -> list[Path]:
    """Write the PDF, and beside it the PNG and the board's own file; returns what was written.

    Raises:
        ConfigError: it does not fit the paper, or a file cannot be written.
    """
    sheet = sheet_mm(board, paper)
    page = _draw(board, sheet)
    written = [name for kind in (".pdf", ".png") for name in save([page], path.with_suffix(kind))]
    own = path.with_suffix(".yaml")
    write_atomically(own, board_yaml(board))
    return [*written, own]


def board_yaml(board: CalibrationBoard) -> str:
    """The board's own file, which is given to the calibration."""
    import yaml  # noqa: PLC0415

    unused = {"charuco": {"gap_m"}, "grid": {"square_m", "legacy_pattern"}}.get(
        board.pattern, {"marker_m", "gap_m", "dictionary", "legacy_pattern"}
    )
    text = yaml.safe_dump(board.model_dump(mode="json", exclude=unused), sort_keys=False)
    return f"# {board.text}\n{text}"


def _draw(board: CalibrationBoard, sheet: tuple[float, float]) -> Page:
    page = Page(*sheet)
    left, top = pattern_corner_mm(board, sheet)
    outlines = []
    for x0, y0, x1, y1 in board.black_rectangles():
        a, b, c, d = left + 1e3 * x0, top - 1e3 * y0, left + 1e3 * x1, top - 1e3 * y1
        outlines.append([(a, b), (c, b), (c, d), (a, d)])
    page.fill(outlines)
    page.ruler(0.5 * (sheet[0] - RULER_MM), MARGIN_MM)
    caption = f"{board.text}.  Print at 100 %: the ruler is {RULER_MM} mm long.  Glue it to something flat."
    page.text((0.5 * sheet[0], MARGIN_MM - 1.5), caption, 6)
    return page


def pattern_corner_mm(board: CalibrationBoard, sheet: tuple[float, float]) -> tuple[float, float]:
    """Where the pattern's top left corner is on the sheet."""
    width, height = (1e3 * side for side in board.size_m)
    return 0.5 * (sheet[0] - width), 0.5 * (sheet[1] + FOOT_MM + height)
