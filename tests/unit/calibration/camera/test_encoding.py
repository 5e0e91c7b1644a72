"""The encoding that the board's edges tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.camera.board import CalibrationBoard
from calibration.camera.encoding import measure_encoding
from calibration.camera.views import BoardFinder
from companion.base.encoding import Encoding, grey_of_light, light_of_greys
from companion.config import CameraConfig
from tests.unit.calibration.camera.board_pictures import BoardPainter, BoardPose

BOARD = CalibrationBoard(
    pattern="charuco", columns=7, rows=5, square_m=0.034, marker_m=0.025, dictionary="5x5_100"
)
CAMERA = CameraConfig(
    name="test", width_px=640, height_px=480, rate_hz=30.0, fx_px=620.0, fy_px=620.0, cx_px=320.0,
    cy_px=240.0,
    distortion=(0.05, -0.1, 0.0, 0.0, 0.0),
)  # fmt: skip
VIEWS = 6


@pytest.fixture(scope="module")
def light() -> list[NDArray[np.float64]]:
    """What the lens shows: 0..1."""
    rng, painter = np.random.default_rng(4), BoardPainter(BOARD, CAMERA)
    pictures = []
    for _ in range(VIEWS):
        turn = np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.3, 0.3)])
        place = np.array([-0.119 + rng.uniform(-0.02, 0.02), -0.085 + rng.uniform(-0.02, 0.02), 0.28])
        pictures.append(painter.take(BoardPose(turn, place), rng, defocus_px=0.6) / 255.0)
    return pictures


def pixels_of(light: list[NDArray[np.float64]], encoding: Encoding) -> list[NDArray[np.float64]]:
    rng, finder = np.random.default_rng(5), BoardFinder(BOARD)
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
