"""What makes a pad unfit, on both sides of every bound."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.config import CONFIG_FOLDER, ConfigError
from companion.pad import Pad, load_pad

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
