from itertools import pairwise

import numpy as np
import pytest

from companion.base.motion import Motion
from companion.config import GuidanceConfig
from companion.plan.trajectory.course import Course, halting, paced, through
from companion.plan.trajectory.min_jerk import Trajectory, carried, plan

START = Motion((0.0, 1.0, -5.0), (1.0, -0.5, 0.2), (0.3, 0.1, -0.2))
FINAL = Motion((9.0, 4.0, -3.0), (0.0, 1.0, 0.0), (0.1, 0.0, 0.0))
VIA = [(3.0, 4.0, -5.0), (4.0, 4.5, -6.0), (7.0, -1.0, -4.0)]
DURATIONS_S = [3.0, 1.2, 4.0, 3.5]
LIMITS = GuidanceConfig()


def derivative(leg: Trajectory, tau: float, order: int) -> np.ndarray:
    """Of a leg's position by time, from its coefficients."""
    values = [
        np.polynomial.Polynomial(c).deriv(order)(tau) if order else np.polynomial.Polynomial(c)(tau)
        for c in leg.axes
    ]
    return np.array(values) / leg.duration_s**order


def jerk_cost(course: Course) -> float:
    """Integral of the squared jerk."""
    total = 0.0
    for leg in course.legs:
        for c in leg.axes:
            square = (np.polynomial.Polynomial(c).deriv(3) ** 2).integ()
            total += (square(1.0) - square(0.0)) / leg.duration_s**5
    return total


def test_it_passes_through_every_point_in_time_and_keeps_both_ends() -> None:
    course = through(START, VIA, FINAL, 10.0, DURATIONS_S)
    at_start = course.at(10.0)
    assert at_start.velocity_m_s == pytest.approx(START.velocity_m_s)
    assert at_start.acceleration_m_s2 == pytest.approx(START.acceleration_m_s2)
    at_end = course.at(course.end_s)
    assert at_end.position_m == pytest.approx(FINAL.position_m)
    assert at_end.velocity_m_s == pytest.approx(FINAL.velocity_m_s)
    assert at_end.acceleration_m_s2 == pytest.approx(FINAL.acceleration_m_s2)
    for when, point in zip(np.cumsum(DURATIONS_S), VIA, strict=False):
        assert course.at(10.0 + float(when)).position_m == pytest.approx(point)


def test_it_is_smooth_to_the_fourth_derivative() -> None:
    for before, after in pairwise(through(START, VIA, FINAL, 0.0, DURATIONS_S).legs):
        for order in range(5):
            assert derivative(before, 1.0, order) == pytest.approx(derivative(after, 0.0, order), abs=1e-9)


def test_no_other_speeds_at_the_points_have_less_jerk() -> None:
    best = through(START, VIA, FINAL, 0.0, DURATIONS_S)
    rng = np.random.default_rng(3)
    ends = [START, *(leg.at(leg.start_s) for leg in best.legs[1:]), FINAL]
    for _ in range(20):
        moved = [START]
        for m in ends[1:-1]:
            v, a = np.array(m.velocity_m_s), np.array(m.acceleration_m_s2)
            moved.append(
                Motion(
                    m.position_m,
                    tuple(v + 0.05 * rng.standard_normal(3)),
                    tuple(a + 0.05 * rng.standard_normal(3)),
                )
            )
        moved.append(FINAL)
        legs = tuple(plan(p, q, 0.0, t) for (p, q), t in zip(pairwise(moved), DURATIONS_S, strict=True))
        assert jerk_cost(Course(legs)) > jerk_cost(best)


def test_without_points_it_is_the_one_quintic() -> None:
    assert through(START, [], FINAL, 2.0, [4.0]).legs == (plan(START, FINAL, 2.0, 4.0),)


def test_rows_are_what_it_is_at_their_times_before_between_and_beyond() -> None:
    course = through(START, VIA, FINAL, 10.0, DURATIONS_S)
    position, velocity, acceleration = course.rows(9.5, 30, 0.5)
    for k in range(30):
        motion = course.at(9.5 + 0.5 * k)
        assert position[k] == pytest.approx(motion.position_m)
        assert velocity[k] == pytest.approx(motion.velocity_m_s)
        assert acceleration[k] == pytest.approx(motion.acceleration_m_s2)


