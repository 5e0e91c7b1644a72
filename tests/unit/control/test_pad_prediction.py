"""The pad's path over the horizon."""

import math

import numpy as np
import pytest

from companion.base.geometry import Vector3, rotate_yaw
from companion.base.messages import PadState
from companion.control.pad_prediction import origin_at_rest, predict_pad, turn_rate
from tests.unit.control.control_plants import PadMotion, circle, line, still

TIMES_S = np.linspace(0.0, 2.0, 21)


def _pad(velocity: Vector3, acceleration: Vector3, time_s: float = 0.0) -> PadState:
    down = (0.0, 0.0, 2.0)
    return PadState(
        time_s, down, (0.0, 0.0, 0.0), velocity, acceleration, 0.0, 0.0, 0.01, 0.02, seen_time_s=time_s
    )


@pytest.mark.parametrize("motion", [still, line, circle])
@pytest.mark.parametrize("at_s", [0.0, 3.7, 11.0])
def test_follows_a_pad_that_stands_goes_straight_or_turns(motion: PadMotion, at_s: float) -> None:
    place, velocity, acceleration = motion(at_s)
    path = predict_pad(_pad(velocity, acceleration, at_s), at_s + TIMES_S, 1.0)
    truth = [motion(at_s + t) for t in TIMES_S]
    np.testing.assert_allclose(path.displacement_m, np.array([m[0] for m in truth]) - place, atol=1e-9)
    np.testing.assert_allclose(path.velocity_m_s, np.array([m[1] for m in truth]), atol=1e-9)
    np.testing.assert_allclose(path.acceleration_m_s2, np.array([m[2] for m in truth]), atol=1e-9)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, 270.0])
def test_turning_left_and_right_at_every_course(yaw_deg: float) -> None:
    velocity = rotate_yaw((1.5, 0.0, 0.0), math.radians(yaw_deg))
    right = rotate_yaw((0.0, 0.45, 0.0), math.radians(yaw_deg))
    assert turn_rate(velocity, right) == pytest.approx(0.3)
    assert turn_rate(velocity, (-right[0], -right[1], 0.0)) == pytest.approx(-0.3)


def test_turn_rate_needs_speed_and_a_sensible_value() -> None:
    assert turn_rate((0.2, 0.0, 0.0), (0.0, 0.5, 0.0)) is None
    assert turn_rate((1.0, 0.0, 0.0), (0.5, 0.0, 0.0)) is None
    assert turn_rate((0.5, 0.0, 0.0), (0.0, 5.0, 0.0)) is None


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.2), (1.5, 0.0, 0.2)])
def test_rows_are_consistent_derivatives_and_unturned_acceleration_dies_away(velocity: Vector3) -> None:
    fine = np.linspace(0.0, 2.0, 2001)
    path = predict_pad(_pad(velocity, (0.3, 0.4, -0.5)), fine, 1.0)
    dt = fine[1]
    np.testing.assert_allclose(
        np.gradient(path.displacement_m, dt, axis=0)[1:-1], path.velocity_m_s[1:-1], atol=1e-5
    )
    np.testing.assert_allclose(
        np.gradient(path.velocity_m_s, dt, axis=0)[1:-1], path.acceleration_m_s2[1:-1], atol=1e-5
    )
    np.testing.assert_allclose(path.acceleration_m_s2[0], (0.3, 0.4, -0.5))
    assert path.acceleration_m_s2[-1, 2] == pytest.approx(-0.5 * math.exp(-2.0))


def test_an_origin_at_rest_stays() -> None:
    path = origin_at_rest(5)
    assert path.displacement_m.shape == path.velocity_m_s.shape == path.acceleration_m_s2.shape == (5, 3)
    assert not path.displacement_m.any()
