"""A board that is not the one described: what is told; and photos that are not all as they should be."""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pytest

from calibration.camera.board import CalibrationBoard
from calibration.camera.gathering import hint, views_of_photos, what_is_seen
from calibration.camera.job import summary_lines
from calibration.camera.quality import assess
from calibration.camera.views import BoardFinder, on_a_plane
from companion.config import CameraConfig, ConfigError, find_file, load_model
from companion.sense.camera.photos import photo_paths, read_photos
from tests.unit.calibration.camera.board_pictures import BoardPainter, hand_held_poses, ideal_view, tour_poses

CAMERA = load_model(CameraConfig, find_file("cameras", "sitl_640x480"))
SIZE = (CAMERA.width_px, CAMERA.height_px)
CHARUCO = CalibrationBoard(columns=7, rows=6, square_m=0.03, marker_m=0.022, dictionary="4x4_50")
GRID = CalibrationBoard(pattern="grid", columns=4, rows=5, marker_m=0.0375, gap_m=0.005, dictionary="6x6_250")
CHESSBOARD = CalibrationBoard(pattern="chessboard", columns=9, rows=6, square_m=0.025)


def changed(board: CalibrationBoard, **changes: object) -> CalibrationBoard:
    return CalibrationBoard.model_validate({**board.model_dump(), **changes})


def pictures(board: CalibrationBoard) -> list[np.ndarray]:
    """Three of the board, all of it in view."""
    painter, rng = BoardPainter(board, CAMERA), np.random.default_rng(4)
    poses = tour_poses(board, CAMERA, 15.0, width_share=0.6)
    return [painter.take(poses[k], rng, noise_grey=2.0, defocus_px=0.5) for k in (7, 4, 10)]


@pytest.fixture(scope="module")
def shown() -> dict[str, list[np.ndarray]]:
    boards = {
        "new": CHARUCO,
        "legacy": changed(CHARUCO, legacy_pattern=True),
        "grid": GRID,
        "chessboard": CHESSBOARD,
    }
    return {name: pictures(board) for name, board in boards.items()}


@pytest.mark.parametrize(
    ("there", "described", "says"),
    [
        ("legacy", CHARUCO, "found it with --legacy-pattern in 3 of 3"),
        ("new", changed(CHARUCO, legacy_pattern=True), "found it with no --legacy-pattern in 3 of 3"),
        ("new", changed(CHARUCO, columns=6, rows=7), "found it with --board 7x6 in 3 of 3"),
        ("new", changed(CHARUCO, columns=8), "found it with --board 7x6 in 3 of 3"),
        ("grid", changed(GRID, columns=5, rows=4), "found it with --board 4x5 in 3 of 3"),
        ("chessboard", changed(CHESSBOARD, columns=8), "a chessboard of 9x6 inner corners, or more, is seen"),
    ],
)
def test_a_board_easily_taken_for_it_is_reported(
    there: str, described: CalibrationBoard, says: str, shown: dict[str, list[np.ndarray]]
) -> None:
    told = hint(described, shown[there])
    assert told is not None
    assert told.startswith(says)


@pytest.mark.parametrize(
    ("there", "described", "says"),
    [
        (
            "new",
            changed(CHARUCO, dictionary="5x5_100"),
            "markers 0 to 20 of 4x4_50 are seen; expected 0 to 20 of",
        ),
        (
            "new",
            changed(CHARUCO, columns=11, rows=9),
            "markers 0 to 20 of 4x4_50 are seen; expected 0 to 48 of",
        ),
        ("chessboard", CHARUCO, "a chessboard of 9x6 inner corners, or more, is seen; expected charuco 7x6"),
        ("chessboard", changed(CHESSBOARD, rows=8), "a chessboard of 9x6 inner corners, or more, is seen"),
        ("grid", CHESSBOARD, "markers 0 to 19 of 6x6_50 are seen; expected chessboard 9x6"),
    ],
)
def test_what_is_seen_instead_is_reported(
    there: str, described: CalibrationBoard, says: str, shown: dict[str, list[np.ndarray]]
) -> None:
    assert what_is_seen(described, shown[there]).startswith(says)


def test_nothing_is_reported_where_there_is_nothing() -> None:
    empty = [np.full((480, 640), 128, np.uint8)] * 2
    assert hint(CHARUCO, empty) is None
    assert hint(CHESSBOARD, empty) is None
    assert what_is_seen(CHARUCO, empty).startswith("neither markers of any dictionary nor a chessboard")


def test_a_grid_described_on_its_side_is_not_taken_for_found(shown: dict[str, list[np.ndarray]]) -> None:
    finder = BoardFinder(changed(GRID, columns=5, rows=4))
    assert [finder.find(image) for image in shown["grid"]] == [None] * 3


# ---------------------------------------------------------------- a grid whose gap was measured wrongly


def test_a_grid_with_a_wrong_gap_gives_the_camera_and_the_gap() -> None:
    """8 mm told, 5 mm true: millimetres off in every view, and nothing of it is left in the camera."""
    painter, rng = BoardPainter(GRID, CAMERA), np.random.default_rng(6)
    views = [
        ideal_view(painter, pose, rng, 0.05, f"view {k}")
        for k, pose in enumerate(hand_held_poses(GRID, CAMERA, 15, rng))
    ]
    told = changed(GRID, gap_m=0.008)
    wrong = [type(v)(v.name, v.ids, told.points_m[v.ids], v.corners_px, v.edge_px) for v in views]
    found = assess(wrong, SIZE, told.surface)
    assert found.rms_px < 0.09
    assert found.solution.camera.numbers[0] == pytest.approx(CAMERA.fx_px, rel=1e-3)
    assert found.solution.surface.gap_m == pytest.approx(0.005, abs=5e-5)
    assert any("5.0 mm apart, if they are 37.5; specified 8" in line for line in summary_lines(found))


