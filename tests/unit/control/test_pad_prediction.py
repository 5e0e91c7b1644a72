"""The pad's path over the horizon."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import ZERO3, Vector3, rotate_yaw
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


def test_a_bend_that_begins_is_carried_on_by_the_jerk_and_a_halt_is_not_driven_on() -> None:
    plain, bending = (
        _pad((2.0, 0.0, 0.0), ZERO3),
        replace(_pad((2.0, 0.0, 0.0), ZERO3), jerk_ned_m_s3=(0.0, 0.8, 0.0)),
    )
    soon = np.array([0.2])
    assert predict_pad(plain, soon, 1.0).acceleration_m_s2[0] == pytest.approx(ZERO3)
    assert predict_pad(bending, soon, 1.0).acceleration_m_s2[0] == pytest.approx((0.0, 0.145, 0.0), abs=1e-3)
    braking = replace(_pad((0.5, 0.0, 0.0), (-2.0, 0.0, 0.0)), jerk_ned_m_s3=(-3.0, 0.0, 0.0))
    assert predict_pad(braking, TIMES_S, 1.0).velocity_m_s[-1] == pytest.approx(ZERO3)


def test_turn_rate_needs_speed_and_a_sensible_value() -> None:
    assert turn_rate((0.2, 0.0, 0.0), (0.0, 0.5, 0.0)) is None
    assert turn_rate((1.0, 0.0, 0.0), (0.5, 0.0, 0.0)) is None
    assert turn_rate((0.5, 0.0, 0.0), (0.0, 5.0, 0.0)) is None


@pytest.mark.parametrize("jerk", [(0.0, 0.0, 0.0), (-0.2, 0.5, 0.0)])
@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.2), (1.5, 0.0, 0.2)])
def test_rows_are_consistent_derivatives_and_unturned_acceleration_dies_away(
    velocity: Vector3, jerk: Vector3
) -> None:
    fine = np.linspace(0.0, 2.0, 2001)
    path = predict_pad(replace(_pad(velocity, (0.3, 0.4, -0.5)), jerk_ned_m_s3=jerk), fine, 1.0)
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


def test_a_pad_that_brakes_halts_and_does_not_drive_backwards() -> None:
    fine = np.linspace(0.0, 2.0, 401)
    path = predict_pad(_pad((1.0, 0.0, 0.0), (-3.0, 0.0, 0.0)), fine, 1.0)
    assert path.velocity_m_s[:, 0].min() >= 0.0
    assert path.velocity_m_s[-1, 0] == path.acceleration_m_s2[-1, 0] == 0.0
    # 1 - 3 (1 - exp(-t)) = 0 at t = ln 1.5; there 1 t - 3 (t - 1 / 3) = 1 - 2 ln 1.5
    assert path.displacement_m[-1, 0] == pytest.approx(1.0 - 2.0 * math.log(1.5))


@pytest.mark.parametrize("course_deg", [0.0, 70.0, 200.0, 310.0])
@pytest.mark.parametrize("across_m_s2", [0.0, 0.05, 0.4, -0.9])
@pytest.mark.parametrize("speed_m_s", [0.15, 0.6, 2.0])
def test_the_speed_along_the_course_never_turns_round_and_the_rows_stay_derivatives(
    course_deg: float, across_m_s2: float, speed_m_s: float
) -> None:
    yaw = math.radians(course_deg)
    velocity = rotate_yaw((speed_m_s, 0.0, 0.0), yaw)
    braking = rotate_yaw((-3.0, across_m_s2, 0.0), yaw)
    fine = np.linspace(0.0, 2.0, 4001)
    path = predict_pad(_pad(velocity, braking), fine, 1.0)
    # along the course at the time: in a turn the course turns with the pad
    omega = turn_rate(velocity, braking) or 0.0
    along = [
        v @ np.array(rotate_yaw((1.0, 0.0, 0.0), yaw + omega * t))
        for t, v in zip(fine, path.velocity_m_s, strict=True)
    ]
    assert min(along) >= -1e-12
    smooth = np.abs(np.gradient(path.acceleration_m_s2, fine, axis=0)).max(axis=1) < 20.0  # not at the halt
    speeds = np.gradient(path.displacement_m, fine, axis=0)
    np.testing.assert_allclose(speeds[1:-1], path.velocity_m_s[1:-1], atol=2e-3)
    changes = np.gradient(path.velocity_m_s, fine, axis=0)
    np.testing.assert_allclose(changes[smooth][1:-1], path.acceleration_m_s2[smooth][1:-1], atol=5e-3)


def test_a_pad_that_gently_slows_down_as_before_never_halts() -> None:
    path = predict_pad(_pad((1.5, 0.0, 0.0), (-0.5, 0.0, 0.0)), TIMES_S, 1.0)
    np.testing.assert_allclose(path.velocity_m_s[:, 0], 1.5 - 0.5 * (1.0 - np.exp(-TIMES_S)))
