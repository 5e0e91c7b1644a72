"""Corners by a marker's whole print, where its cells run together."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.pad import Marker, load_pad
from companion.sense.vision.corners import refine_quads
from companion.sense.vision.edges import PROPORTIONAL
from companion.sense.vision.print_fit import fit_prints, white_cells

FINE = 8
NOISE_GREY = 2.0
BLACK, WHITE, GROUND = 25.0, 190.0, 60.0


@pytest.fixture(scope="module")
def marker() -> Marker:
    return load_pad("moving_1300").markers[0]


def turned_square(side_px: float, rng: np.random.Generator) -> tuple[FloatArray, int]:
    """Corners (4, 2) px of a square, turned and moved by parts of a pixel; and the picture's size for it."""
    size, angle = int(2.2 * side_px), rng.uniform(0.0, math.tau)
    c, s = math.cos(angle), math.sin(angle)
    square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * side_px
    return square @ np.array([[c, s], [-s, c]]) + 0.5 * size + rng.uniform(-0.5, 0.5, 2), size


def drawn(
    marker: Marker,
    quad: FloatArray,
    size: int,
    blur_px: float,
    rng: np.random.Generator,
    white: float = WHITE,
) -> NDArray[np.uint8]:
    """The marker, its white and the ground, averaged over pixels, blurred and noisy."""
    about, n = 8, marker.cells
    u = (np.arange((size + 2 * about) * FINE) + 0.5) / FINE - 0.5 - about
    square = np.array([(0, 0), (n, 0), (n, n), (0, n)], np.float32)
    back = np.linalg.inv(cv2.getPerspectiveTransform(square, quad.astype(np.float32)))
    x, y, w = np.tensordot(back, np.stack((*np.meshgrid(u, u), np.ones((len(u), len(u))))), 1)
    x, y = x / w, y / w
    quiet = marker.quiet_m / marker.cell_m
    cells = white_cells(marker)
    column, row = (np.clip(np.floor(each).astype(int) + 1, 0, n + 1) for each in (x, y))
    light = BLACK + (white - BLACK) * cells[row, column]
    light[(np.minimum(x, y) < -quiet) | (np.maximum(x, y) > n + quiet)] = GROUND
    if blur_px > 0.0:
        light = cv2.GaussianBlur(light, (0, 0), blur_px * FINE)
    whole = len(u) // FINE
    light = cv2.resize(light, (whole, whole), interpolation=cv2.INTER_AREA)[about:-about, about:-about]
    noisy = light + rng.normal(0.0, NOISE_GREY, light.shape)
    return np.asarray(np.rint(noisy).clip(0, 255), np.uint8)


@pytest.mark.parametrize(("side_px", "blur_px"), [(17.0, 0.3), (17.0, 0.6), (22.0, 0.8)])
def test_small_cells_do_not_draw_the_corners_inwards(marker: Marker, side_px: float, blur_px: float) -> None:
    rng = np.random.default_rng(3)
    outwards, by_sides, nees = [], [], []
    for _ in range(25):
        quad, size = turned_square(side_px, rng)
        image = drawn(marker, quad, size, blur_px, rng)
        start = quad + rng.normal(0.0, 0.3, (4, 2))
        fit = fit_prints(image, PROPORTIONAL, [marker], start[None])
        sides = refine_quads(image, start[None], np.array([marker.cells]), np.zeros((1, 4)))
        away = quad - quad.mean(axis=0)
        away /= np.linalg.norm(away, axis=1)[:, None]
        outwards.append(((fit.corners[0] - quad) * away).sum(axis=1).mean())
        by_sides.append(((sides.corners[0] - quad) * away).sum(axis=1).mean())
        miss = (fit.corners[0] - quad).reshape(8)
        nees.append(miss @ np.linalg.solve(fit.covariance_px2[0], miss))
    assert abs(np.mean(outwards)) < 0.01
    assert abs(np.mean(by_sides)) > 0.03
    # eight numbers each
    assert 4.0 < np.mean(nees) < 16.0


def test_white_that_is_cut_off_moves_nothing(marker: Marker) -> None:
    rng = np.random.default_rng(4)
    outwards = []
    for _ in range(15):
        quad, size = turned_square(18.0, rng)
        image = drawn(marker, quad, size, 0.5, rng, white=380.0)
        fit = fit_prints(image, PROPORTIONAL, [marker], quad[None] + rng.normal(0.0, 0.3, (4, 2)))
        away = quad - quad.mean(axis=0)
        away /= np.linalg.norm(away, axis=1)[:, None]
        outwards.append(((fit.corners[0] - quad) * away).sum(axis=1).mean())
    assert abs(np.mean(outwards)) < 0.03


def test_what_is_not_there_is_not_found(marker: Marker) -> None:
    rng = np.random.default_rng(5)
    quad, size = turned_square(18.0, rng)
    clutter = rng.integers(20, 200, (size, size)).astype(np.uint8)
    fit = fit_prints(clutter, PROPORTIONAL, [marker], quad[None])
    assert np.isinf(fit.covariance_px2).all()
    assert np.array_equal(fit.corners[0], quad)


@pytest.mark.filterwarnings("error")
def test_a_print_that_is_nowhere_is_lost_without_a_word(marker: Marker) -> None:
    quads = np.array([[(0.0, 0.0), (20.0, 20.0), (20.0, 0.0), (0.0, 20.0)]])  # crosses itself: a depth is 0
    fit = fit_prints(np.full((40, 40), 90, np.uint8), PROPORTIONAL, [marker], quads)
    assert np.isinf(fit.covariance_px2).all()
    assert fit.corners == pytest.approx(quads)
