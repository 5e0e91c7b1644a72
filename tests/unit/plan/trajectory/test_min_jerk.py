import math

import numpy as np
import pytest

from companion.base.motion import Motion
from companion.plan.trajectory.min_jerk import Trajectory, brake, plan, quintic

START = Motion((1.0, -2.0, -7.0), (0.8, -0.3, 0.5), (0.2, 0.1, -0.4))
FINAL = Motion((4.0, 1.0, -3.0), (-0.5, 0.4, 0.2), (0.1, -0.2, 0.3))


def numeric(trajectory: Trajectory, t: float, h: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    before, here, after = (np.array(trajectory.at(t + d).position_m) for d in (-h, 0.0, h))
    return (after - before) / (2 * h), (after - 2 * here + before) / (h * h)


def test_coefficients_are_the_papers_when_the_end_is_at_rest() -> None:
    # GIVEN equation 30 with a final velocity and acceleration of zero
    x0, v0, a0, xf, t = 1.3, -0.7, 0.4, 5.1, 2.6
    delta = xf - x0
    paper = (
        x0,
        t * v0,
        t * t * a0 / 2,
        10 * delta - 6 * t * v0 - 1.5 * t * t * a0,
        -15 * delta + 8 * t * v0 + 1.5 * t * t * a0,
        6 * delta - 3 * t * v0 - 0.5 * t * t * a0,
    )
    assert quintic((x0, v0, a0), (xf, 0.0, 0.0), t) == pytest.approx(paper, abs=1e-12)


def test_both_ends_are_met_in_position_velocity_and_acceleration() -> None:
    trajectory = plan(START, FINAL, 10.0, 3.0)
    for time_s, wanted in ((10.0, START), (13.0, FINAL)):
        motion = trajectory.at(time_s)
        assert motion.position_m == pytest.approx(wanted.position_m, abs=1e-9)
        assert motion.velocity_m_s == pytest.approx(wanted.velocity_m_s, abs=1e-9)
        assert motion.acceleration_m_s2 == pytest.approx(wanted.acceleration_m_s2, abs=1e-9)


def test_velocity_and_acceleration_are_the_derivatives_of_position() -> None:
    trajectory = plan(START, FINAL, 10.0, 3.0)
    for t in (10.3, 11.5, 12.9):
        velocity, acceleration = numeric(trajectory, t)
        assert trajectory.at(t).velocity_m_s == pytest.approx(velocity, abs=1e-5)
        assert trajectory.at(t).acceleration_m_s2 == pytest.approx(acceleration, abs=1e-4)


def test_jerk_at_the_start_is_equation_34() -> None:
    rest = Motion((4.0, 1.0, -3.0))
    trajectory = plan(START, rest, 0.0, 3.0)
    h = 1e-6
    slope = (trajectory.at(h).acceleration_m_s2[0] - START.acceleration_m_s2[0]) / h
    v, a, t = START.velocity_m_s[0], START.acceleration_m_s2[0], 3.0
    expected = 60.0 / t**3 * 3.0 - 36.0 / t**2 * v - 9.0 / t * a
    assert slope == pytest.approx(expected, rel=1e-4)


def test_no_other_smooth_way_between_the_same_ends_has_less_jerk() -> None:
    # GIVEN the jerk of the quintic and of the quintic with a bump that leaves the ends alone
    tau = np.linspace(0.0, 1.0, 4001)
    c = quintic((0.0, 0.3, -0.2), (2.0, 0.1, 0.0), 1.0)
    jerk = 6 * c[3] + 24 * c[4] * tau + 60 * c[5] * tau**2
    bump = np.gradient(np.gradient(np.gradient(tau**4 * (1 - tau) ** 4, tau), tau), tau)
    for size in (-3.0, -0.1, 0.1, 3.0):
        assert np.trapezoid((jerk + size * bump) ** 2, tau) > np.trapezoid(jerk**2, tau)


def test_rows_are_the_trajectory_sampled_over_the_horizon_and_beyond_its_end() -> None:
    trajectory = plan(START, FINAL, 10.0, 1.25)
    position, velocity, acceleration = trajectory.rows(10.4, 21, 0.1)
    assert position.shape == velocity.shape == acceleration.shape == (21, 3)
    for k in range(21):
        motion = trajectory.at(10.4 + 0.1 * k)
        assert position[k] == pytest.approx(motion.position_m, abs=1e-9)
        assert velocity[k] == pytest.approx(motion.velocity_m_s, abs=1e-9)
        assert acceleration[k] == pytest.approx(motion.acceleration_m_s2, abs=1e-9)


def test_after_the_end_the_final_velocity_goes_on() -> None:
    motion = plan(START, FINAL, 10.0, 3.0).at(15.0)
    assert motion.position_m == pytest.approx((3.0, 1.8, -2.6), abs=1e-9)
    assert motion.velocity_m_s == pytest.approx(FINAL.velocity_m_s)
    assert motion.acceleration_m_s2 == (0.0, 0.0, 0.0)


def test_before_the_start_the_start_holds() -> None:
    assert plan(START, FINAL, 10.0, 3.0).at(9.0).position_m == START.position_m


def test_braking_ends_at_rest_ahead_and_stays_about_within_its_deceleration() -> None:
    trajectory = brake(Motion((0.0, 0.0, 0.0), (3.0, -4.0, 0.0)), 5.0, 1.5)
    end = trajectory.at(100.0)
    assert math.hypot(*end.velocity_m_s) == pytest.approx(0.0, abs=1e-9)
    assert end.position_m[0] > 0.0
    assert end.position_m[1] == pytest.approx(-4.0 / 3.0 * end.position_m[0])
    steepest = max(math.hypot(*trajectory.at(5.0 + 0.01 * k).acceleration_m_s2) for k in range(600))
    assert steepest == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, math.nan])
def test_a_trajectory_without_time_is_refused(duration_s: float) -> None:
    with pytest.raises(ValueError, match="takes time"):
        plan(START, FINAL, 0.0, duration_s)
