"""Trajectory."""

import math
from itertools import pairwise

import numpy as np
import pytest

from companion.base.geometry import norm, subtract
from companion.base.motion import Motion
from companion.config import GuidanceConfig, PlanConfig
from companion.plan.trajectory.avoidance import Avoidance
from companion.plan.trajectory.course import Course, PlannedPath, halting, paced, through
from companion.plan.trajectory.min_jerk import HARD_STOP_M_S2, Trajectory, brake, carried, plan, quintic
from companion.plan.trajectory.reference_generator import ReferenceGenerator

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


# ---------------- test_course

COURSE_START = Motion((0.0, 1.0, -5.0), (1.0, -0.5, 0.2), (0.3, 0.1, -0.2))
COURSE_END = Motion((9.0, 4.0, -3.0), (0.0, 1.0, 0.0), (0.1, 0.0, 0.0))
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
    course = through(COURSE_START, VIA, COURSE_END, 10.0, DURATIONS_S)
    at_start = course.at(10.0)
    assert at_start.velocity_m_s == pytest.approx(COURSE_START.velocity_m_s)
    assert at_start.acceleration_m_s2 == pytest.approx(COURSE_START.acceleration_m_s2)
    at_end = course.at(course.end_s)
    assert at_end.position_m == pytest.approx(COURSE_END.position_m)
    assert at_end.velocity_m_s == pytest.approx(COURSE_END.velocity_m_s)
    assert at_end.acceleration_m_s2 == pytest.approx(COURSE_END.acceleration_m_s2)
    for when, point in zip(np.cumsum(DURATIONS_S), VIA, strict=False):
        assert course.at(10.0 + float(when)).position_m == pytest.approx(point)


def test_it_is_smooth_to_the_fourth_derivative() -> None:
    for before, after in pairwise(through(COURSE_START, VIA, COURSE_END, 0.0, DURATIONS_S).legs):
        for order in range(5):
            assert derivative(before, 1.0, order) == pytest.approx(derivative(after, 0.0, order), abs=1e-9)


def test_no_other_speeds_at_the_points_have_less_jerk() -> None:
    best = through(COURSE_START, VIA, COURSE_END, 0.0, DURATIONS_S)
    rng = np.random.default_rng(3)
    ends = [COURSE_START, *(leg.at(leg.start_s) for leg in best.legs[1:]), COURSE_END]
    for _ in range(20):
        moved = [COURSE_START]
        for m in ends[1:-1]:
            v, a = np.array(m.velocity_m_s), np.array(m.acceleration_m_s2)
            moved.append(
                Motion(
                    m.position_m,
                    tuple(v + 0.05 * rng.standard_normal(3)),
                    tuple(a + 0.05 * rng.standard_normal(3)),
                )
            )
        moved.append(COURSE_END)
        legs = tuple(plan(p, q, 0.0, t) for (p, q), t in zip(pairwise(moved), DURATIONS_S, strict=True))
        assert jerk_cost(Course(legs)) > jerk_cost(best)


def test_without_points_it_is_the_one_quintic() -> None:
    assert through(COURSE_START, [], COURSE_END, 2.0, [4.0]).legs == (
        plan(COURSE_START, COURSE_END, 2.0, 4.0),
    )


def test_rows_are_what_it_is_at_their_times_before_between_and_beyond() -> None:
    course = through(COURSE_START, VIA, COURSE_END, 10.0, DURATIONS_S)
    position, velocity, acceleration = course.rows(9.5, 30, 0.5)
    for k in range(30):
        motion = course.at(9.5 + 0.5 * k)
        assert position[k] == pytest.approx(motion.position_m)
        assert velocity[k] == pytest.approx(motion.velocity_m_s)
        assert acceleration[k] == pytest.approx(motion.acceleration_m_s2)


@pytest.mark.parametrize("durations", [[1.0], [1.0, 0.0]])
def test_durations_that_do_not_fit_are_refused(durations: list[float]) -> None:
    with pytest.raises(ValueError, match="durations"):
        through(COURSE_START, [(1.0, 1.0, 1.0)], COURSE_END, 0.0, durations)


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
    course = through(COURSE_START, VIA, COURSE_END, 10.0, DURATIONS_S)
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


# ---------------- test_reference_generator

CYCLE_S = 1.0 / 30.0
CONFIG = GuidanceConfig()


