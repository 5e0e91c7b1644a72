"""Boards: the print is what OpenCV looks for, at its true size."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.camera.board import (
    CalibrationBoard,
    board_yaml,
    pattern_corner_mm,
    read_dictionary,
    sheet_mm,
    write_board,
)
from calibration.camera.capture import CaptureSession, CaptureStep
from calibration.camera.encoding import measure_encoding
from calibration.camera.views import BoardFinder, BoardView
from companion.base.encoding import Encoding, grey_of_light, light_of_greys
from companion.base.geometry import FloatArray
from companion.base.printing.paper import PaperName
from companion.config import CONFIG_FOLDER, CameraConfig, ConfigError, find_file, load_model, validate
from tests.printed_pages import read_pdf
from tests.unit.calibration.camera.board_pictures import (
    BLACK,
    WHITE,
    BoardPainter,
    BoardPose,
    ideal_view,
    tour_poses,
)

CHARUCO = CalibrationBoard(columns=7, rows=5, square_m=0.034, marker_m=0.025)
LEGACY = CalibrationBoard(columns=5, rows=6, square_m=0.03, marker_m=0.02, legacy_pattern=True)
GRID = CalibrationBoard(pattern="grid", columns=4, rows=3, marker_m=0.04, gap_m=0.01, dictionary="6x6_250")
CHESSBOARD = CalibrationBoard(pattern="chessboard", columns=8, rows=5, square_m=0.025)


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


@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
def test_the_print_has_its_true_size(paper: PaperName, tmp_path: Path) -> None:
    written = write_board(CHARUCO, tmp_path / "board.pdf", paper)
    assert [path.name for path in written] == ["board.pdf", "board.png", "board.yaml"]
    [page] = read_pdf(written[0])
    page_mm, corners_mm = page.size_mm, np.concatenate(page.filled)
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


# ----------------
# The pictures that camera calibration is tested with are true: edges are where the projection has them.

HD = load_model(CameraConfig, find_file("cameras", "hd_1280x720"))
# markers far apart, so that each can be looked at alone
MARKERS = CalibrationBoard(pattern="grid", columns=2, rows=2, marker_m=0.06, gap_m=0.06, square_m=0.06)


def area_and_moment(painter: BoardPainter, edges: tuple[float, ...], pose: BoardPose) -> FloatArray:
    """Area of a rectangle's image, and that times its centre: (3,). Its outline is followed in fine steps."""
    left, top, right, bottom = edges
    line = np.linspace(0.0, 1.0, 100, endpoint=False)
    x = np.concatenate(
        (left + (right - left) * line, 0 * line + right, right - (right - left) * line, 0 * line + left)
    )
    y = np.concatenate(
        (0 * line + top, top + (bottom - top) * line, 0 * line + bottom, bottom - (bottom - top) * line)
    )
    u, v = painter.project(np.column_stack((x, y, 0 * x)), pose).T
    cross = u * np.roll(v, -1) - np.roll(u, -1) * v
    moments = [((w + np.roll(w, -1)) * cross).sum() / 6.0 for w in (u, v)]
    return np.array([0.5 * cross.sum(), *moments])


@pytest.mark.parametrize("bow_m", [0.0, 0.003])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.1), (0.6, 0.1, 0.3), (-0.2, 0.7, -0.4)])
def test_each_marker_s_centre_of_area_is_where_the_projection_has_it(
    tilt: tuple[float, float, float], bow_m: float
) -> None:
    painter = BoardPainter(MARKERS, HD, bow_m)
    rotation = np.asarray(cv2.Rodrigues(np.array(tilt))[0])
    pose = BoardPose(np.array(tilt), np.array((0.08, -0.03, 0.5)) - rotation @ np.array((0.09, 0.09, 0.0)))
    image = painter.take(pose, np.random.default_rng(0), defocus_px=0.5, motion_px=(1.5, -1.0))
    dark = (WHITE - image.astype(float)) / (WHITE - BLACK)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        corner = np.array((0.12 * column, 0.12 * row))
        own = [
            edges
            for edges in MARKERS.black_rectangles()
            if 0 <= edges[0] - corner[0] + 1e-6 < 0.06 and 0 <= edges[1] - corner[1] + 1e-6 < 0.06
        ]
        area, *moment = np.sum([area_and_moment(painter, edges, pose) for edges in own], axis=0)
        reach = np.array([(-0.02, -0.02, 0), (0.08, -0.02, 0), (0.08, 0.08, 0), (-0.02, 0.08, 0)])
        outline = painter.project(reach + np.array((*corner, 0.0)), pose)
        mask = cv2.fillPoly(np.zeros(image.shape, np.uint8), [np.rint(outline).astype(np.int32)], 1)
        v, u = np.nonzero(np.asarray(mask))
        weight = dark[v, u]
        assert weight.sum() == pytest.approx(area, rel=0.005)
        found = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        assert np.abs(found - np.array(moment) / area).max() < 0.02


# ---------------- Which frames are kept: sharp, still and new; and what is said of the others

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
BOARD = load_model(CalibrationBoard, find_file("boards", "charuco_a4"))
PERIOD_S = 1.0 / 30.0
PAINTER = BoardPainter(BOARD, CAMERA)
MIDDLE = BoardPose(np.array((0.3, 0.0, 0.0)), np.array((-0.12, -0.08, 0.45)))


def seen(pose: BoardPose, right_px: float = 0.0) -> BoardView:
    view = ideal_view(PAINTER, pose, np.random.default_rng(0), 0.03, "")
    return replace(view, corners_px=view.corners_px + np.array((right_px, 0.0)))


