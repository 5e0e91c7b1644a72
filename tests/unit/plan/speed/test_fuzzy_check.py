"""The checks of the speed table find what they are for, and the shipped table passes them."""

from dataclasses import replace

import numpy as np
import pytest

from companion.plan.speed.fuzzy_check import sample_points, table_error, worst_slips
from companion.plan.speed.fuzzy_rules import INPUTS, load_rules
from companion.plan.speed.speed_table import SpeedTable, load_table

RULES = load_rules("landing")


@pytest.fixture(scope="module")
def table() -> SpeedTable:
    return load_table("landing")[0]


def test_the_shipped_table_is_within_a_hundredth_in_and_beyond_the_grid(table: SpeedTable) -> None:
    error = table_error(RULES, table, 1200, np.random.default_rng(7))
    assert error.holds
    assert 0.0 < error.rms < error.worst <= 0.01
    assert error.points == 1200


def test_the_samples_lie_on_every_side_of_the_grid(table: SpeedTable) -> None:
    points = sample_points(RULES, table, 2000, np.random.default_rng(0))
    for column, name in enumerate(INPUTS):
        axis = getattr(table, name)
        assert points[:, column].max() > axis[-1]
        assert points[:, column].min() < axis[0] or name == "distance_m"
    assert points[:, 0].min() >= 0.0


def test_a_wrong_entry_is_found_and_placed(table: SpeedTable) -> None:
    # one plane of distance is 5 % too fast
    row = 20
    planes = list(table.speed_m_s)
    planes[row] = tuple(tuple(1.05 * speed for speed in line) for line in planes[row])
    wrong = replace(table, speed_m_s=tuple(planes))
    error = table_error(RULES, wrong, 1200, np.random.default_rng(7))
    assert not error.holds
    assert table.distance_m[row - 1] < error.worst_at[0] < table.distance_m[row + 1]


def test_the_shipped_rules_are_a_pilots(table: SpeedTable) -> None:
    assert max(worst_slips(RULES, table).values()) < 1e-3


@pytest.mark.parametrize("axis", range(3))
def test_the_other_way_round_is_no_pilots(table: SpeedTable, axis: int) -> None:
    name = INPUTS[axis]
    flipped = np.flip(np.array(table.speed_m_s), axis=axis).tolist()
    slips = worst_slips(RULES, replace(table, speed_m_s=tuple(tuple(map(tuple, plane)) for plane in flipped)))
    assert slips[name] > 0.05
    assert [other for other, slip in slips.items() if slip > 0.01] == [name]


def test_the_pace_is_checked_likewise(table: SpeedTable) -> None:
    assert RULES.pace is not None
    assert table.pace is not None
    assert sample_points(RULES.pace, table.pace, 500, np.random.default_rng(0)).min() >= 0.0
    assert table_error(RULES.pace, table.pace, 600, np.random.default_rng(7)).holds
    assert max(worst_slips(RULES.pace, table.pace).values()) < 1e-3
    flipped = np.flip(np.array(table.pace.factor), axis=2).tolist()
    rash = replace(table.pace, factor=tuple(tuple(map(tuple, plane)) for plane in flipped))
    assert worst_slips(RULES.pace, rash)["gust_m_s2"] > 0.05
