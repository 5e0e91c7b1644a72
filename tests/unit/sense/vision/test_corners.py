"""Corners where a marker's sides meet, from starts that are as wrong as contours give them."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.encoding import decoding_table, encoding_table, light_of_greys
from companion.base.geometry import FloatArray
from companion.sense.vision.corners import refine_quads
from companion.sense.vision.edges import PROPORTIONAL

SIZE = 240
SIDE_PX = 118.0
CELLS = 6
FINER = 6


def square(turn_rad: float) -> FloatArray:
    """Corners (4, 2) px of a turned square, clockwise in the image."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return np.asarray(SIDE_PX * unit @ np.array([[c, s], [-s, c]])) + 120.3


def drawn(corners: FloatArray, bow_px: float = 0.0) -> NDArray[np.uint8]:
    """A marker that is black all through on white, blurred by its pixels and a little more.

    `bow_px`: how far outwards the middles of its sides lie from between its corners.
    """
    places = (np.arange(SIZE * FINER) + 0.5) / FINER - 0.5
    inside = np.ones((SIZE * FINER, SIZE * FINER), bool)
    for (x, y), (u, v) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = math.hypot(u - x, v - y)
        inwards = ((u - x) * (places[:, None] - y) - (v - y) * (places - x)) / length
        ahead = ((u - x) * (places - x) + (v - y) * (places[:, None] - y)) / length**2
        inside &= inwards > -bow_px * (1.0 - (2.0 * ahead - 1.0) ** 2)
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
    refined = refine_quads(drawn(truth), start[None], np.array([CELLS]))
    corners, std_px = refined.corners, refined.corner_std_px
    assert np.abs(corners[0] - truth).max() < 0.1
    assert std_px[0] < 0.1


@pytest.mark.parametrize("turn_deg", [3.0, 44.0])
def test_a_side_that_is_out_of_reach_is_not_claimed(turn_deg: float) -> None:
    truth = square(math.radians(turn_deg))
    start = truth.copy()
    start[2:] += 0.3 * (truth[1:2] - truth[2:3])
    refined = refine_quads(drawn(truth), start[None], np.array([CELLS]))
    corners, std_px = refined.corners, refined.corner_std_px
    assert np.isinf(std_px[0])
    assert np.array_equal(corners[0], start)


def small(corners: FloatArray, side_px: float) -> FloatArray:
    """The same square with sides of so many pixels."""
    return np.asarray((corners - 120.3) * (side_px / SIDE_PX) + 120.3)


