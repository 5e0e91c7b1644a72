"""The field reaches the vehicle's EKF only when the orientation pre-filter trusts it."""

import math
from dataclasses import replace

import pytest

from companion.base.geometry import Vector3, add, yaw_from_quat
from companion.base.messages import MagSample
from tests.unit.estimate.estimate_flight import EstimateFlight, feed, new_estimator

STANDING = EstimateFlight(
    path=lambda t: (0.0, 0.0, 0.0), heading=lambda t: 0.0, duration_s=10.0, sensors=frozenset({"imu", "mag"})
)
IRON_S = 5.0


def heading_and_doubt(iron_body_ut: Vector3, dead: bool = False) -> tuple[float, float]:
    """Heading and its standard deviation (degrees) after 5 s beside iron, or of a dead magnetometer."""
    estimator = new_estimator()
    for _, sample in STANDING.samples:
        taken = sample
        if isinstance(sample, MagSample) and sample.time_s > IRON_S:
            if dead:
                continue
            taken = replace(sample, field_body_ut=add(sample.field_body_ut, iron_body_ut))
        feed(estimator, taken)
    state, covariance = estimator.vehicle(10.0), estimator.vehicle_covariance()
    assert state is not None
    assert covariance is not None
    return math.degrees(yaw_from_quat(state.attitude)), math.degrees(math.sqrt(covariance[2, 2]))


@pytest.mark.parametrize("iron_body_ut", [(0.0, 30.0, 0.0), (0.0, 0.0, -30.0), (40.0, 0.0, 60.0)])
def test_a_field_of_the_wrong_size_or_dip_counts_as_none(iron_body_ut: Vector3) -> None:
    assert heading_and_doubt(iron_body_ut) == pytest.approx(
        heading_and_doubt((0.0, 0.0, 0.0), dead=True), abs=0.02
    )


def test_a_field_that_fits_is_taken() -> None:
    """One that is turned within its size and dip turns the heading; the doubt is the compass's own bias."""
    heading, with_field = heading_and_doubt((0.0, 0.0, 0.0))
    turned, _ = heading_and_doubt((0.0, 3.0, 0.0))
    _, without = heading_and_doubt((0.0, 0.0, 0.0), dead=True)
    assert abs(turned - heading) > 0.3
    assert with_field < without
