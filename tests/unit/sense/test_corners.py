"""Corners where a marker's sides meet, from starts that are as wrong as contours give them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.geometry import FloatArray
from companion.sense.corners import refine_quads

SIZE = 240
SIDE_PX = 118.0
CELLS = 6
FINER = 6


def square(turn_rad: float) -> FloatArray:
    """Corners (4, 2) px of a turned square, clockwise in the image."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return np.asarray(SIDE_PX * unit @ np.array([[c, s], [-s, c]])) + 120.3


def drawn(corners: FloatArray) -> NDArray[np.uint8]:
    """A marker that is black all through on white, blurred by its pixels and a little more."""
    places = (np.arange(SIZE * FINER) + 0.5) / FINER - 0.5
    inside = np.ones((SIZE * FINER, SIZE * FINER), bool)
    for (x, y), (u, v) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside &= (u - x) * (places[:, None] - y) - (v - y) * (places - x) > 0.0
    fine = np.where(inside, 25, 225).astype(np.uint8)
    small = cv2.resize(fine, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.6), np.uint8)


@pytest.mark.parametrize("turn_deg", [3.0, 20.0, 44.0, 47.0, 70.0])
@pytest.mark.parametrize("cut", [0, 1, 2, 3])
def test_a_corner_that_the_contour_cut_off_is_found(turn_deg: float, cut: int) -> None:
    truth = square(math.radians(turn_deg))
    start = truth.copy()
    # a third of a cell along each side, and an eighth inwards for the others
    start[cut] += (120.3 - truth[cut]) / np.linalg.norm(120.3 - truth[cut]) * 9.0
    start[(cut + 1) % 4] += 2.0
    corners, std_px, _ = refine_quads(drawn(truth), start[None], np.array([CELLS]))
    assert np.abs(corners[0] - truth).max() < 0.1
    assert std_px[0] < 0.1


@pytest.mark.parametrize("turn_deg", [3.0, 44.0])
def test_a_side_that_is_out_of_reach_is_not_claimed(turn_deg: float) -> None:
    truth = square(math.radians(turn_deg))
    start = truth.copy()
    start[2:] += 0.3 * (truth[1:2] - truth[2:3])
    corners, std_px, _ = refine_quads(drawn(truth), start[None], np.array([CELLS]))
    assert np.isinf(std_px[0])
    assert np.array_equal(corners[0], start)