def constant_law(_d: float, _v: float, _a: float) -> float:
    return 1.0


def generator(config: GuidanceConfig = CONFIG) -> ReferenceGenerator:
    return ReferenceGenerator(config, constant_law, 20, 0.1)


def test_the_time_to_go_is_distance_over_speed_plus_the_least_time() -> None:
    g = generator()
    g.start("pad", Motion((0.0, 0.0, -7.0)), 0.0)
    g.fly_to(Motion((3.0, 4.0, -7.0)), 0.0)
    # eq. 37, where no limit asks for more
    assert g.time_to_go_s == pytest.approx(5.0 / 1.0 + CONFIG.minimum_time_s)
    assert g.speed_m_s == 1.0


def test_the_law_is_asked_with_distance_closing_speed_and_closing_acceleration() -> None:
    asked: list[tuple[float, float, float]] = []

    def law(d: float, v: float, a: float) -> float:
        asked.append((d, v, a))
        return 1.0

    g = ReferenceGenerator(CONFIG, law, 20, 0.1)
    g.start("pad", Motion((0.0, 0.0, 0.0), (0.6, 0.8, 0.0), (-0.3, -0.4, 0.0)), 0.0)
    g.fly_to(Motion((3.0, 4.0, 0.0), (0.0, 0.5, 0.0)), 0.0)
    # along (0.6, 0.8): closing at 1.0 less the target's own 0.4, and slowing at 0.5
    assert asked == [pytest.approx((5.0, 0.6, -0.5))]


def test_replanning_every_cycle_never_steps_in_position_velocity_or_acceleration() -> None:
    g = generator()
    g.start("pad", Motion((2.0, -1.0, -7.0), (1.5, 0.5, 0.0), (0.5, 0.0, 0.2)), 0.0)
    target = Motion((0.0, 0.0, -3.0))
    for k in range(1, 300):
        now = k * CYCLE_S
        if k == 100:
            target = Motion((1.0, 2.0, -1.0))
        before = g.at(now)
        g.fly_to(target, now)
        after = g.at(now)
        assert after.position_m == pytest.approx(before.position_m, abs=1e-9)
        assert after.velocity_m_s == pytest.approx(before.velocity_m_s, abs=1e-9)
        assert after.acceleration_m_s2 == pytest.approx(before.acceleration_m_s2, abs=1e-9)
    assert norm(subtract(g.at(10.0).position_m, target.position_m)) < 0.02


def test_speed_and_acceleration_stay_within_their_limits_however_fast_the_law() -> None:
    g = ReferenceGenerator(CONFIG, lambda _d, _v, _a: 50.0, 20, 0.1)
    g.start("pad", Motion((0.0, 0.0, -10.0)), 0.0)
    for k in range(600):
        now = k * CYCLE_S
        g.fly_to(Motion((12.0, -9.0, -2.0)), now)
        v, a = g.at(now).velocity_m_s, g.at(now).acceleration_m_s2
        assert math.hypot(v[0], v[1]) <= 1.1 * CONFIG.horizontal_speed_m_s
        assert abs(v[2]) <= 1.1 * CONFIG.vertical_speed_m_s
        assert math.hypot(a[0], a[1]) <= 1.1 * CONFIG.horizontal_acceleration_m_s2
        assert abs(a[2]) <= 1.1 * CONFIG.vertical_acceleration_m_s2
    assert norm(subtract(g.at(20.0).position_m, (12.0, -9.0, -2.0))) < 0.05


def test_descending_onto_a_height_overshoots_it_by_centimetres_at_most() -> None:
    g = generator()
    g.start("pad", Motion((0.0, 0.0, -3.2)), 0.0)
    lowest = math.inf
    for k in range(400):
        g.fly_to(Motion((0.0, 0.0, -0.53)), k * CYCLE_S)
        lowest = min(lowest, -g.at(k * CYCLE_S).position_m[2])
    assert 0.48 < lowest <= 0.531


def test_a_moving_target_is_met_at_its_own_velocity() -> None:
    g = generator()
    g.start("local", Motion((0.0, 0.0, -7.0)), 0.0)
    for k in range(400):
        now = k * CYCLE_S
        g.fly_to(Motion((5.0 + 1.5 * now, -2.0 * now, -7.0), (1.5, -2.0, 0.0)), now)
    now = 400 * CYCLE_S
    assert g.at(now).position_m == pytest.approx((5.0 + 1.5 * now, -2.0 * now, -7.0), abs=0.02)
    assert g.at(now).velocity_m_s == pytest.approx((1.5, -2.0, 0.0), abs=0.02)


