"""Table 1 shows all ways of looking the same frames, and its bars can fail."""

import math

from experiments.table1 import (
    BY_EQUATION_1,
    HEIGHTS_M,
    PAPER,
    SEVERAL,
    Cell,
    bars,
    best_single,
    look,
    names,
    over_heights,
    table,
)


def cells_of(several: Cell, far: Cell, near: Cell) -> dict[tuple[str, float], Cell]:
    return {
        (name, height_m): cell
        for name, cell in ((SEVERAL, several), ("one F", far), ("one C", near))
        for height_m in HEIGHTS_M
    }


def test_few_frames_of_the_shipped_pad() -> None:
    cells = look("moving_1300", "sitl_640x480", 2, seed=0)
    assert names(cells) == [SEVERAL, BY_EQUATION_1, "one F 36 cm", "one M 11 cm", "one C 3.3 cm"]
    assert {cells[SEVERAL, h].seen for h in HEIGHTS_M} == {2}
    # what flies is the more exact one of the two that know all markers
    near = HEIGHTS_M[:4]
    joint, paper = (over_heights([cells[n, h] for h in near])[1] for n in (SEVERAL, BY_EQUATION_1))
    assert 0.0 < joint < paper
    # a small marker is not read from 9 m, a large one is not in the picture at 0.3 m
    assert cells["one C 3.3 cm", 9.0].seen == cells["one F 36 cm", 0.3].seen == 0
    assert table(cells).row_count == len(names(cells)) + 1


def test_of_single_markers_the_best_counts() -> None:
    rare, common, exact = Cell(10, 4, 0.01), Cell(10, 9, 0.05), Cell(10, 9, 0.02)
    assert best_single(cells_of(rare, rare, common)) == [common] * 5
    assert best_single(cells_of(rare, exact, common)) == [exact] * 5
    assert best_single(cells_of(rare, Cell(10, 0, math.nan), rare)) == [rare] * 5


def test_the_bars_can_fail() -> None:
    good, single = Cell(1000, 1000, 0.01), Cell(1000, 970, 0.04)
    assert all(bars(cells_of(good, single, single)).values())
    # seen too seldom, not exact enough, worse than the single one in both
    assert list(bars(cells_of(Cell(1000, 990, 0.01), single, single)).values()) == [False, True, True, True]
    assert list(bars(cells_of(Cell(1000, 1000, 0.03), single, single)).values()) == [True, False, True, True]
    assert not any(bars(cells_of(Cell(1000, 960, 0.05), single, single)).values())
    assert PAPER["several"] == (99.3, 2.55)
