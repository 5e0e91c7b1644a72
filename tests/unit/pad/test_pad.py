"""The pad as data, and the shipped pad's fitness for a landing."""

import itertools
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from companion.config import CONFIG_FOLDER, ConfigError
from companion.pad import Marker, Pad, Sheet, load_pad
from companion.pad.sheet import cuts, tile

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
        ("  - {dictionary: 9x9_50, id: 0, side_m: 0.1, position_pad_m: [0, 0], group: F}", "4x4_50"),
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


# ---------------- What makes a pad unfit, on both sides of every bound

CELL_M = 0.1 / 6


def marker(identity: int, x: float = 0.0, y: float = 0.0, **more: Any) -> dict[str, Any]:
    """A 4x4 marker of 10 cm."""
    place = {"dictionary": "4x4_50", "id": identity, "side_m": 0.1, "position_pad_m": [x, y], "group": "F"}
    return place | more


def load(folder: Path, *markers: dict[str, Any], **more: Any) -> Pad:
    """A board of 40 cm, through a file."""
    path = folder / "pad.yaml"
    board = {"name": "p", "width_m": 0.4, "length_m": 0.4, "markers": list(markers)}
    path.write_text(yaml.safe_dump(board | more), encoding="utf-8")
    return load_pad(path)


def refusal(folder: Path, *markers: dict[str, Any], **more: Any) -> str:
    """The one line that says why not."""
    with pytest.raises(ConfigError) as caught:
        load(folder, *markers, **more)
    line = str(caught.value)
    assert line.startswith(str(folder / "pad.yaml"))
    assert "\n" not in line
    return line


NARROW = {"quiet_zone_m": 0.7 * CELL_M}


@pytest.mark.parametrize("apart_m", [0.0, 0.05, 0.0999])
def test_markers_that_overlap_are_refused(tmp_path: Path, apart_m: float) -> None:
    line = refusal(tmp_path, marker(0), marker(1, apart_m))
    assert "markers overlap: 4x4_50 id 0 and 4x4_50 id 1" in line


def test_markers_that_touch_do_not_overlap_but_leave_no_white(tmp_path: Path) -> None:
    line = refusal(tmp_path, marker(0), marker(1, 0.1))
    assert "overlap" not in line
    assert "the quiet zone is cut into: 4x4_50 id 0 (16.67 mm) by 4x4_50 id 1" in line


def test_a_turned_marker_overlaps_with_its_corner(tmp_path: Path) -> None:
    # a corner of the turned one is 70.7 mm from its middle
    assert "overlap" in refusal(tmp_path, marker(0), marker(1, 0.1206, yaw_deg=45.0))
    line = refusal(tmp_path, marker(0), marker(1, 0.1208, yaw_deg=45.0), length_m=1.0)
    assert "cut into: 4x4_50 id 0 (16.67 mm) by 4x4_50 id 1, 4x4_50 id 1 (16.67 mm) by" in line


def test_turned_markers_whose_boxes_overlap_may_lie_apart(tmp_path: Path) -> None:
    # side by side along the diagonal, 0.1 + a quiet zone apart; their boxes overlap by a third
    step = (0.1 + CELL_M + 1e-4) / 2**0.5
    turned = [marker(k, k * step, k * step, yaw_deg=45.0) for k in (0, 1)]
    assert len(load(tmp_path, *turned).markers) == 2


@pytest.mark.parametrize(("gap_m", "fits"), [(CELL_M - 1e-5, False), (CELL_M, True)])
def test_between_two_markers_lies_a_cell_of_white(tmp_path: Path, gap_m: float, fits: bool) -> None:
    both = marker(0), marker(1, 0.0, 0.1 + gap_m)
    if fits:
        load(tmp_path, *both)
    else:
        assert "expected so much white between them" in refusal(tmp_path, *both)


def test_a_given_quiet_zone_counts_for_the_marker_that_has_it(tmp_path: Path) -> None:
    load(tmp_path, marker(0, quiet_zone_m=0.03), marker(1, 0.1301), length_m=1.0)
    line = refusal(tmp_path, marker(0), marker(1, 0.1299, quiet_zone_m=0.03), length_m=1.0)
    assert "cut into: 4x4_50 id 1 (30 mm) by 4x4_50 id 0;" in line


