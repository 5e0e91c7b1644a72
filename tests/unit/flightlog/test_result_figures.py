"""The figures of a flight's table have the digits that mean something."""

import pytest

from companion.flightlog.report.tables import figure


@pytest.mark.parametrize(
    ("value", "unit", "bound", "shown"),
    [
        (78.992, "ms", None, "79 ms"),
        (1.5953, "°", 10.0, "1.6 °"),
        (0.1584, "m/s", 0.4, "0.16 m/s"),
        (0.0503, "m", 0.15, "0.050 m"),
        # on the side of the bound where it is
        (0.4003, "m/s", 0.4, "0.4003 m/s"),
        (0.4, "m/s", 0.4, "0.40 m/s"),
        (10.04, "°", 10.0, "10.04 °"),
        (float("inf"), "m", 0.15, "inf m"),
    ],
)
def test_a_figure_has_the_digits_that_mean_something(
    value: float, unit: str, bound: float | None, shown: str
) -> None:
    assert figure(value, unit, bound) == shown