def test_changing_the_frame_keeps_the_motion_in_space() -> None:
    pad = Motion((10.0, -3.0, 0.5), (1.0, 2.0, -0.2), (0.3, 0.0, 0.1))
    start = Motion((4.0, 5.0, -6.0), (0.5, -0.5, 0.1), (0.1, 0.2, 0.0))
    g = generator()
    g.start("local", start, 3.0)
    g.change_frame("pad", pad, 3.0)
    assert g.origin == "pad"
    assert g.at(3.0).position_m == pytest.approx((-6.0, 8.0, -6.5))
    assert g.at(3.0).velocity_m_s == pytest.approx((-0.5, -2.5, 0.3))
    g.change_frame("local", pad, 3.0)
    assert g.at(3.0).position_m == pytest.approx(start.position_m)
    assert g.at(3.0).velocity_m_s == pytest.approx(start.velocity_m_s)
    assert g.at(3.0).acceleration_m_s2 == pytest.approx(start.acceleration_m_s2)


def test_only_an_estimate_beyond_the_bound_is_taken_up() -> None:
    g = generator()
    g.start("pad", Motion((0.0, 0.0, -3.0)), 0.0)
    assert g.keep_near(Motion((0.79, 0.0, -3.0)), 1.0) == 0.0
    assert g.at(1.0).position_m == (0.0, 0.0, -3.0)
    assert g.keep_near(Motion((0.81, 0.0, -3.0), (0.2, 0.0, 0.0)), 1.0) == pytest.approx(0.81)
    assert g.at(1.0).position_m == (0.81, 0.0, -3.0)
    assert g.at(1.0).velocity_m_s == pytest.approx((0.2, 0.0, 0.0))