def stepped(
    session: CaptureSession, views: list[BoardView | None], start_s: float = 0.0
) -> list[CaptureStep]:
    return [session.step(start_s + PERIOD_S * k, view) for k, view in enumerate(views)]


def test_a_board_that_is_still_is_kept_once() -> None:
    session = CaptureSession((640, 480))
    steps = stepped(session, [seen(MIDDLE)] * 30)
    assert [step.kept for step in steps].count(True) == len(session.views) == 1
    assert not any(step.kept for step in steps[:3])
    assert steps[0].text == "hold it still"
    assert steps[-1].text == "show it at the upper left of the image"


@pytest.mark.parametrize(("px_a_frame", "kept"), [(0.2, True), (0.6, False)])
def test_a_board_that_moves_is_not_kept(px_a_frame: float, kept: bool) -> None:
    session = CaptureSession((640, 480))
    steps = stepped(session, [seen(MIDDLE, px_a_frame * k) for k in range(10)])
    assert any(step.kept for step in steps) is kept


def test_a_blurred_view_is_not_kept_unless_the_lens_makes_no_sharper_ones() -> None:
    sharp, soft = replace(seen(MIDDLE), edge_px=2.2), replace(seen(MIDDLE), edge_px=5.0)
    session = CaptureSession((640, 480))
    assert not any(s.kept for s in stepped(session, [sharp, *[soft] * 10]))
    assert "blurred" in session.step(1.0, soft).text
    assert any(s.kept for s in stepped(CaptureSession((640, 480)), [soft] * 10))


def test_out_of_sight_it_has_to_be_still_anew() -> None:
    session = CaptureSession((640, 480))
    steps = stepped(session, [seen(MIDDLE)] * 3 + [None] + [seen(MIDDLE)] * 3)
    assert steps[3].text == "no board in sight"
    assert not any(step.kept for step in steps)


def test_it_is_complete_when_all_has_been_seen() -> None:
    session = CaptureSession((640, 480))
    for number, pose in enumerate(tour_poses(BOARD, CAMERA, width_share=0.55) * 2):
        right_px = 30.0 if number >= 15 else 0.0
        stepped(session, [seen(pose, right_px)] * 8, start_s=10.0 * number)
    assert session.coverage.missing_tilts == []
    assert session.coverage.missing_corners == []
    assert session.coverage.complete
    assert session.hint() == "all has been seen"


def test_the_edge_s_width_tells_a_blurred_picture() -> None:
    rng = np.random.default_rng(2)
    finder = BoardFinder(BOARD)
    widths = []
    for blur_px in (0.4, 0.8, 1.3):
        view = finder.find(PAINTER.take(MIDDLE, rng, noise_grey=2.0, defocus_px=blur_px))
        assert view is not None
        widths.append(view.edge_px)
    assert 1.8 < widths[0] < 2.7
    assert widths[0] + 0.3 < widths[1] < widths[2] - 0.3


# ---------------- The encoding that the board's edges tell

CURVED_BOARD = CalibrationBoard(
    pattern="charuco", columns=7, rows=5, square_m=0.034, marker_m=0.025, dictionary="5x5_100"
)
CURVED_CAMERA = CameraConfig(
    name="test", width_px=640, height_px=480, rate_hz=30.0, fx_px=620.0, fy_px=620.0, cx_px=320.0,
    cy_px=240.0,
    distortion=(0.05, -0.1, 0.0, 0.0, 0.0),
)  # fmt: skip
VIEWS = 6


@pytest.fixture(scope="module")
def light() -> list[NDArray[np.float64]]:
    """What the lens shows: 0..1."""
    rng, painter = np.random.default_rng(4), BoardPainter(CURVED_BOARD, CURVED_CAMERA)
    pictures = []
    for _ in range(VIEWS):
        turn = np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.3, 0.3)])
        place = np.array([-0.119 + rng.uniform(-0.02, 0.02), -0.085 + rng.uniform(-0.02, 0.02), 0.28])
        pictures.append(painter.take(BoardPose(turn, place), rng, defocus_px=0.6) / 255.0)
    return pictures


def pixels_of(light: list[NDArray[np.float64]], encoding: Encoding) -> list[NDArray[np.float64]]:
    rng, finder = np.random.default_rng(5), BoardFinder(CURVED_BOARD)
    found = []
    for each in light:
        grey = grey_of_light(encoding, 0.9 * each) + rng.normal(0.0, 2.0, each.shape)
        view = finder.find(np.rint(grey).clip(0, 255).astype(np.uint8))
        assert view is not None
        found.append(view.edges)
    return found


@pytest.mark.parametrize("encoding", ["srgb", "linear"])
def test_an_encoding_with_a_name_is_told_by_it(light: list[NDArray[np.float64]], encoding: Encoding) -> None:
    measured = measure_encoding(pixels_of(light, encoding))
    assert measured is not None
    assert measured.encoding == encoding


def test_another_one_is_told_as_a_table(light: list[NDArray[np.float64]]) -> None:
    true = light_of_greys("srgb") ** 1.6
    measured = measure_encoding(pixels_of(light, tuple(true.tolist())))
    assert measured is not None
    assert measured.power == pytest.approx(1.6, abs=max(0.05, 3.0 * measured.power_std))
    assert not isinstance(measured.encoding, str)
    assert light_of_greys(measured.encoding) == pytest.approx(true, abs=0.03)


def test_few_views_tell_nothing(light: list[NDArray[np.float64]]) -> None:
    assert measure_encoding(pixels_of(light[:2], "srgb")) is None
    assert measure_encoding([np.empty((0, 4))] * 9) is None
