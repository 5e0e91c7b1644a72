"""The pictures that camera calibration is tested with are true: edges are where the projection has them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calibration.camera.board import CalibrationBoard
from companion.base.geometry import FloatArray
from companion.config import CameraConfig, find_file, load_model
from tests.unit.calibration.camera.board_pictures import BLACK, WHITE, BoardPainter, BoardPose

CAMERA = load_model(CameraConfig, find_file("cameras", "hd_1280x720"))
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
    painter = BoardPainter(MARKERS, CAMERA, bow_m)
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