def test_the_corners_of_a_wide_lens_are_not_taken_for_misread() -> None:
    """Much of a barrelled view is where no plane without a lens has it; two exchanged corners stand out."""
    matrix = np.array([[320.0, 0, 320], [0, 320.0, 240], [0, 0, 1]])
    width, height = CHARUCO.size_m
    points = CHARUCO.points_m
    pixels, _ = cv2.projectPoints(
        points,
        np.zeros(3),
        np.array([-width / 2, -height / 2, 0.09]),
        matrix,
        np.array([-0.22, 0.04, 0, 0, -0.002]),
    )
    corners = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    assert on_a_plane(points, corners, SIZE).all()
    corners[[3, 20]] = corners[[20, 3]]
    assert np.flatnonzero(~on_a_plane(points, corners, SIZE)).tolist() == [3, 20]


# ---------------------------------------------------------------- photos


@pytest.fixture
def folder(tmp_path: Path, shown: dict[str, list[np.ndarray]]) -> Path:
    for number, image in enumerate(shown["new"]):
        cv2.imwrite(str(tmp_path / f"img_{number}.png"), image)
    return tmp_path


def test_one_bad_photo_of_several_is_left_out_and_reported(folder: Path) -> None:
    (folder / "img_9.jpg").write_bytes(b"\xff\xd8half a photo")
    told: list[str] = []
    found = views_of_photos(CHARUCO, [folder], None, told.append)
    assert len(found.views) == 3
    assert [line for line in told if "img_9.jpg: not a photo that can be read" in line] == told


def test_a_photo_named_twice_is_one_view(folder: Path) -> None:
    assert len(photo_paths([folder, folder / "img_1.png"])) == 3


def test_where_no_photo_can_be_read_that_is_the_error(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "b.png").write_text("a letter")
    with pytest.raises(ConfigError, match=r"a\.png: not a photo"):
        list(read_photos(photo_paths([tmp_path]), lambda _: None))


def tag_pictures(turn: int, *, from_below: bool = False, border: int = 1, first: int = 0) -> list[np.ndarray]:
    """Three views of a grid of AprilTags, each printed `turn` quarter turns from OpenCV's drawing."""
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_25h9)
    side, gap = 210, 25
    sheet = np.full((2 * side + 3 * gap, 2 * side + 3 * gap), 255, np.uint8)
    for k in range(4):
        row, column = divmod(k, 2)
        row = 1 - row if from_below else row
        top, left = gap + row * (side + gap), gap + column * (side + gap)
        sheet[top : top + side, left : left + side] = np.rot90(
            cv2.aruco.generateImageMarker(tags, first + k, side, borderBits=border), turn
        )
    views, size = [], float(len(sheet))
    for lean in (0.0, 30.0, -40.0):
        corners = np.array([[60, 40], [560, 40 + lean], [560, 460 - lean], [60, 460]], np.float32)
        flat = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32)
        warp = cv2.getPerspectiveTransform(flat, corners)
        views.append(cv2.warpPerspective(sheet, warp, (640, 480), borderValue=120, flags=cv2.INTER_AREA))
    return views


TAGS: Final = CalibrationBoard(
    pattern="grid", columns=2, rows=2, marker_m=0.06, gap_m=0.0071, dictionary="apriltag_25h9"
)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
@pytest.mark.parametrize(("from_below", "border"), [(False, 1), (True, 1), (True, 2)])
def test_tags_printed_another_way_round_are_taken(turn: int, from_below: bool, border: int) -> None:
    # AprilRobotics' own pictures are half a turn from OpenCV's; Kalibr's besides count from below, in two
    # cells of black
    for picture in tag_pictures(turn, from_below=from_below, border=border):
        view = BoardFinder(TAGS).find(picture)
        assert view is not None
        assert len(view.ids) >= 8
        fit, _ = cv2.findHomography(view.points_m[:, :2], view.corners_px)
        there = cv2.perspectiveTransform(view.points_m[:, None, :2], fit)[:, 0]
        assert np.abs(there - view.corners_px).max() < 1.0


def test_a_larger_board_that_has_some_of_the_ids_hides_no_diagnosis() -> None:
    shifted = tag_pictures(0, first=7)  # 7 to 10; a board of 3x3 has 7 and 8, side by side as here
    assert hint(TAGS, shifted) is None
    assert "markers 7 to 10 of apriltag_25h9 are seen; expected 0 to 3" in what_is_seen(TAGS, shifted)


def test_one_accidental_match_hides_no_diagnosis(tmp_path: Path) -> None:
    # ids that begin at 10: the board's own dictionary, but other markers
    whole = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    shifted = cv2.aruco.CharucoBoard((7, 6), 0.03, 0.022, whole, np.arange(10, 31))
    sheet = shifted.generateImage((560, 440), marginSize=20)
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"{k}.png"), sheet)
    cv2.imwrite(str(tmp_path / "4.png"), CHARUCO.charuco.generateImage((560, 440), marginSize=20))
    with pytest.raises(ConfigError) as told:
        views_of_photos(CHARUCO, [tmp_path], None, lambda _: None)
    words = str(told.value)
    assert "markers 10 to 30 of 4x4_50 are seen; expected 0 to 20 of 4x4_50" in words
    assert "4.png alone may match by chance" in words