@pytest.mark.parametrize(("board_m", "fits"), [(0.1 + 2 * CELL_M - 1e-4, False), (0.1 + 2 * CELL_M, True)])
def test_the_quiet_zone_lies_on_the_board(tmp_path: Path, board_m: float, fits: bool) -> None:
    size = {"width_m": board_m, "length_m": board_m}
    if fits:
        load(tmp_path, marker(0), **size)
    else:
        line = refusal(tmp_path, marker(0), **size)
        assert "cut by the board's edge: 4x4_50 id 0 (16.67 mm)" in line
    load(tmp_path, marker(0, **NARROW), **size)


@pytest.mark.parametrize(("cells", "fits"), [(0.0, False), (0.65, False), (0.67, True)])
def test_a_quiet_zone_is_no_narrower_than_what_was_read(tmp_path: Path, cells: float, fits: bool) -> None:
    given = marker(7, quiet_zone_m=cells * CELL_M)
    if fits:
        load(tmp_path, given)
    else:
        assert "too narrow a quiet zone about 4x4_50 id 7 (" in refusal(tmp_path, given)


@pytest.mark.parametrize(("dots_per_inch", "fits"), [(101.5, False), (101.7, True)])
def test_a_cell_has_eight_dots(tmp_path: Path, dots_per_inch: float, fits: bool) -> None:
    # cells of 2 mm
    small, sheet = marker(3, side_m=0.012), {"dots_per_inch": dots_per_inch}
    if fits:
        load(tmp_path, small, sheet=sheet)
    else:
        line = refusal(tmp_path, marker(0, -0.1), small, sheet=sheet)
        assert "cells too small to print: 4x4_50 id 3 (2 mm); expected 8 dots" in line
        assert "id 0" not in line


@pytest.mark.parametrize(
    ("size_m", "fits"),
    [([0.42, 0.434], True), ([0.434, 0.42], True), ([0.419, 0.5], False), ([0.433, 0.433], False)],
)
def test_the_board_fits_its_large_sheet_either_way(tmp_path: Path, size_m: list[float], fits: bool) -> None:
    # margins of 10 mm, and 14 mm for the foot
    sheet = {"paper": "large", "size_m": size_m}
    if fits:
        load(tmp_path, marker(0), sheet=sheet)
    else:
        line = refusal(tmp_path, marker(0), sheet=sheet)
        assert "sheet: no room for a board of 400 mm x 400 mm" in line


def test_a_square_sheet_that_is_too_small_tells_its_room_once(tmp_path: Path) -> None:
    # 10 mm of margin, 14 mm for the foot
    line = refusal(tmp_path, marker(0), sheet={"paper": "large", "size_m": [0.4, 0.4]})
    assert line.endswith("expected one of at most 380x366 mm")


def test_a_rule_of_the_whole_pad_is_reported_without_a_key(tmp_path: Path) -> None:
    assert ".yaml: markers repeated" in refusal(tmp_path, marker(0), marker(0, 0.15))


@pytest.mark.parametrize(("side_m", "fits"), [(0.188, True), (0.1885, False)])
def test_no_cut_divides_a_marker_when_the_pad_says_so(tmp_path: Path, side_m: float, fits: bool) -> None:
    # 190 mm of an A4 page's width hold the marker and a millimetre on both sides
    large, sheet = marker(0, side_m=side_m), {"paper": "a4", "whole_markers": True}
    if fits:
        load(tmp_path, large, sheet=sheet)
    else:
        assert "a cut would divide 4x4_50 id 0 (188.5 mm)" in refusal(tmp_path, large, sheet=sheet)
    load(tmp_path, large, sheet={"paper": "a4"})


def test_a_paper_has_its_own_size(tmp_path: Path) -> None:
    line = refusal(tmp_path, marker(0), sheet={"paper": "a4", "size_m": [0.3, 0.3]})
    assert "sheet: size_m: expected none with paper a4" in line


def test_repeated_ids_are_named_once_each(tmp_path: Path) -> None:
    line = refusal(tmp_path, *(marker(0, 0.12 * k - 0.1) for k in range(3)))
    assert "markers repeated: 4x4_50 id 0; expected" in line
    two = marker(0, -0.1), marker(0, 0.1, dictionary="5x5_50")
    assert len(load(tmp_path, *two).markers) == 2


