"""The calibration board as data: what is printed, sought in images and calibrated against is one file.

Board frame: origin at the top left corner of the pattern as one reads it, x to the right, y down, z into the
board (so that the frame is right-handed and a board before the camera has its z away from it); metres.

A board's file holds the fields of `CalibrationBoard`; `calibrate-camera --make-board` writes it beside the
print.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from pydantic import Field, model_validator

from calibration.camera.board.surface import Surface
from calibration.camera.kinds import Pattern
from companion.base.geometry import FloatArray
from companion.base.printing.page import Rectangle, code_rectangles
from companion.config import ConfigError, StrictModel

# OpenCV has some names twice, in capitals and not
DICTIONARIES: Final = {
    name.removeprefix("DICT_").lower(): int(getattr(cv2.aruco, name))
    for name in dir(cv2.aruco)
    if name.startswith("DICT_")
}


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
        """How many codes are on it."""
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
        """Width and height of the pattern."""
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
        """As OpenCV has it."""
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