def test_sinking_blends_into_a_constant_speed_that_goes_on_below_the_surface() -> None:
    g = generator()
    g.start("pad", Motion((0.01, -0.02, -0.53)), 0.0)
    depth = g.sink(0.22, 0.8, 0.0)
    assert depth == pytest.approx(0.088)
    assert g.at(0.8).position_m == pytest.approx((0.0, 0.0, -0.53 + 0.088), abs=1e-9)
    assert g.at(5.0).velocity_m_s == pytest.approx((0.0, 0.0, 0.22))
    assert g.at(5.0).position_m[2] > 0.0


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("offset_deg", [-100.0, 100.0])
def test_the_heading_slews_the_short_way_at_its_rate(quarter: int, offset_deg: float) -> None:
    start = math.radians(90.0 * quarter)
    wanted = start + math.radians(offset_deg)
    g = generator()
    g.heading_rad = start
    g.turn(None, 0.0)
    g.turn(wanted, 1.0)
    turned = math.degrees(math.remainder(g.heading_rad - start, math.tau))
    assert turned == pytest.approx(math.copysign(30.0, offset_deg))
    for k in range(1, 4):
        g.turn(wanted, 1.0 + k)
    assert math.remainder(g.heading_rad - wanted, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("pad_deg_s", [-40.0, 26.0, 40.0])
def test_a_pad_that_turns_is_caught_up_with_at_the_rate(pad_deg_s: float) -> None:
    g, rate = generator(), math.radians(pad_deg_s)
    pad_rad = math.copysign(math.radians(75.0), pad_deg_s)
    g.turn(None, 0.0)
    behind_deg = []
    for second in (1.0, 2.0, 3.0):
        now_rad = pad_rad + rate * second
        g.turn(now_rad, second, rate)
        behind_deg.append(abs(math.degrees(math.remainder(now_rad - g.heading_rad, math.tau))))
    assert behind_deg == pytest.approx([45.0, 15.0, 0.0], abs=1e-9)


def test_without_a_wish_the_heading_stays_and_no_rate_is_saved_up() -> None:
    g = generator()
    g.turn(None, 0.0)
    g.turn(None, 60.0)
    g.turn(1.0, 60.1)
    assert g.heading_rad == pytest.approx(math.radians(3.0))


def test_the_reference_holds_the_horizon_from_now_on() -> None:
    g = generator()
    assert g.reference(0.0) is None
    g.start("pad", Motion((1.0, 2.0, -5.0), (0.5, 0.0, 0.0)), 4.0)
    reference = g.reference(4.5)
    assert reference is not None
    assert reference.position_m.shape == (21, 3)
    assert reference.time_s == 4.5
    for k in (0, 7, 20):
        np.testing.assert_allclose(reference.position_m[k], g.at(4.5 + 0.1 * k).position_m, atol=1e-9)


def test_asking_for_the_state_of_no_reference_is_an_error() -> None:
    g = generator()
    g.start("pad", Motion((0.0, 0.0, 0.0)), 0.0)
    g.stop()
    assert not g.active
    with pytest.raises(RuntimeError, match="no reference"):
        g.at(0.0)


def level_flight(lowest_down_m: float) -> tuple[ReferenceGenerator, list[Motion]]:
    """From a climb or sink of 1 m/s on, towards a point that moves and (by its own word) rises."""
    g = generator()
    g.start("local", Motion((0.0, 0.0, -4.0), (0.5, 0.0, 0.0)), 0.0)
    g.sink(1.0, 0.3, 0.0)
    way = []
    for k in range(9, 240):
        now = k * CYCLE_S
        g.fly_level(Motion((3.0 + 0.5 * now, 1.0, 9.0), (0.5, 0.0, -2.0)), lowest_down_m, now)
        way.append(g.at(now))
    return g, way


def test_level_flight_stops_a_sink_at_once_and_goes_on_horizontally() -> None:
    _, way = level_flight(math.inf)
    begun_m = way[0].position_m[2]
    assert max(m.position_m[2] for m in way) < begun_m + 0.45
    # within a second it stands, and then keeps that height to the millimetre
    settled = [m.position_m[2] for m in way[30:]]
    assert max(settled) - min(settled) < 1e-3
    assert way[-1].position_m[:2] == pytest.approx((3.0 + 0.5 * 239 * CYCLE_S, 1.0), abs=0.05)
    assert way[-1].velocity_m_s[0] == pytest.approx(0.5, abs=0.02)


def test_level_flight_climbs_to_its_floor_without_a_step() -> None:
    g, way = level_flight(-5.0)
    assert way[-1].position_m[2] == pytest.approx(-5.0, abs=0.02)
    assert min(m.position_m[2] for m in way) > -5.05
    assert max(abs(m.velocity_m_s[2]) for m in way) <= CONFIG.vertical_speed_m_s + 0.01
    for before, after in pairwise(way):
        assert norm(subtract(after.velocity_m_s, before.velocity_m_s)) < 4.0 * CYCLE_S
    now = 239 * CYCLE_S
    reference = g.reference(now)
    assert reference is not None
    for k, row in enumerate(reference.position_m):
        assert row == pytest.approx(g.at(now + k * reference.step_s).position_m, abs=1e-9)


def test_level_flight_goes_on_with_a_climb_to_its_floor() -> None:
    g = generator()
    g.start("local", Motion((0.0, 0.0, -4.0)), 0.0)
    g.rise(0.0)
    now = 0.4
    assert g.fly_level(Motion((3.0, 1.0, 0.0)), -5.0, now) > 0.8
    speeds_m_s = [g.at(now + k * CYCLE_S).velocity_m_s[2] for k in range(60)]
    assert max(speeds_m_s) < 0.0  # it never stops


def test_a_rise_slows_no_climb_that_is_faster() -> None:
    g = generator()
    g.start("local", Motion((0.0, 0.0, -4.0)), 0.0)
    g.sink(-0.5, 0.5, 0.0)
    g.rise(0.6)
    assert max(g.at(0.6 + k * CYCLE_S).velocity_m_s[2] for k in range(30)) == pytest.approx(-0.5)


def test_what_is_blown_off_its_way_goes_on_climbing() -> None:
    g = generator()
    g.start("local", Motion((0.0, 0.0, -4.0)), 0.0)
    for k in range(60):
        g.fly_level(Motion((9.0, 0.0, 0.0)), -6.0, k * CYCLE_S)
    now, aim = 60 * CYCLE_S, Motion((9.0, 0.0, 0.0))
    before = g.at(now)
    x, y, z = before.position_m
    assert g.keep_near(Motion((x - 1.0, y, z + 0.3), (-1.0, 0.0, 0.2)), now) > 0.8
    assert g.at(now).position_m == pytest.approx((x - 1.0, y, z))
    assert g.at(now).velocity_m_s == pytest.approx((-1.0, 0.0, before.velocity_m_s[2]))
    g.fly_level(aim, -6.0, now)
    assert g.at(now + 3.0).position_m[2] < z - 1.0
    # but one that is itself far below starts anew from there
    assert g.keep_near(Motion((x - 1.0, y, z + 1.0)), now) > 0.8
    assert g.at(now).position_m[2] == z + 1.0


def test_level_flight_ends_with_the_next_plan() -> None:
    g, way = level_flight(math.inf)
    now = 240 * CYCLE_S
    g.fly_to(Motion((5.0, 1.0, -6.0)), now)
    assert g.at(now).position_m[2] == pytest.approx(way[-1].position_m[2], abs=1e-3)
    assert g.resting_place_m() == pytest.approx((5.0, 1.0, -6.0))


def test_an_acceleration_at_the_start_beyond_the_limits_does_not_draw_the_way_out_for_ever() -> None:
    g = generator()
    # as after a climb that was broken off: still rising, and pushed down harder than the plan may
    g.start("local", Motion((0.0, 0.0, -0.5), (-1.3, 0.6, -0.3), (0.3, 0.2, 1.4)), 0.0)
    lowest_m = -0.5
    for k in range(1, 200):
        g.fly_to(Motion((20.0, 5.0, -6.0), (1.0, 0.0, 0.0)), k * CYCLE_S)
        lowest_m = max(lowest_m, g.at(k * CYCLE_S).position_m[2])
        assert g.time_to_go_s < 200.0
    assert lowest_m < 0.3
    assert g.at(200 * CYCLE_S).velocity_m_s[2] < 0.0


def test_a_way_round_obstacles_keeps_its_own_heights() -> None:
    start, target = Motion((0.0, 0.0, -5.0)), Motion((10.0, 0.0, -5.0))
    course = paced(start, [(5.0, 0.0, -3.0)], target, 0.0, CONFIG)

    class Leading(Avoidance):
        def way(self, *_: object, **__: object) -> PlannedPath:
            return course

    led = ReferenceGenerator(CONFIG, constant_law, 20, 0.1, Leading(PlanConfig(), 0.3))
    led.start("local", start, 0.0)
    for k in range(40):
        now_s = 0.1 * k
        led.fly_to(target, now_s)
        assert led.at(now_s).position_m == pytest.approx(course.at(now_s).position_m)


@pytest.mark.parametrize("upwards", [1.0, -1.0])
def test_a_climb_or_sink_at_the_start_is_stopped_before_the_way_to_a_goal_on_the_other_side(
    upwards: float,
) -> None:
    g = generator()
    # as after a hold that stopped a descent: pushed up, harder than the plan may, the pad far below
    g.start("pad", Motion((0.2, -0.1, -5.0), (0.3, 0.2, -0.9 * upwards), (-0.5, 0.4, -2.6 * upwards)), 0.0)
    farthest_m = 0.0
    for k in range(1, 600):
        now = k * CYCLE_S
        g.fly_to(Motion((0.0, 0.0, -5.0 + 4.0 * upwards)), now)
        farthest_m = max(farthest_m, upwards * (-5.0 - g.at(now).position_m[2]))
    assert farthest_m < 1.0
    assert g.at(600 * CYCLE_S).position_m == pytest.approx((0.0, 0.0, -5.0 + 4.0 * upwards), abs=0.02)


@pytest.mark.parametrize(("height_m", "sink_m_s", "goal_m"), [(5.0, 1.2, 7.0), (1.0, 0.8, 1.68)])
def test_levelling_off_is_flown_as_it_was_planned(height_m: float, sink_m_s: float, goal_m: float) -> None:
    sinking = Motion((0.0, 0.0, -height_m), (0.0, 0.0, sink_m_s))
    stop = brake(sinking, 0.0, HARD_STOP_M_S2)
    planned_m = -stop.at(stop.end_s).position_m[2]
    g = generator()
    g.start("pad", sinking, 0.0)
    lowest_m = height_m
    for k in range(300):
        g.fly_to(Motion((0.0, 0.0, -goal_m)), k * CYCLE_S)
        lowest_m = min(lowest_m, -g.at((k + 1) * CYCLE_S).position_m[2])
    assert lowest_m == pytest.approx(planned_m, abs=0.02)
    assert g.at(300 * CYCLE_S).position_m[2] == pytest.approx(-goal_m, abs=0.02)
