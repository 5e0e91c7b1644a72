"""The bench's own arithmetic: NEES, its band, and when an error counts as recovered."""

import math

import numpy as np
import pytest

from benchmarks.state.consistency import band, consistency, nees, recovery_s
from companion.base.geometry import FloatArray

COVARIANCE = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])


def flights(count: int, factor: float) -> list[tuple[FloatArray, FloatArray]]:
    """Errors drawn with `factor` times the standard deviation that the filter claims."""
    rng = np.random.default_rng(7)
    result = []
    for k in range(count):
        n = 200 + k  # no two flights are of the same length
        errors = factor * rng.multivariate_normal(np.zeros(3), COVARIANCE, n)
        result.append(
            (np.linspace(0.0, 0.1 * (n - 1), n), nees(errors, np.broadcast_to(COVARIANCE, (n, 3, 3))))
        )
    return result


def test_nees_is_the_squared_length_in_standard_deviations() -> None:
    errors = np.array([[2.0, 0.0], [0.0, 3.0], [np.nan, 0.0]])
    covariances = np.broadcast_to(np.diag([4.0, 9.0]), (3, 2, 2))
    assert nees(errors, covariances) == pytest.approx([1.0, 1.0, np.nan], nan_ok=True)


def test_the_band_is_the_textbooks() -> None:
    # Bar-Shalom, Li, Kirubarajan, example 5.4.3: 50 runs, 2 states: 1.5 to 2.6
    assert band(2, 50) == pytest.approx((1.484, 2.591), abs=2e-3)


def test_an_honest_filter_lies_in_its_band_and_is_there_most_of_the_time() -> None:
    found = consistency(3, flights(20, 1.0))
    assert found.holds
    assert found.share_inside == pytest.approx(0.95, abs=0.05)
    assert (found.flights, len(found.time_s)) == (20, 209)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_filter_too_modest_or_too_sure_is_reported_apart(factor: float) -> None:
    found = consistency(3, flights(20, factor))
    assert not found.holds
    assert found.mean == pytest.approx(3.0 * factor**2, rel=0.05)
    assert found.share_inside < 0.2


def test_flights_without_an_estimate_do_not_count() -> None:
    nothing = (np.arange(3.0), np.full(3, np.nan))
    assert consistency(3, [nothing, *flights(4, 1.0)]).flights == 4
    assert math.isnan(consistency(3, [nothing]).mean)


TIMES = np.linspace(0.0, 9.5, 20)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([0.0] * 20, 0.0),
        ([9.0] * 6 + [0.0] * 14, 1.0),  # from 2 s on: the first good one is at 3 s
        ([9.0] * 6 + [0.0, 9.0] + [0.0] * 12, 2.0),  # a lull of half a second is no recovery
        ([9.0] * 20, math.inf),
        ([0.0] * 4 + [9.0, 0.0] * 8, math.inf),
    ],
)
def test_recovered_is_below_the_level_for_good(errors: list[float], expected: float) -> None:
    assert recovery_s(TIMES, np.array(errors), level=1.0, from_s=2.0) == expected


def test_a_flight_that_is_over_by_then_has_not_recovered() -> None:
    assert recovery_s(TIMES, np.zeros(20), level=1.0, from_s=50.0) == math.inf
