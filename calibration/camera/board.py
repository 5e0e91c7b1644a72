"""The calibration board as data: what is printed, sought in images and calibrated against is one file.

Board frame: origin at the top left corner of the pattern as one reads it, x to the right, y down, z into the
board (so that the frame is right-handed and a board before the camera has its z away from it); metres.

A board's file holds the fields of `CalibrationBoard`; `calibrate-camera --make-board` writes it beside the
print.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from pydantic import Field, model_validator

from calibration.camera import Pattern
from companion.base.files import write_atomically
from companion.base.geometry import FloatArray
from companion.base.printing.page import RULER_MM, Page, Rectangle, code_rectangles, save
from companion.base.printing.paper import FOOT_MM, MARGIN_MM, PAPERS_MM, PaperName
from companion.config import ConfigError, StrictModel
from companion.pad import DICTIONARIES


class Codes(StrictModel):
    """A dictionary of one's own: each code's bits row by row, 1 is white."""

    bits: int = Field(ge=3, le=9)  # along a side
    codes: tuple[str, ...] = Field(min_length=1)
    correctable_bits: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _codes_are_bits(self) -> Codes:
        for number, code in enumerate(self.codes):
            if len(code) != self.bits**2 or set(code) - {"0", "1"}:
                raise ValueError(f"code {number}: expected {self.bits**2} times 0 or 1, found '{code}'")
        return self


class CalibrationBoard(StrictModel):
    """A flat board to be shown to the camera.

    `columns` and `rows` count squares of a ChArUco board, markers of a grid, and inner corners (where four
    squares meet, as OpenCV counts) of a plain chessboard.
    """

    pattern: Pattern = "charuco"
    columns: int = Field(ge=2, le=60)
    rows: int = Field(ge=2, le=60)
    square_m: float = Field(default=0.03, gt=0.001, le=2.0)  # of ChArUco and chessboard
    marker_m: float = Field(default=0.022, gt=0.001, le=2.0)  # of ChArUco and grid
    gap_m: float = Field(default=0.01, gt=0.0, le=2.0)  # between a grid's markers
    dictionary: str | Codes = "5x5_100"
    legacy_pattern: bool = False  # ChArUco as OpenCV drew it before 4.6: with even rows, white at top left

    @model_validator(mode="after")
    def _can_be(self) -> CalibrationBoard:
        if self.pattern == "charuco" and not self.marker_m < self.square_m:
            raise ValueError(
                f"marker_m {self.marker_m:g}: expected less than square_m {self.square_m:g}, which it lies in"
            )
        if isinstance(self.dictionary, str) and self.dictionary not in DICTIONARIES:
            raise ValueError(
                f"dictionary '{self.dictionary}': expected one of {', '.join(sorted(DICTIONARIES))}"
            )
        if self.marker_count > (there := len(self.whole_dictionary().bytesList)):
            raise ValueError(f"dictionary of {there} codes: expected at least {self.marker_count}")
        return self

    @property
    def marker_count(self) -> int:
        cells = self.columns * self.rows
        return {"charuco": cells // 2, "grid": cells, "chessboard": 0}[self.pattern]

    @property
    def corner_count(self) -> int:
        """How many points a whole view of it gives."""
        inner = (self.columns - 1) * (self.rows - 1)
        return {
            "charuco": inner,
            "grid": 4 * self.columns * self.rows,
            "chessboard": self.columns * self.rows,
        }[self.pattern]

    @property
    def size_m(self) -> tuple[float, float]:
        if self.pattern == "grid":
            pitch = self.marker_m + self.gap_m
            return self.columns * pitch - self.gap_m, self.rows * pitch - self.gap_m
        more = 1 if self.pattern == "chessboard" else 0
        return (self.columns + more) * self.square_m, (self.rows + more) * self.square_m

    @property
    def surface(self) -> Surface:
        """The pattern as it is specified, for the calibration to start from."""
        marker = (self.marker_m, self.marker_m + self.gap_m) if self.pattern == "grid" else None
        return Surface(self.size_m, marker)

    @property
    def text(self) -> str:
        """The board in a few words, as it is printed on the board itself."""
        words = f"{self.pattern} {self.columns}x{self.rows}"
        if self.pattern != "grid":
            words += f", square {1e3 * self.square_m:g} mm"
        if self.pattern != "chessboard":
            name = self.dictionary if isinstance(self.dictionary, str) else "of its own"
            words += f", marker {1e3 * self.marker_m:g} mm, dictionary {name}"
        if self.pattern == "grid":
            words += f", gap {1e3 * self.gap_m:g} mm"
        return words + (", legacy pattern" if self.legacy_pattern else "")

    @cached_property
    def _codes(self) -> cv2.aruco.Dictionary:
        """Cut to the codes that are on the board: a long dictionary is slow to search."""
        whole = self.whole_dictionary()
        return cv2.aruco.Dictionary(
            whole.bytesList[: self.marker_count], whole.markerSize, whole.maxCorrectionBits
        )

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """As OpenCV has it."""
        made = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self._codes)
        made.setLegacyPattern(self.legacy_pattern)
        return made

    @cached_property
    def grid(self) -> cv2.aruco.GridBoard:
        return cv2.aruco.GridBoard((self.columns, self.rows), self.marker_m, self.gap_m, self._codes)

    @cached_property
    def points_m(self) -> FloatArray:
        """All points (n, 3) in the board frame, z = 0, in the order of their ids.

        A grid's point has the id 4 * marker + corner, corners in OpenCV's order.
        """
        if self.pattern == "charuco":
            found: Any = self.charuco.getChessboardCorners()
        elif self.pattern == "grid":
            found = self.grid.getObjPoints()
        else:
            y, x = np.mgrid[1 : self.rows + 1, 1 : self.columns + 1] * self.square_m
            found = np.stack((x, y, np.zeros_like(x)), axis=-1)
        return np.asarray(found, dtype=np.float64).reshape(-1, 3)

    def black_rectangles(self) -> list[Rectangle]:
        """All that is black, as (left, top, right, bottom) in the board frame (m); none overlap."""
        if self.pattern == "grid":
            return [r for quad, i in self._markers(self.grid) for r in self._marker_rectangles(quad, i)]
        side = self.square_m
        columns, rows = (round(size / side) for size in self.size_m)
        squares = [(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2 == 0]
        if self.pattern == "chessboard":
            return [(side * x, side * y, side * (x + 1), side * (y + 1)) for x, y in squares]
        markers = self._markers(self.charuco)
        # the white squares hold the markers; with them, where the black ones are is known
        white = {(int(quad[:, 0].mean() / side), int(quad[:, 1].mean() / side)) for quad, _ in markers}
        black = [(x, y) for y in range(rows) for x in range(columns) if (x, y) not in white]
        return [(side * x, side * y, side * (x + 1), side * (y + 1)) for x, y in black] + [
            r for quad, i in markers for r in self._marker_rectangles(quad, i)
        ]

    def _markers(self, board: cv2.aruco.Board) -> list[tuple[FloatArray, int]]:
        """Corners (4, 2) in the board frame (m) and id of each marker."""
        quads = [np.asarray(q, dtype=np.float64).reshape(4, 3)[:, :2] for q in board.getObjPoints()]
        return list(zip(quads, (int(i) for i in np.asarray(board.getIds()).ravel()), strict=True))

    def _marker_rectangles(self, quad: FloatArray, identity: int) -> list[Rectangle]:
        """A marker's black cells, neighbours in a row as one."""
        (left, top), side = quad.min(axis=0), self.marker_m
        return [
            (left + side * a, top + side * b, left + side * c, top + side * d)
            for a, b, c, d in code_rectangles(self._codes, identity)
        ]

    def whole_dictionary(self) -> cv2.aruco.Dictionary:
        """All the codes there are, on the board or not."""
        if isinstance(self.dictionary, str):
            return cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        side = self.dictionary.bits
        matrices = [
            np.array([int(bit) for bit in code], np.uint8).reshape(side, side)
            for code in self.dictionary.codes
        ]
        lists = np.concatenate([cv2.aruco.Dictionary.getByteListFromBits(m) for m in matrices])
        return cv2.aruco.Dictionary(lists, side, self.dictionary.correctable_bits)


