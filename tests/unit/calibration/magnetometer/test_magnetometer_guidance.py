"""What a person is told while the vehicle is turned about: carried out, it leads to what is missing."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calibration.magnetometer.collect import hint, picture, progress, text_map
from calibration.magnetometer.ellipsoid import (
    CELLS,
    BoolArray,
    covered_cells,
    covered_share,
    lattice,
)
from companion.base.geometry import FloatArray, matrix_from_quat, quat_from_rotation_vector, vector3
from tests.unit.calibration.magnetometer.magnetometer_truth import turned

CENTRES = lattice(CELLS)


def all_but(direction: FloatArray, cosine: float = 0.8) -> BoolArray:
    """A mask with a hole about a direction."""
    return np.asarray(CENTRES @ direction < cosine)


def carried_out(words: str, now: FloatArray) -> FloatArray:
    """Where the field points after the vehicle has been turned as it was told."""
    axes = {"roll": 0, "nose": 1, "turn": 2}
    turn = np.zeros(3)
    for kind, side, degrees in re.findall(r"(roll|nose|turn) (\w+) (\d+)°", words):
        turn[axes[kind]] = np.radians(float(degrees)) * (1.0 if side in ("right", "up") else -1.0)
    return matrix_from_quat(quat_from_rotation_vector(vector3(turn.tolist()))).T @ now


@pytest.mark.parametrize("missing", [(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("now", [(0.0, 0.8, 0.6), (0.0, 0.0, 1.0), (-0.9, 0.1, 0.4)])
def test_the_hint_leads_to_the_hole(missing: tuple[float, ...], now: tuple[float, ...]) -> None:
    direction, wanted = np.array(now) / np.linalg.norm(now), np.array(missing)
    words = hint(all_but(wanted), direction, None)
    # components under 15 degrees are not told, and the hole has a size
    assert carried_out(words, direction) @ wanted > np.cos(np.radians(40.0))


def test_level_and_facing_north_the_words_are_a_pilots() -> None:
    dip = np.array([0.5, 0.0, 0.866])
    down = np.array([0.0, 0.0, 1.0])
    # the field is to come to the nose: it points down at 60 degrees, so the nose must go down by as much
    words = hint(all_but(np.array([1.0, 0.0, 0.0]), 0.95), dip, down)
    assert re.fullmatch(r"nose down \d0°(, \w+ \w+ 20°)*, until its (nose|belly) is lowest", words)
    assert hint(np.ones(CELLS, dtype=bool), dip, down) == "all covered"


def test_progress_grows_to_the_whole_and_shows_no_more_than_there_is() -> None:
    case = turned(1, samples=3000, half=False)
    few = progress(case.raw[:10], None, np.eye(3))
    assert few.share == 0.0
    assert few.hint == "begin to turn it about"
    whole = progress(case.raw, case.force, np.eye(3))
    assert whole.share == 1.0
    half = progress(turned(1, samples=3000).raw, None, np.eye(3))
    assert 0.4 < half.share < 0.75


@pytest.mark.parametrize("noise_ut", [0.3, 0.6, 2.0])
def test_a_sensor_that_is_held_still_covers_nothing(noise_ut: float) -> None:
    """Its noise is a ball with points on all sides, which is no sphere that it was turned about on."""
    still = np.random.default_rng(0).normal((20.0, -5.0, 40.0), noise_ut, (1000, 3))
    assert progress(still, None, np.eye(3)).share < 0.1
    on_a_grid = 0.15 * np.round(still / 0.15)
    assert progress(on_a_grid, None, np.eye(3)).share < 0.1


def test_a_few_still_samples_cover_next_to_nothing() -> None:
    still = np.random.default_rng(0).normal((20.0, -5.0, 40.0), 0.5, (400, 3))
    moved = still + np.linspace(0.0, 10.0, 400)[:, None] * (1.0, 0.0, 0.0)
    assert progress(moved, None, np.eye(3)).share < 0.5


def test_a_full_lattice_covers_everything_and_one_direction_one_cell() -> None:
    assert covered_share(CENTRES) == 1.0
    assert covered_cells(np.array([[0.0, 0.0, 1.0]])).sum() == 1
    assert covered_share(np.zeros((0, 3))) == 0.0
    assert np.linalg.norm(lattice(50), axis=1) == pytest.approx(np.ones(50))


def test_the_map_shows_the_hole_where_it_is() -> None:
    now = progress(turned(1, samples=3000, half=False).raw, None, np.eye(3))
    assert not any("." in line for line in text_map(now.covered)[1:])
    lines = text_map(all_but(np.array([0.0, 0.0, 1.0])))
    left, right = zip(*((line[:22], line[25:]) for line in lines[1:]), strict=True)
    assert "." in left[5][8:14]  # the belly's disc has it in the middle
    assert not any("." in line for line in right)
    image = picture(now)
    assert image.shape == (430, 720, 3)
    assert image.max() > 200