def along_sides(corners: FloatArray, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far outwards each side (4,) lies as a whole, and its end by its turn."""
    across = np.roll(truth, -1, axis=0) - truth
    across /= np.linalg.norm(across, axis=1)[:, None]
    outward = np.stack((across[:, 1], -across[:, 0]), axis=1)
    start = ((corners - truth) * outward).sum(axis=1)
    end = ((np.roll(corners - truth, -1, axis=0)) * outward).sum(axis=1)
    return 0.5 * (start + end), 0.5 * (end - start)


@pytest.mark.parametrize("side_px", [22.0, 40.0, 118.0])
def test_a_side_does_not_stay_where_its_contour_began(side_px: float) -> None:
    # a contour runs through the outermost black pixels: half a pixel further in
    offsets = []
    for turn_deg in np.arange(2.0, 90.0, 8.0):
        truth = small(square(math.radians(turn_deg)), side_px)
        start = small(truth, SIDE_PX * (1.0 - 1.0 / side_px))
        refined = refine_quads(drawn(truth), start[None], np.array([CELLS]), np.zeros((1, 4)))
        offsets.append(along_sides(refined.corners[0], truth)[0])
    assert abs(float(np.mean(offsets))) < 0.004


@pytest.mark.parametrize("side_px", [22.0, 40.0, 118.0])
def test_the_stated_deviations_are_those_of_the_errors(side_px: float) -> None:
    rng = np.random.default_rng(3)
    offsets, turns, stated = [], [], []
    for turn_deg in np.arange(2.0, 90.0, 8.0):
        truth = small(square(math.radians(turn_deg)), side_px)
        image = drawn(truth).astype(np.float64)
        for _ in range(8):
            noisy = np.clip(np.rint(image + rng.normal(0.0, 3.0, image.shape)), 0, 255).astype(np.uint8)
            refined = refine_quads(noisy, truth[None], np.array([CELLS]), np.zeros((1, 4)))
            offset, turn = along_sides(refined.corners[0], truth)
            offsets.append(offset)
            turns.append(turn)
            stated.append((refined.offset_std_px[0], refined.turn_std_px[0]))
    offset_std, turn_std = np.sqrt(np.mean(np.square(stated), axis=0))
    assert np.std(offsets) / offset_std == pytest.approx(1.0, abs=0.25)
    assert np.std(turns) / turn_std == pytest.approx(1.0, abs=0.25)


def test_a_known_bow_is_taken_out_and_an_unknown_one_costs_certainty() -> None:
    # sides that bulge by 0.4 px, as a lens draws a marker of that size away from the image's middle
    truth = square(math.radians(20.0))
    image = drawn(truth, 0.4)
    start = small(truth, SIDE_PX - 1.0)
    known = refine_quads(image, start[None], np.array([CELLS]), np.full((1, 4), 0.4))
    unknown = refine_quads(image, start[None], np.array([CELLS]))
    ignored = refine_quads(image, start[None], np.array([CELLS]), np.zeros((1, 4)))
    assert np.abs(known.corners[0] - truth).max() < 0.06
    assert np.abs(ignored.corners[0] - truth).max() > 0.25
    assert unknown.offset_std_px[0] > 1.5 * unknown.turn_std_px[0]


@pytest.mark.parametrize("white_px", [0, 1, 2])
def test_a_side_whose_white_the_frame_cuts_off_is_not_claimed(white_px: int) -> None:
    """Its rise is cut off alike on all normals, so that their scatter would tell nothing of it."""
    truth = square(0.0)
    edge = round(truth[0, 0]) - white_px
    image = cv2.GaussianBlur(drawn(truth), (0, 0), 1.5)[:, edge:]
    seen = truth - (edge, 0.0)
    refined = refine_quads(np.ascontiguousarray(image), seen[None] + 0.2, np.array([CELLS]))
    assert np.isinf(refined.corner_std_px[0])


@pytest.mark.parametrize(("cells", "crowded"), [(6, False), (60, True)])
def test_sides_blurred_by_much_of_a_cell_are_less_sure_as_wholes(cells: int, crowded: bool) -> None:
    truth = square(0.2)
    refined = refine_quads(drawn(truth), truth[None], np.array([cells]))
    assert bool((refined.shrunk_px[0] > 0.1).all()) is crowded
    assert bool(refined.crowded_px[0] > 0.1) is crowded


@pytest.mark.parametrize("turn_deg", [5.0, 30.0])
def test_sides_are_found_in_light_however_it_is_encoded(turn_deg: float) -> None:
    truth = square(math.radians(turn_deg))
    encoded = np.asarray(cv2.LUT(drawn(truth), encoding_table("srgb")), np.uint8)
    off = []
    for light in (PROPORTIONAL, decoding_table("srgb")):
        refined = refine_quads(encoded, truth[None], np.array([CELLS]), np.zeros((1, 4)), light)
        off.append(float(np.mean(along_sides(refined.corners[0], truth)[0])))
    # the white seems larger by a share of the blur, and in light by nothing
    assert off[0] < -0.1
    assert abs(off[1]) < 0.01


def test_what_is_not_known_of_the_encoding_is_stated() -> None:
    truth = square(0.3)
    light = light_of_greys("srgb")
    table = (255.0 * light**1.1).astype(np.float32)
    encoded = np.asarray(cv2.LUT(drawn(truth), encoding_table("srgb")), np.uint8)
    right, wrong = (
        refine_quads(encoded, truth[None], np.array([CELLS]), np.zeros((1, 4)), each, 0.1)
        for each in (decoding_table("srgb"), table)
    )
    moved = np.mean(along_sides(wrong.corners[0], right.corners[0])[0])
    assert abs(moved) == pytest.approx(float(right.shrunk_px[0].mean()), rel=0.4)


def test_noise_that_grows_with_the_light_moves_no_side() -> None:
    rng = np.random.default_rng(5)
    off = []
    for turn_deg in np.arange(3.0, 87.0, 6.0):
        truth = square(math.radians(turn_deg))
        image = drawn(truth).astype(np.float64)
        noisy = image + rng.normal(0.0, 1.0, image.shape) * np.where(image > 120.0, 5.0, 0.2)
        seen = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        refined = refine_quads(seen, truth[None], np.array([CELLS]), np.zeros((1, 4)))
        off.append(np.mean(along_sides(refined.corners[0], truth)[0]))
    assert abs(np.mean(off)) < 0.006


@pytest.mark.parametrize("exposure", [1.2, 1.6, 2.0])
def test_white_that_is_cut_off_eats_into_the_black_as_far_as_is_stated(exposure: float) -> None:
    truth = square(0.4)
    bright = np.clip(exposure * cv2.GaussianBlur(drawn(truth).astype(np.float64), (0, 0), 1.0), 0, 255)
    refined = refine_quads(np.rint(bright).astype(np.uint8), truth[None], np.array([CELLS]), np.zeros((1, 4)))
    off = float(np.mean(along_sides(refined.corners[0], truth)[0]))
    stated = float(refined.shrunk_px[0].mean())
    assert 0.1 < stated < 0.6
    assert abs(off) < 2.0 * stated


def test_a_side_by_the_pictures_edge_is_refined_where_its_rise_is_in_view() -> None:
    """A cell is 17 px: as far as a normal usually reaches there is nothing more."""
    truth = square(0.0)
    edge = round(truth[0, 0]) - 5
    image = np.ascontiguousarray(drawn(truth)[:, edge:])
    seen = truth - (edge, 0.0)
    refined = refine_quads(image, seen[None] + 0.4, np.array([CELLS]))
    assert np.abs(refined.corners[0] - seen).max() < 0.05
    assert refined.corner_std_px[0] < 0.1
