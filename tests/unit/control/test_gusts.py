"""A gust is told from the lean at once, on every course and heading; what lasts is left to the observer."""

import math

import pytest

from companion.control.attitude import attitude_from_acceleration
from companion.control.disturbance import GustObserver
from companion.geometry import Quaternion, Vector3, quat_from_euler, quat_multiply

PERIOD_S = 1.0 / 30.0
SENSOR_LAG_S = 0.035


def feel(
    gusts: GustObserver, attitude: Quaternion, acceleration: Vector3, seconds: float
) -> tuple[float, float, float]:
    for _ in range(round(seconds / PERIOD_S)):
        gusts.step(attitude, acceleration, PERIOD_S)
    return gusts.push_ned_m_s2


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_push_beyond_the_lean_is_found_within_a_fifth_of_a_second(heading_deg: float) -> None:
    lean = attitude_from_acceleration((0.8, -0.4, 0.0), math.radians(heading_deg))
    gusts = GustObserver(SENSOR_LAG_S)
    feel(gusts, lean, (0.8, -0.4, 0.0), 3.0)
    assert gusts.push_ned_m_s2 == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    push = feel(gusts, lean, (1.8, -1.4, 0.0), 0.2)
    assert push == pytest.approx((1.0, -1.0, 0.0), abs=0.15)


def test_what_lasts_is_forgotten() -> None:
    level = quat_from_euler(0.0, 0.0, 0.3)
    gusts = GustObserver(SENSOR_LAG_S)
    feel(gusts, level, (0.0, 0.0, 0.0), 1.0)
    feel(gusts, level, (1.0, 0.0, 0.0), 6.0 * GustObserver.FORGETTING_S)
    assert gusts.push_ned_m_s2 == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


def test_an_attitude_that_is_off_is_no_gust() -> None:
    truth = attitude_from_acceleration((0.5, 0.5, 0.0), 1.0)
    off = quat_multiply(truth, quat_from_euler(0.03, -0.02, 0.0))
    gusts = GustObserver(SENSOR_LAG_S)
    assert feel(gusts, off, (0.5, 0.5, 0.0), 0.5) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_climbing_vehicle_gets_more_from_the_same_lean() -> None:
    up = -2.0
    lean = attitude_from_acceleration((1.0, 0.0, up), 0.0)
    gusts = GustObserver(SENSOR_LAG_S)
    feel(gusts, quat_from_euler(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    push = feel(gusts, lean, (1.0, 0.0, up), 2.0)
    assert push == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_what_is_no_number_is_passed_over() -> None:
    level = quat_from_euler(0.0, 0.0, 0.0)
    gusts = GustObserver(SENSOR_LAG_S)
    feel(gusts, level, (0.0, 0.0, 0.0), 1.0)
    assert gusts.step(level, (math.nan, 0.0, 0.0), PERIOD_S) == pytest.approx((0.0, 0.0, 0.0))
    assert gusts.step((math.nan, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), PERIOD_S) == pytest.approx((0.0, 0.0, 0.0))


def test_the_sum_with_what_lasts_stays_within_its_bound() -> None:
    level = quat_from_euler(0.0, 0.0, 0.0)
    gusts = GustObserver(SENSOR_LAG_S)
    feel(gusts, level, (0.0, 0.0, 0.0), 1.0)
    feel(gusts, level, (2.0, -2.0, 0.0), 0.3)
    assert gusts.added_to((2.5, -2.5, 0.7), 3.0) == (3.0, -3.0, 0.7)
