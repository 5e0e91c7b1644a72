"""Which frames are kept: sharp, still and new; and what is said of the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.camera.board import CalibrationBoard
from calibration.camera.capture import CaptureSession, CaptureStep
from calibration.camera.views import BoardFinder, BoardView
from companion.config import CameraConfig, find_file, load_model
from tests.unit.calibration.camera.board_pictures import BoardPainter, BoardPose, ideal_view, tour_poses

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
    assert session.complete
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
