"""Acceleration to attitude and thrust, at all headings and tilts."""

import math

import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    Vector3,
    euler_from_quat,
    horizontal_acceleration,
    norm,
    quat_rotate,
    tilt_from_quat,
    yaw_from_quat,
)
from companion.control.attitude import (
    attitude_from_acceleration,
    force_from_acceleration,
    thrust_from_acceleration,
)

HEADINGS_DEG = (0.0, 90.0, 180.0, 270.0, 33.0)
ACCELERATIONS: tuple[Vector3, ...] = (
    (0.0, 0.0, 0.0),
    (2.0, 0.0, 0.0),
    (0.0, -2.0, 0.0),
    (-3.0, 1.5, -2.0),
    (1.0, 1.0, 3.0),
)


@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
@pytest.mark.parametrize("acceleration", ACCELERATIONS)
def test_pushing_along_the_bodys_up_axis_gives_the_acceleration_back(
    heading_deg: float, acceleration: Vector3
) -> None:
    attitude = attitude_from_acceleration(acceleration, math.radians(heading_deg))
    thrust = thrust_from_acceleration(acceleration, 0.5)
    force = quat_rotate(attitude, (0.0, 0.0, -thrust / 0.5 * GRAVITY_M_S2))
    flown = (force[0], force[1], force[2] + GRAVITY_M_S2)
    assert flown == pytest.approx(acceleration, abs=1e-9)
    turned = math.remainder(yaw_from_quat(attitude) - math.radians(heading_deg), math.tau)
    assert turned == pytest.approx(0.0, abs=1e-9)


def test_accelerating_north_noses_down_when_looking_north_and_rolls_left_when_looking_east() -> None:
    north = euler_from_quat(attitude_from_acceleration((2.0, 0.0, 0.0), 0.0))
    assert north[1] == pytest.approx(-math.atan2(2.0, GRAVITY_M_S2))
    assert north[0] == pytest.approx(0.0, abs=1e-12)
    east = euler_from_quat(attitude_from_acceleration((2.0, 0.0, 0.0), math.pi / 2))
    assert east[0] == pytest.approx(-math.atan2(2.0, GRAVITY_M_S2))
    assert east[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("heading_deg", HEADINGS_DEG)
def test_level_acceleration_reads_an_attitude_back(heading_deg: float) -> None:
    attitude = attitude_from_acceleration((1.2, -0.7, 0.0), math.radians(heading_deg))
    assert horizontal_acceleration(attitude) == pytest.approx((1.2, -0.7))


def test_level_flight_hovers_at_hover_thrust() -> None:
    assert thrust_from_acceleration((0.0, 0.0, 0.0), 0.43) == pytest.approx(0.43)
    assert thrust_from_acceleration((0.0, 0.0, -GRAVITY_M_S2), 0.43) == pytest.approx(0.86)


def test_falling_faster_than_gravity_never_turns_the_vehicle_over() -> None:
    attitude = attitude_from_acceleration((0.5, 0.0, 30.0), 0.0)
    assert force_from_acceleration((0.5, 0.0, 30.0))[2] < 0.0
    assert tilt_from_quat(attitude) < math.radians(20.0)
    assert norm(attitude[1:]) < 0.2
