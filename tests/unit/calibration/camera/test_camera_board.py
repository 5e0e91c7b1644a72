"""Boards: the print is what OpenCV looks for, at its true size."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera.board import (
    CalibrationBoard,
    board_yaml,
    pattern_corner_mm,
    read_dictionary,
    sheet_mm,
    write_board,
)
from calibration.camera.views import BoardFinder
from companion.base.printing.paper import PaperName
from companion.config import CONFIG_FOLDER, ConfigError, load_model, validate

CHARUCO = CalibrationBoard(columns=7, rows=5, square_m=0.034, marker_m=0.025)
LEGACY = CalibrationBoard(columns=5, rows=6, square_m=0.03, marker_m=0.02, legacy_pattern=True)
GRID = CalibrationBoard(pattern="grid", columns=4, rows=3, marker_m=0.04, gap_m=0.01, dictionary="6x6_250")
CHESSBOARD = CalibrationBoard(pattern="chessboard", columns=8, rows=5, square_m=0.025)
MM_PER_POINT = 25.4 / 72.0


def painted(board: CalibrationBoard, per_m: float) -> np.ndarray:
    """The board's black rectangles, a margin of 40 px around."""
    width, height = (round(side * per_m) + 80 for side in board.size_m)
    image = np.full((height, width), 255, np.uint8)
    for edges in board.black_rectangles():
        left, top, right, bottom = (round(edge * per_m) + 40 for edge in edges)
        image[top:bottom, left:right] = 0
    return image


@pytest.mark.parametrize("board", [CHARUCO, LEGACY, GRID, CHESSBOARD], ids=lambda b: b.text)
def test_every_point_of_the_print_is_found_where_the_board_has_it(board: CalibrationBoard) -> None:
    per_m = 4000.0
    view = BoardFinder(board).find(painted(board, per_m))
    assert view is not None
    assert len(view.ids) == board.corner_count == len(board.points_m)
    # an edge lies between two pixels, whose centres are whole numbers
    expected = board.points_m[view.ids][:, :2] * per_m + 40 - 0.5
    # a marker's corners are found less well than those between squares
    assert np.abs(view.corners_px - expected).max() < (0.7 if board.pattern == "grid" else 0.05)


@pytest.mark.parametrize("board", [CHARUCO, LEGACY], ids=lambda b: b.text)
def test_the_print_is_opencv_s_own(board: CalibrationBoard) -> None:
    cells = round(7000 * board.square_m)  # so that a marker's cells are whole pixels
    size = (cells * board.columns, cells * board.rows)
    theirs = board.charuco.generateImage(size)
    ours = painted(board, cells / board.square_m)[40:-40, 40:-40]
    assert np.mean((np.asarray(theirs) > 127) != (ours > 127)) < 0.02


def test_a_board_s_file_gives_the_board_again(tmp_path: Path) -> None:
    for board in (CHARUCO, LEGACY, GRID, CHESSBOARD):
        path = tmp_path / "board.yaml"
        path.write_text(board_yaml(board))
        again = load_model(CalibrationBoard, path)
        assert again.text == board.text
        assert again.black_rectangles() == board.black_rectangles()


def test_every_shipped_board_can_be_loaded() -> None:
    for path in (CONFIG_FOLDER / "boards").glob("*.yaml"):
        assert load_model(CalibrationBoard, path).corner_count > 10


@pytest.mark.parametrize("named", ["5x5_100", "DICT_5X5_100", "apriltag_36h11"])
def test_a_dictionary_has_opencv_s_name(named: str) -> None:
    assert read_dictionary(named) == named.lower().removeprefix("dict_")


def test_a_dictionary_of_one_s_own_is_read_and_travels_with_the_board(tmp_path: Path) -> None:
    whole = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    lines = [f'marker_{k}: "{bits_of(whole, k)}"' for k in range(20)]
    path = tmp_path / "mine.yml"
    path.write_text("\n".join(["nmarkers: 20", "markersize: 4", *lines]))
    own = CalibrationBoard(
        columns=6, rows=5, square_m=0.03, marker_m=0.02, dictionary=read_dictionary(str(path))
    )
    usual = CalibrationBoard(columns=6, rows=5, square_m=0.03, marker_m=0.02, dictionary="4x4_50")
    assert own.black_rectangles() == usual.black_rectangles()
    (tmp_path / "board.yaml").write_text(board_yaml(own))
    assert load_model(CalibrationBoard, tmp_path / "board.yaml") == own


