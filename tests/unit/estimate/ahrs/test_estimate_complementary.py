"""The orientation pre-filter (eqs. 14-16): the blend, and when it believes which sensor."""

import math

import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    IDENTITY,
    Quaternion,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.estimate.ahrs.complementary import OrientationFilter, blend, shortest_turn
from tests.attitudes import between_deg
from tests.unit.estimate.at_rest import DOWN_FORCE, FIELD

STILL = (0.0, 0.0, 0.0)


def new_filter(attitude: Quaternion = IDENTITY) -> OrientationFilter:
    return OrientationFilter(FIELD, attitude)


def test_blend_weighs_by_the_ratio_of_error_rates() -> None:
    q, r = IDENTITY, quat_from_euler(0.0, 0.0, 0.02)
    # e_am = |r - q| / dt = 0.01 / 0.01 = 1 per second, e_ω = 3: three quarters of the way
    assert between_deg(blend(q, r, 3.0, 0.01), q) == pytest.approx(math.degrees(0.015), rel=1e-3)


def test_blend_takes_the_nearer_sign() -> None:
    q, r = quat_from_euler(0.1, 0.2, 0.3), quat_from_euler(0.1, 0.2, 0.4)
    flipped = (-r[0], -r[1], -r[2], -r[3])
    assert blend(q, flipped, 0.5, 0.01) == blend(q, r, 0.5, 0.01)


def test_blend_of_equals_is_the_same_and_of_unit_length() -> None:
    q = quat_from_euler(0.1, 0.2, 0.3)
    assert blend(q, q, 0.0, 0.01) == q
    assert sum(value * value for value in blend(q, IDENTITY, 1.0, 1.0)) == pytest.approx(1.0)


def test_a_step_is_never_longer_than_the_gyroscopes_error() -> None:
    turned = blend(IDENTITY, quat_from_euler(0.0, 0.0, 3.0), 0.01, 0.005)
    # the rate is the quaternion's: half the angle
    assert between_deg(turned, IDENTITY) <= math.degrees(2 * 0.01 * 0.005) * 1.1


def test_shortest_turn_brings_one_direction_onto_another_even_when_opposite() -> None:
    for start in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.6, 0.8, 0.0)):
        for end in ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (-0.6, -0.8, 0.0)):
            assert quat_rotate(shortest_turn(start, end), start) == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_converges_to_gravity_and_north(yaw_deg: int) -> None:
    q = quat_from_euler(0.15, -0.1, math.radians(yaw_deg))
    estimate = new_filter(quat_multiply(quat_from_euler(0.05, -0.05, 0.1), q))
    for _ in range(4000):
        estimate.update_imu(STILL, quat_rotate_inverse(q, DOWN_FORCE), 0.005)
        estimate.update_mag(quat_rotate_inverse(q, FIELD), 0.005)
    assert between_deg(estimate.attitude, q) < 0.1


def test_short_burst_of_acceleration_hardly_tilts() -> None:
    estimate = new_filter()
    for _ in range(100):
        estimate.update_imu(STILL, (4.0, 0.0, -GRAVITY_M_S2), 0.005)
    # the accelerometer alone would say 22 degrees
    assert math.degrees(tilt_from_quat(estimate.attitude)) < 0.7


def test_accelerometer_is_left_out_while_it_does_not_measure_gravity() -> None:
    estimate = new_filter()
    for _ in range(2000):
        estimate.update_imu(STILL, (3.0, 0.0, -1.3 * GRAVITY_M_S2), 0.005)
    assert estimate.gravity_error_m_s2 > 2.0
    tilt = tilt_from_quat(estimate.attitude)
    for _ in range(400):
        estimate.update_imu(STILL, (3.0, 0.0, -1.3 * GRAVITY_M_S2), 0.005)
    assert tilt_from_quat(estimate.attitude) == pytest.approx(tilt, abs=1e-9)


def test_magnetometer_turns_the_heading_and_never_the_tilt() -> None:
    q = quat_from_euler(0.2, 0.1, 0.0)
    estimate = new_filter(q)
    field = quat_rotate_inverse(quat_from_euler(0.2, 0.1, 0.1), FIELD)
    for _ in range(1000):
        estimate.update_mag(field, 0.02)
    assert tilt_from_quat(estimate.attitude) == pytest.approx(tilt_from_quat(q), abs=1e-9)
    assert yaw_from_quat(estimate.attitude) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("disturbed", [(31.0, 0.6, 60.0), (42.9, 0.6, 20.9), (0.0, 0.0, 47.7)])
def test_field_of_wrong_size_or_dip_is_not_trusted(disturbed: tuple[float, float, float]) -> None:
    estimate = new_filter(quat_from_euler(0.0, 0.0, 0.3))
    before = estimate.attitude
    estimate.update_mag(quat_rotate_inverse(before, disturbed), 0.02)
    assert not estimate.mag_trusted
    assert estimate.attitude == before
    estimate.update_mag(quat_rotate_inverse(before, FIELD), 0.02)
    assert estimate.mag_trusted
