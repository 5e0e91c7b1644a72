"""Where boards are cut into sheets."""

from itertools import pairwise

import pytest

from companion.pad import Sheet, load_pad
from companion.pad.sheet import cuts, tile

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