def bits_of(dictionary: cv2.aruco.Dictionary, number: int) -> str:
    image = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, 6))[1:-1, 1:-1]
    return "".join("1" if value > 127 else "0" for value in image.ravel())


@pytest.mark.parametrize(
    ("words", "told"),
    [("9x9_1", "expected a file"), ("nowhere.yml", "No such file"), ("broken.yml", "expected OpenCV's form")],
)
def test_what_is_no_dictionary_is_reported(words: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "broken.yml").write_text("nmarkers: 2\nmarkersize: 4\nmarker_0: '01'\n")
    with pytest.raises(ConfigError, match=told):
        read_dictionary(words if "." not in words else str(tmp_path / words))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"marker_m": 0.04}, "which it lies in"),
        ({"dictionary": "4x4_51"}, "dictionary '4x4_51'"),
        ({"columns": 30, "rows": 30}, "expected at least 450"),
        ({"colour": "red"}, "unknown key 'colour'"),
    ],
)
def test_a_board_that_cannot_be_is_refused(change: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        validate(CalibrationBoard, {**CHARUCO.model_dump(), **change}, "board.yaml")


# ---------------------------------------------------------------- print


def pdf_numbers(path: Path) -> tuple[tuple[float, float], np.ndarray]:
    """A PDF's page (mm), and the corners (n, 2) (mm) of the first filled shape on it."""
    data = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", data)
    assert box is not None
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
    page = next(text for text in map(inflated, streams) if b" l\n" in text)
    # of several shapes the board is the one with the most corners
    shapes = re.split(rb"\n(?:f|S|s|b|B|n|W n)\b", page)
    board = max(shapes, key=lambda shape: shape.count(b" l\n"))
    places = re.findall(rb"([-\d.]+) ([-\d.]+) [ml]\n", board)
    page_mm = (float(box[1]) * MM_PER_POINT, float(box[2]) * MM_PER_POINT)
    return page_mm, np.array(places, dtype=float) * MM_PER_POINT


def inflated(stream: bytes) -> bytes:
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return b""


@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
def test_the_print_has_its_true_size(paper: PaperName, tmp_path: Path) -> None:
    written = write_board(CHARUCO, tmp_path / "board.pdf", paper)
    assert [path.name for path in written] == ["board.pdf", "board.png", "board.yaml"]
    page_mm, corners_mm = pdf_numbers(written[0])
    assert page_mm == pytest.approx(sheet_mm(CHARUCO, paper), abs=0.01)
    left, top = pattern_corner_mm(CHARUCO, page_mm)
    edges = 1e3 * np.array(CHARUCO.black_rectangles())
    expected = np.unique(np.round(np.concatenate((edges[:, 0], edges[:, 2])) + left, 2))
    assert np.unique(np.round(corners_mm[:, 0], 2)) == pytest.approx(expected, abs=0.02)
    assert np.ptp(corners_mm, axis=0) == pytest.approx((238.0, 170.0), abs=0.01)
    assert corners_mm[:, 1].max() == pytest.approx(top, abs=0.01)
    # 300 dots an inch
    image = cv2.imread(str(written[1]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    assert np.array(image.shape[::-1]) / 300 * 25.4 == pytest.approx(page_mm, abs=0.1)
    assert load_model(CalibrationBoard, written[2]).text == CHARUCO.text


def test_a_board_that_does_not_fit_the_paper_is_refused(tmp_path: Path) -> None:
    wide = CalibrationBoard(columns=9, rows=6, square_m=0.04, marker_m=0.03)
    with pytest.raises(ConfigError, match=r"360x240 mm does not fit; expected 277x176"):
        write_board(wide, tmp_path / "board.pdf", "a4")
    assert list(tmp_path.iterdir()) == []
    assert sheet_mm(wide, "a3") == (420.0, 297.0)