@pytest.mark.parametrize("durations", [[1.0], [1.0, 0.0]])
def test_durations_that_do_not_fit_are_refused(durations: list[float]) -> None:
    with pytest.raises(ValueError, match="durations"):
        through(START, [(1.0, 1.0, 1.0)], FINAL, 0.0, durations)


@pytest.mark.parametrize("make", [paced, halting])
@pytest.mark.parametrize("target_m_s", [0.0, 4.0])
def test_it_keeps_the_limits_and_meets_a_target_that_moves(make: object, target_m_s: float) -> None:
    target = Motion((30.0, 2.0, -3.0), (0.0, target_m_s, 0.0))
    course = make(Motion((0.0, 0.0, -5.0)), VIA, target, 1.0, LIMITS)  # type: ignore[operator]
    end = course.at(course.end_s)
    assert end.position_m[1] == pytest.approx(2.0 + target_m_s * course.duration_s)
    assert end.velocity_m_s == pytest.approx(target.velocity_m_s, abs=1e-9)
    _, v, a = course.rows(1.0, 500, course.duration_s / 499)
    if make is halting and target_m_s > 0.0:
        return  # what has to be made up for from a halt is
    most_m_s = max(LIMITS.horizontal_speed_m_s, target_m_s) + target_m_s
    assert np.max(np.hypot(v[:, 0], v[:, 1])) <= 1.06 * most_m_s
    assert np.max(np.abs(v[:, 2])) <= 1.06 * LIMITS.vertical_speed_m_s
    if make is paced:
        assert np.max(np.hypot(a[:, 0], a[:, 1])) <= 1.12 * LIMITS.horizontal_acceleration_m_s2
        assert np.max(np.abs(a[:, 2])) <= 1.12 * LIMITS.vertical_acceleration_m_s2


def test_with_halts_it_keeps_to_the_straight_lines() -> None:
    course = halting(Motion((0.0, 0.0, -5.0)), VIA, Motion((9.0, 4.0, -3.0)), 0.0, LIMITS)
    for leg in course.legs:
        p, q = (np.array(leg.at(t).position_m) for t in (leg.start_s, leg.end_s))
        for k in np.linspace(0.0, 1.0, 9):
            along = np.array(leg.at(leg.start_s + k * leg.duration_s).position_m) - p
            assert np.linalg.norm(np.cross(along, q - p)) == pytest.approx(0.0, abs=1e-9)


def test_seen_from_a_moving_frame_it_is_the_same_motion() -> None:
    course = through(START, VIA, FINAL, 10.0, DURATIONS_S)
    seen = course.carried(Motion((1.0, 2.0, 3.0), (0.5, -0.25, 0.1)), 8.0)
    for t in (10.0, 13.7, 20.0, 25.0):
        expected = (
            np.array(course.at(t).position_m) + [1.0, 2.0, 3.0] + (t - 8.0) * np.array([0.5, -0.25, 0.1])
        )
        assert seen.at(t).position_m == pytest.approx(expected)
        assert seen.at(t).acceleration_m_s2 == pytest.approx(course.at(t).acceleration_m_s2)


def test_a_leg_is_carried_along_with_a_frame_that_gains_speed() -> None:
    leg = plan(Motion((1.0, 2.0, -3.0), (0.5, 0.0, 0.2)), Motion((4.0, 0.0, -5.0)), 10.0, 4.0)
    by = Motion((2.0, -1.0, 0.5), (0.5, -0.25, 0.1), (0.4, 0.3, -0.2))
    seen = carried(leg, by, 9.0)
    for time_s in (10.0, 11.5, 14.0):
        t, own, there = time_s - 9.0, leg.at(time_s), seen.at(time_s)
        for k in range(3):
            p, v, a = by.position_m[k], by.velocity_m_s[k], by.acceleration_m_s2[k]
            assert there.position_m[k] == pytest.approx(own.position_m[k] + p + v * t + 0.5 * a * t * t)
            assert there.velocity_m_s[k] == pytest.approx(own.velocity_m_s[k] + v + a * t)
            assert there.acceleration_m_s2[k] == pytest.approx(own.acceleration_m_s2[k] + a)
