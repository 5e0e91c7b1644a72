"""The Earth's field, against the test values that the World Magnetic Model is published with."""

import math
from datetime import UTC, datetime

import pytest

from companion.base import second_sources as sources
from companion.base.geometry import Vector3, scale
from companion.base.magnetic_field import compare_declination, field_ned_ut
from companion.base.messages import Quantity, SourceComparison
from companion.base.second_sources import (
    ROWS,
    SIGMA_THRESHOLD,
    TABLE,
    Reaction,
    SourceRow,
    SourceState,
    announced,
    judged,
    refused,
)
from docs import second_sources


@pytest.mark.parametrize(
    ("year", "place", "field_nt"),
    [
        (2020.0, (80.0, 0.0, 0.0), (6570.4, -146.3, 54606.0)),
        (2020.0, (-80.0, 240.0, 100e3), (5744.9, 14799.5, -49969.4)),
        (2025.0, (80.0, 0.0, 0.0), (6521.6, 145.9, 54791.5)),
    ],
)
def test_the_published_test_values_come_out(
    year: float, place: tuple[float, float, float], field_nt: tuple[float, float, float]
) -> None:
    assert field_ned_ut(*place, year) == pytest.approx([1e-3 * value for value in field_nt], abs=2e-3)


@pytest.mark.parametrize("year", [1999.0, 2035.0])
def test_beyond_the_models_years_the_nearest_is_carried_on(year: float) -> None:
    north, east, down = field_ned_ut(47.0, 8.0, 400.0, year)
    assert (north, down) == pytest.approx((21.5, 43.0), abs=1.5)
    assert abs(east) < 3.0


ZURICH = (47.397742, 8.545594, 488.0)
TOLD_STD_UT = 0.3
TODAY_S = datetime(2026, 6, 1, tzinfo=UTC).timestamp()


def turned(field: Vector3, angle_deg: float) -> Vector3:
    angle_rad = math.radians(angle_deg)
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return (cosine * field[0] - sine * field[1], sine * field[0] + cosine * field[1], field[2])


def declination_texts(told: Vector3, std_ut: float = TOLD_STD_UT, place: Vector3 = ZURICH) -> list[str]:
    return [text for _, text in sources.announced([compare_declination(told, std_ut, place, TODAY_S)])]


@pytest.mark.parametrize("angle_deg", [-4.0, -2.0, 0.0, 2.0, 4.0, 20.0])
def test_a_declination_that_neither_source_allows_is_announced_with_both_figures(angle_deg: float) -> None:
    # 0.36 deg of the model's and 0.8 of the setting's make 0.9; three of them are allowed
    told = turned(field_ned_ut(*ZURICH, 2026.5), angle_deg)
    texts = declination_texts(told)
    assert bool(texts) is (abs(angle_deg) > 3.0)
    for text in texts:
        assert f"magnetic_field_ned_ut {3.6 + angle_deg:.1f} deg, the World Magnetic Model" in text
        assert " 3.6 deg [21." in text
        assert "limit" not in text


def test_a_setting_that_is_a_guess_is_given_its_own_uncertainty() -> None:
    told = turned(field_ned_ut(*ZURICH, 2026.5), 10.0)
    assert declination_texts(told)
    assert not declination_texts(told, std_ut=3.0)


def test_where_the_horizontal_field_is_weak_the_model_itself_knows_little() -> None:
    north_of_canada = (82.0, -114.0, 0.0)
    weak = field_ned_ut(*north_of_canada, 2026.5)
    assert math.hypot(*weak[:2]) < 4.0
    told = turned(scale(weak, 10.0), 4.0)
    assert not declination_texts(told, 0.01, north_of_canada)
    assert declination_texts(turned(field_ned_ut(*ZURICH, 2026.5), 4.0), 0.01)


def test_a_clock_that_has_not_been_set_does_not_make_an_old_model() -> None:
    told = field_ned_ut(*ZURICH, 2025.5)
    found = compare_declination(told, TOLD_STD_UT, ZURICH, 0.0)
    assert found.quantity is Quantity.DECLINATION
    assert found.difference < 0.2


# ---------------- The table of second sources: how it judges, and that its page is its own


def compared(quantity: Quantity, difference: float, std: float) -> SourceComparison:
    return SourceComparison(1.0, quantity, "12 of it", "0 of it", difference, std)


def test_every_quantity_is_listed_at_most_once() -> None:
    assert len(TABLE) == len(ROWS)


@pytest.mark.parametrize("row", [row for row in ROWS if row.bound is not None], ids=lambda row: row.quantity)
@pytest.mark.parametrize("std", [0.0, 2.0])
def test_a_difference_counts_when_it_is_surely_beyond(row: SourceRow, std: float) -> None:
    for limit, judges in ((row.notice, announced), (row.bound, refused)):
        assert limit is not None
        for more, counts in ((-0.01, False), (0.01, True)):
            given = compared(row.quantity, limit + SIGMA_THRESHOLD * std + more, std)
            found = dict(judges([given]))
            assert (row.quantity in found) is counts
            if counts:
                assert f"{row.first} 12 of it, {row.second} 0 of it" in found[row.quantity]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.quantity)
def test_what_is_refused_was_announced_before(row: SourceRow) -> None:
    assert row.bound is None or (row.notice is not None and row.notice < row.bound)
    assert row.reaction is not Reaction.NOTICE or row.bound is None


def test_each_row_is_judged_with_its_newest_comparison() -> None:
    older = compared(Quantity.ATTITUDE, 20.0, 0.5)
    given = [older, compared(Quantity.ATTITUDE, 1.0, 0.5), compared(Quantity.HEADING, 15.0, 1.0)]
    found = {row.quantity: state for row, state, _ in judged(given)}
    assert set(found) == set(TABLE)
    assert found[Quantity.ATTITUDE] is SourceState.AGREES
    assert found[Quantity.HEADING] is SourceState.DIFFERS
    assert found[Quantity.PAD_SCALE] is SourceState.NOT_MEASURED
    assert [s for r, s, _ in judged([older]) if r.quantity is Quantity.ATTITUDE] == [SourceState.REFUSED]


def test_the_page_is_the_table() -> None:
    page = second_sources.PAGE.read_text(encoding="utf-8")
    assert page == second_sources.page_text(), "run: python -m docs.second_sources"
