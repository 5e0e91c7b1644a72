"""The Earth's field, against the test values that the World Magnetic Model is published with."""

import pytest

from companion.base.magnetic_field import field_ned_ut


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
