"""The pad as data, and the shipped pad's fitness for a landing."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from companion.config import ConfigError
from companion.pad import Marker, Pad, load_pad

BOARD = "name: p\nwidth_m: 1.0\nlength_m: 1.0\nmarkers:\n"


@pytest.fixture(scope="module")
def shipped() -> Pad:
    return load_pad("moving_1300")


def cells(marker: Marker) -> int:
    return int(marker.dictionary[0]) + 2


def test_corners_go_round_clockwise_from_the_top_left_seen_from_above() -> None:
    marker = Marker(dictionary="4x4_50", id=0, side_m=0.2, position_pad_m=(1.0, 2.0), group="F")
    # x is ahead (up in the print), y is to the right
    expected = [(1.1, 1.9, 0.0), (1.1, 2.1, 0.0), (0.9, 2.1, 0.0), (0.9, 1.9, 0.0)]
    assert marker.corners_pad_m() == pytest.approx(np.array(expected))


@pytest.mark.parametrize(
    ("yaw_deg", "top_left"), [(90.0, (0.1, 0.1)), (180.0, (-0.1, 0.1)), (-90.0, (-0.1, -0.1))]
)
def test_a_turned_marker_turns_clockwise(yaw_deg: float, top_left: tuple[float, float]) -> None:
    marker = Marker(
        dictionary="4x4_50", id=0, side_m=0.2, position_pad_m=(0.0, 0.0), yaw_deg=yaw_deg, group="F"
    )
    assert marker.corners_pad_m()[0, :2] == pytest.approx(top_left)


@pytest.mark.parametrize(
    ("markers", "text"),
    [
        ("  - {dictionary: 4x4_50, id: 50, side_m: 0.1, position_pad_m: [0, 0], group: F}", "less than 50"),
        (
            "  - {dictionary: 4x4_50, id: 0, side_m: 0.3, position_pad_m: [0.4, 0], group: F}",
            "over the board's edge",
        ),
        ("  - {dictionary: 7x7_50, id: 0, side_m: 0.1, position_pad_m: [0, 0], group: F}", "4x4_50"),
        (
            "  - {dictionary: 4x4_50, id: 0, side_m: 0.1, position_pad_m: [0, 0], group: F, colour: red}",
            "colour",
        ),
        (
            "  - {dictionary: 4x4_50, id: 0, side_m: 0.1, position_pad_m: [0.2, 0], group: F}\n" * 2,
            "repeated: 4x4_50 id 0",
        ),
        ("  []", "at least 1"),
    ],
)
def test_a_pad_that_cannot_be_is_refused_in_one_line(tmp_path: Path, markers: str, text: str) -> None:
    path = tmp_path / "pad.yaml"
    path.write_text(BOARD + markers + "\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=text) as caught:
        load_pad(path)
    assert "\n" not in str(caught.value)


def test_the_shipped_pads_markers_keep_white_around_them(shipped: Pad) -> None:
    # between two markers lies at least a cell of the smaller one's code
    for a, b in itertools.combinations(shipped.markers, 2):
        apart = np.abs(np.subtract(a.position_pad_m, b.position_pad_m)) - 0.5 * (a.side_m + b.side_m)
        smaller = min((a, b), key=lambda m: m.side_m)
        assert apart.max() > smaller.side_m / cells(smaller), (a.group, a.id, b.group, b.id)


def test_the_far_markers_stand_clear_of_all_others(shipped: Pad) -> None:
    # at 10 m a pixel is 19 mm: with less than three between them outlines run together
    for a, b in itertools.product(shipped.markers, shipped.markers):
        if a.group == "F" and b is not a:
            apart = np.abs(np.subtract(a.position_pad_m, b.position_pad_m)) - 0.5 * (a.side_m + b.side_m)
            assert apart.max() > 0.056


def test_larger_markers_never_carry_the_denser_code(shipped: Pad) -> None:
    for a, b in itertools.combinations(shipped.markers, 2):
        if a.side_m > b.side_m:
            assert cells(a) <= cells(b)


@pytest.mark.parametrize(
    ("height_m", "off_m", "at_least"),
    [
        (0.10, 0.03, 1),
        (0.10, 0.07, 1),
        (0.15, 0.08, 3),
        (0.2, 0.12, 2),
        (0.4, 0.2, 2),
        (0.8, 0.4, 2),
        (2.0, 0.6, 2),
    ],
)
def test_wherever_the_camera_comes_down_enough_markers_are_whole_in_view(
    shipped: Pad, height_m: float, off_m: float, at_least: int
) -> None:
    # half the view of the shipped camera, less an edge; in whichever direction the vehicle points
    half = np.array([0.44 * height_m, 0.59 * height_m])
    for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        c, s = np.cos(angle), np.sin(angle)
        for direction in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
            centre = off_m * np.array([np.cos(direction), np.sin(direction)])
            whole = 0
            for marker in shipped.markers:
                seen = (marker.corners_pad_m()[:, :2] - centre) @ np.array([[c, -s], [s, c]])
                readable = 532.0 * marker.side_m / height_m > 20.0
                whole += readable and bool((np.abs(seen) < half).all())
            assert whole >= at_least, (angle, direction)
