"""The Earth's field, against the test values that the World Magnetic Model is published with."""

import math
from datetime import UTC, datetime

import pytest

from companion.base import second_sources
from companion.base.geometry import Vector3, scale
from companion.base.magnetic_field import compare_declination, field_ned_ut
from companion.base.messages import Quantity


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


def announced(told: Vector3, std_ut: float = TOLD_STD_UT, place: Vector3 = ZURICH) -> list[str]:
    return [text for _, text in second_sources.announced([compare_declination(told, std_ut, place, TODAY_S)])]


@pytest.mark.parametrize("angle_deg", [-4.0, -2.0, 0.0, 2.0, 4.0, 20.0])
def test_a_declination_that_neither_source_allows_is_announced_with_both_figures(angle_deg: float) -> None:
    # 0.36 deg of the model's and 0.8 of the setting's make 0.9; three of them are allowed
    told = turned(field_ned_ut(*ZURICH, 2026.5), angle_deg)
    texts = announced(told)
    assert bool(texts) is (abs(angle_deg) > 3.0)
    for text in texts:
        assert f"magnetic_field_ned_ut {3.6 + angle_deg:.1f} deg, the World Magnetic Model" in text
        assert " 3.6 deg [21." in text
        assert "limit" not in text


def test_a_setting_that_is_a_guess_is_given_its_own_uncertainty() -> None:
    told = turned(field_ned_ut(*ZURICH, 2026.5), 10.0)
    assert announced(told)
    assert not announced(told, std_ut=3.0)


def test_where_the_horizontal_field_is_weak_the_model_itself_knows_little() -> None:
    north_of_canada = (82.0, -114.0, 0.0)
    weak = field_ned_ut(*north_of_canada, 2026.5)
    assert math.hypot(*weak[:2]) < 4.0
    told = turned(scale(weak, 10.0), 4.0)
    assert not announced(told, 0.01, north_of_canada)
    assert announced(turned(field_ned_ut(*ZURICH, 2026.5), 4.0), 0.01)


def test_a_clock_that_has_not_been_set_does_not_make_an_old_model() -> None:
    told = field_ned_ut(*ZURICH, 2025.5)
    found = compare_declination(told, TOLD_STD_UT, ZURICH, 0.0)
    assert found.quantity is Quantity.DECLINATION
    assert found.difference < 0.2