def test_of_many_the_first_are_named_and_the_rest_counted(tmp_path: Path) -> None:
    tiny = [marker(k, 0.03 * k - 0.1, side_m=0.012) for k in range(7)]
    line = refusal(tmp_path, *tiny, sheet={"dots_per_inch": 60.0})
    assert "4x4_50 id 3 (2 mm) and 3 more;" in line


def test_a_pad_from_a_log_needs_no_sheet_that_it_fits() -> None:
    # what was flown is read all the same; only loading one to fly or print asks for more
    data = {"name": "p", "width_m": 0.1, "length_m": 0.1, "markers": [marker(0)]}
    assert Pad.model_validate(data).markers[0].quiet_m == pytest.approx(CELL_M)


@pytest.mark.parametrize("path", sorted((CONFIG_FOLDER / "pads").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_shipped_pad_has_its_file_s_name_and_larger_markers_the_simpler_codes(path: Path) -> None:
    pad = load_pad(path)
    assert pad.name == path.stem
    sides = sorted((m.side_m, -m.cells) for m in pad.markers)
    assert [cells for _, cells in sides] == sorted(cells for _, cells in sides) or all(
        a.cells <= b.cells for a in pad.markers for b in pad.markers if a.side_m > b.side_m
    )


# ---------------- Where boards are cut into sheets

EDGE = (-0.2, 0.2)


def lengths(places: tuple[float, ...]) -> list[float]:
    return [b - a for a, b in pairwise(places)]


def test_a_board_that_fits_is_not_cut() -> None:
    assert cuts(EDGE, 0.4, [(-0.1, 0.1)], whole=False) == EDGE


def test_without_markers_the_pieces_are_even() -> None:
    assert cuts(EDGE, 0.19, [], whole=False) == pytest.approx((-0.2, -0.2 / 3, 0.2 / 3, 0.2))


def test_a_cut_is_laid_between_markers_as_far_off_as_costs_nothing() -> None:
    # even halves would divide the marker: 3 mm beside it is the most even that stays clear of it
    assert cuts(EDGE, 0.25, [(-0.01, 0.02)], whole=False) == pytest.approx((-0.2, -0.013, 0.2))
    # in a gap of 4 mm the middle is as clear as can be
    assert cuts(EDGE, 0.25, [(-0.1, 0.01), (0.014, 0.1)], whole=False)[1] == pytest.approx(0.012)


def test_a_marker_is_divided_rather_than_a_sheet_added_unless_it_may_not_be() -> None:
    markers = [(-0.15, 0.15)]
    assert len(cuts(EDGE, 0.31, markers, whole=False)) == 3
    whole = cuts(EDGE, 0.31, markers, whole=True)
    assert len(whole) == 4
    assert not any(-0.15 < place < 0.15 for place in whole)


@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("name", ["moving_1300", "indoor_400"])
def test_every_piece_fits_its_paper_and_all_make_the_board(name: str, paper: str, whole: bool) -> None:
    pad = load_pad(name)
    sheet = Sheet.model_validate({"paper": paper, "whole_markers": whole})
    tiling = pad.model_copy(update={"sheet": sheet}).tiling()
    width, height = sheet.room_m(tiling.page_m)
    assert max(lengths(tiling.across_m)) <= width + 1e-9
    assert max(lengths(tiling.along_m)) <= height + 1e-9
    assert sum(lengths(tiling.across_m)) == pytest.approx(pad.width_m)
    assert sum(lengths(tiling.along_m)) == pytest.approx(pad.length_m)


def test_the_page_is_turned_where_that_saves_sheets() -> None:
    tiling = tile(Sheet(paper="a4"), (0.17, 0.27), ())
    assert tiling is not None
    assert (tiling.page_m, tiling.count) == ((0.297, 0.21), 1)


def test_a_large_sheet_is_as_large_as_the_board_needs() -> None:
    tiling = tile(Sheet(), (0.4, 0.5), ())
    assert tiling is not None
    assert tiling.page_m == pytest.approx((0.52, 0.434))
    # the ruler needs its room
    tiny = tile(Sheet(), (0.06, 0.06), ())
    assert tiny is not None
    assert tiny.page_m == pytest.approx((0.2, 0.094))