def read_dictionary(words: str) -> str | Codes:
    """A dictionary by OpenCV's name ("5x5_100", "DICT_5X5_100", "apriltag_36h11"), or from its YAML file.

    Raises:
        ConfigError: neither.
    """
    path = Path(words)
    if path.suffix.lower() not in {".yml", ".yaml", ".json", ".xml"}:
        name = words.lower().removeprefix("dict_")
        if name in DICTIONARIES:
            return name
        raise ConfigError(
            f"--dictionary '{words}': expected a file (.yml) or one of {', '.join(sorted(DICTIONARIES))}"
        )
    try:
        return _read_codes(path)
    except (OSError, ValueError, cv2.error, SystemError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not a dictionary"
        raise ConfigError(
            f"{path}: {reason}; expected OpenCV's form: nmarkers, markersize, marker_0, ..."
        ) from error


def _read_codes(path: Path) -> Codes:
    text = path.read_text(encoding="utf-8")
    if not text.startswith(("%YAML", "<", "{")):  # OpenCV knows a YAML file by this line alone
        text = f"%YAML:1.0\n{text}"
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    count, side = (int(storage.getNode(key).real()) for key in ("nmarkers", "markersize"))
    correctable = storage.getNode("maxCorrectionBits")
    codes = tuple(storage.getNode(f"marker_{k}").string() for k in range(count))
    return Codes(
        bits=side, codes=codes, correctable_bits=0 if correctable.empty() else int(correctable.real())
    )


# ---------------------------------------------------------------- surface
# The shape that a printed board really has: what the calibration solves for beside the camera. Pure.
#
# No board is flat. One of A4 that is bowed by half a millimetre makes the focal length wrong by 0.5 %, in the
# same way in every view, so that nothing in the residuals tells. Its bend is therefore solved for: depth
# z = b0 (1 - u²) + b1 (1 - v²) + b2 u v with u, v from -1 to 1 across the board, b in metres.
#
# The markers of a grid are never as large as specified: ink runs, light bleeds into black, the gap was
# measured with a ruler. How much larger each is about its own middle is solved for as well (`spread`, a share
# of its side; the middles stay where they are). Where four squares meet, nothing of the kind can happen.

BEND_COUNT: Final = 3


@dataclass(frozen=True, slots=True)
class Surface:
    """A pattern's size (m), the side and pitch of a grid's markers (m), and how it differs from that.

    `numbers` are the bend's three (m), and for a grid the spread.
    """

    size_m: tuple[float, float]
    marker_m: tuple[float, float] | None = None  # side, and from one marker to the next
    numbers: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.numbers):
            object.__setattr__(self, "numbers", np.zeros(self.count))

    @property
    def count(self) -> int:
        """How many numbers describe it."""
        return BEND_COUNT + (self.marker_m is not None)

    def flat(self) -> Surface:
        return replace(self, numbers=np.zeros(self.count))

    def stepped(self, step: FloatArray) -> Surface:
        return replace(self, numbers=self.numbers + step)

    def of(self, points_m: FloatArray) -> FloatArray:
        """Where points (n, 3) of the board as specified really are."""
        return np.asarray(points_m + self.shapes(points_m) @ self.numbers)

    def shapes(self, points_m: FloatArray) -> FloatArray:
        """How points (n, 3) move for each of the numbers being one: (n, 3, count)."""
        shapes = np.zeros((len(points_m), 3, self.count))
        u, v = (2.0 * points_m[:, k] / self.size_m[k] - 1.0 for k in (0, 1))
        shapes[:, 2, :BEND_COUNT] = _bends(u, v)
        if self.marker_m is not None:
            side, pitch = self.marker_m
            # corners lie on the ends of [k pitch, k pitch + side]: half a gap more is safely within the cell
            cell = np.floor((points_m[:, :2] + 0.5 * (pitch - side)) / pitch)
            shapes[:, :2, BEND_COUNT] = points_m[:, :2] - (cell * pitch + 0.5 * side)
        return shapes

    @property
    def bend_m(self) -> FloatArray:
        return self.numbers[:BEND_COUNT]

    @property
    def spread(self) -> float | None:
        """By what share of their side a grid's markers are larger than specified; None on other boards."""
        return None if self.marker_m is None else float(self.numbers[BEND_COUNT])

    @property
    def gap_m(self) -> float | None:
        """Between markers, if these have the side that was specified: what a ruler should have shown."""
        if self.marker_m is None or self.spread is None:
            return None
        side, pitch = self.marker_m
        return pitch / (1.0 + self.spread) - side

    @property
    def bow_m(self) -> float:
        """How far the surface is from its mean plane at most."""
        line = np.linspace(-1.0, 1.0, 9)
        u, v = (grid.ravel() for grid in np.meshgrid(line, line))
        depth = _bends(u, v) @ self.bend_m
        plane = np.column_stack((u, v, np.ones_like(u)))
        return float(np.abs(depth - plane @ np.linalg.lstsq(plane, depth, rcond=None)[0]).max())


def _bends(u: FloatArray, v: FloatArray) -> FloatArray:
    return np.column_stack((1.0 - u * u, 1.0 - v * v, u * v))


# ---------------------------------------------------------------- printing
# Coordinates on the sheet are millimetres from its lower left corner, as PDF has them.


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
    """Write the PDF, and beside it the PNG and the board's own file; returns what was written."""
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
    width, height = (1e3 * side for side in board.size_m)
    return 0.5 * (sheet[0] - width), 0.5 * (sheet[1] + FOOT_MM + height)
