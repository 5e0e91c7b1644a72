"""The MPC within its constraints: input and state bounds, thrust, tilt, floor and cone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3, add, vector3
from companion.base.motion import Motion
from companion.config import LimitsConfig
from companion.control.mpc.mpc import ACCEPTED_PRIMAL, Mpc
from companion.control.mpc.target import within_reach
from companion.control.response.flight_model import advance
from companion.control.tracking import Cone, Target
from tests.unit.control.mpc.mpc_cases import CONFIG, DT, LAGS_S, N, hover_at


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, 180.0, 225.0, 270.0])
def test_a_far_goal_meets_every_bound_and_uses_the_room(direction_deg: float) -> None:
    limits = LimitsConfig(horizontal_speed_m_s=4.0)
    angle = math.radians(direction_deg)
    goal = (40.0 * math.cos(angle), 40.0 * math.sin(angle), -20.0)
    config = CONFIG.model_copy(update={"limits": limits})
    mpc, motion, last = Mpc(config, LAGS_S), Motion(ZERO3, ZERO3, ZERO3), ZERO3
    fastest = hardest = 0.0
    for k in range(150):
        target = within_reach(hover_at(goal), motion.position_m, 3.3, 1.2)
        solution = mpc.solve(motion, target, ZERO3, last)
        assert solution.solved or k < 3  # a cold start may take more iterations than one step has
        u = solution.inputs_m_s2
        tilt = math.tan(math.radians(limits.tilt_deg)) * 9.80665
        most = min(tilt, limits.horizontal_acceleration_m_s2)
        assert np.hypot(u[:, 0], u[:, 1]).max() <= most + 5e-3
        assert np.abs(u[:, 2]).max() <= limits.vertical_acceleration_m_s2 + 5e-3
        assert np.abs(np.diff(u, axis=0)).max() <= limits.jerk_m_s3 * DT + 5e-3
        assert np.abs(u[0] - last).max() <= limits.jerk_m_s3 / CONFIG.rate_hz + 5e-3
        speeds = solution.states[:, 3:6]
        assert np.hypot(speeds[:, 0], speeds[:, 1]).max() <= limits.horizontal_speed_m_s * 1.1
        assert speeds[:, 2].min() >= -limits.climb_speed_m_s * 1.1
        fastest = max(fastest, float(np.hypot(speeds[:, 0], speeds[:, 1]).max()))
        hardest = max(hardest, float(np.hypot(u[:, 0], u[:, 1]).max()))
        last = (float(u[0, 0]), float(u[0, 1]), float(u[0, 2]))
        motion = advance(motion, last, 1.0 / CONFIG.rate_hz, LAGS_S)
    assert fastest > 0.9 * limits.horizontal_speed_m_s
    assert hardest > 0.9 * limits.horizontal_acceleration_m_s2


def test_the_floor_holds_against_a_reference_below_it() -> None:
    start = Motion((0.0, 0.0, -1.0), ZERO3, ZERO3)
    free = Mpc(CONFIG, LAGS_S).solve(start, hover_at((0.0, 0.0, -0.5)), ZERO3, ZERO3)
    held = Mpc(CONFIG, LAGS_S).solve(start, hover_at((0.0, 0.0, -0.5), -0.6), ZERO3, ZERO3)
    assert free.states[-1, 2] > -0.53
    assert held.solved
    assert held.states[:, 2].max() < -0.6 + 0.015


@pytest.mark.parametrize(
    "start",
    [
        Motion((0.0, 0.0, -0.2), (0.0, 0.0, 2.5), (0.0, 0.0, 1.0)),
        Motion((0.0, 0.0, -3.0), (7.0, -6.0, 0.0), (6.0, 0.0, 0.0)),
        Motion((500.0, -300.0, -80.0), (0.0, 0.0, -4.0), (0.0, 0.0, -5.0)),
    ],
)
def test_a_start_beyond_the_bounds_still_has_a_solution_that_goes_back(start: Motion) -> None:
    mpc, last = Mpc(CONFIG, LAGS_S), (9.0, -9.0, 9.0)
    target = within_reach(hover_at((0.0, 0.0, -2.0), -0.5), start.position_m, 2.0, 0.7)
    for _ in range(10):
        solution = mpc.solve(start, target, ZERO3, last)
    assert solution.solved
    first_speed = np.hypot(*solution.states[0, 3:5]) + abs(solution.states[0, 5])
    assert np.hypot(*solution.states[-1, 3:5]) + abs(solution.states[-1, 5]) < first_speed
    assert np.abs(solution.inputs_m_s2).max() <= CONFIG.limits.horizontal_acceleration_m_s2 + 0.01


# ---------------------------------------------------------------- thrust, tilt and cone


def test_thrust_is_bounded_by_what_hovering_takes_by_now() -> None:
    start, up = Motion((0.0, 0.0, 0.0), ZERO3, ZERO3), hover_at((0.0, 0.0, -0.7))
    mpc = Mpc(CONFIG, LAGS_S, hover_thrust=0.5)
    strong = mpc.solve(start, up, ZERO3, ZERO3).inputs_m_s2
    weak = mpc.solve(start, replace(up, hover_thrust=0.8), ZERO3, ZERO3).inputs_m_s2
    most = CONFIG.limits.maximum_thrust / 0.8 * GRAVITY_M_S2
    assert np.linalg.norm(strong - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() > most
    assert np.linalg.norm(weak - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() <= most + 5e-3


def test_the_tilt_is_bounded_while_it_drops() -> None:
    start, target = Motion((0.0, 0.0, -9.0), ZERO3, ZERO3), hover_at((3.0, 3.0, -7.0))
    mpc, last, worst = Mpc(CONFIG, LAGS_S), ZERO3, 0.0
    for _ in range(12):
        u = mpc.solve(start, target, ZERO3, last).inputs_m_s2
        last = (float(u[0, 0]), float(u[0, 1]), float(u[0, 2]))
        start = advance(start, last, 1.0 / CONFIG.rate_hz, LAGS_S)
        worst = max(worst, float(np.max(np.hypot(u[:, 0], u[:, 1]) / (GRAVITY_M_S2 - u[:, 2]))))
    assert math.degrees(math.atan(worst)) <= CONFIG.limits.tilt_deg + 0.05


def _cone(slope: float = 0.2) -> Cone:
    return Cone(slope, 0.1, np.zeros((N + 1, 3)))


def _outside(states: FloatArray, slope: float = 0.2) -> float:
    return float(np.max(np.hypot(states[:, 0], states[:, 1]) - (0.1 - slope * states[:, 2])))


@pytest.mark.parametrize("slope", [0.1, 0.2, 0.4])
def test_a_descent_keeps_within_the_cone(slope: float) -> None:
    edge = 0.1 + slope * 2.0
    start = Motion((edge, 0.0, -2.0), ZERO3, ZERO3)
    free = Mpc(CONFIG, LAGS_S).solve(start, hover_at((edge, 0.0, -1.4)), ZERO3, ZERO3)
    target = replace(hover_at((edge, 0.0, -1.4)), cone=_cone(slope))
    held = Mpc(CONFIG, LAGS_S).solve(start, target, ZERO3, ZERO3)
    assert _outside(free.states, slope) > 0.4 * slope
    assert _outside(held.states, slope) < 0.1 * slope
    assert held.states[-1, 2] > -1.9  # it does go down, by coming in


def test_outside_the_cone_it_comes_in_without_a_climb() -> None:
    start = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3)
    target = replace(hover_at((0.0, 0.0, -2.0)), cone=_cone())
    states = Mpc(CONFIG, LAGS_S).solve(start, target, ZERO3, ZERO3).states
    assert states[:, 2].min() > -2.03
    assert states[-1, 0] < 0.3


def test_a_cone_that_is_no_more_leaves_no_trace() -> None:
    start, target = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), hover_at((1.0, 0.0, -1.4))
    mpc = Mpc(CONFIG, LAGS_S)
    free = mpc.solve(start, target, ZERO3, ZERO3)
    mpc.solve(start, replace(target, cone=_cone()), ZERO3, ZERO3)
    for _ in range(6):
        again = mpc.solve(start, target, ZERO3, ZERO3)
    np.testing.assert_allclose(again.inputs_m_s2, free.inputs_m_s2, atol=5e-2)


# ---------------------------------------------------------------- the start, and a limit in time


def test_the_flown_acceleration_keeps_within_the_inputs_and_what_pushes() -> None:
    start, push = Motion((0.0, 0.0, -9.0), ZERO3, ZERO3), (1.0, 0.0, 0.0)
    solution = Mpc(CONFIG, LAGS_S).solve(start, hover_at((2.0, 1.0, -8.5)), push, ZERO3)
    flown = solution.states[:, 6:] - np.array(push)
    assert np.hypot(flown[:, 0], flown[:, 1]).max() <= CONFIG.limits.horizontal_acceleration_m_s2 + 1.0
    assert np.abs(flown[:, 2]).max() <= CONFIG.limits.vertical_acceleration_m_s2 + 5e-3


def _round(time_s: float) -> Target:
    """A pad 0.53 m below on a circle of 1.75 m at 1.55 m/s, in the cone of a descent."""
    rate_rad_s = 1.55 / 1.75
    turned = rate_rad_s * (time_s + DT * np.arange(N + 1))
    zero = np.zeros(N + 1)
    position = np.column_stack([1.75 * np.cos(turned), 1.75 * np.sin(turned), zero - 0.53])
    velocity = 1.55 * np.column_stack([-np.sin(turned), np.cos(turned), zero])
    acceleration = -(rate_rad_s**2) * position * [1.0, 1.0, 0.0]
    cone = Cone(0.2, 0.1, np.add(position, (0.0, 0.0, 0.35)))
    return Target(position, velocity, acceleration, cone=cone)


@pytest.mark.parametrize("wind_m_s2", [4.0, 4.2])
def test_against_a_wind_that_takes_more_than_the_bounds_allow_it_tilts_all_the_same(
    wind_m_s2: float,
) -> None:
    mpc, period_s, against = Mpc(CONFIG, LAGS_S), 1.0 / CONFIG.rate_hz, (0.0, -wind_m_s2, 0.0)
    motion = Motion((1.75, 0.0, -0.53), (0.0, 1.55, 0.0), (-1.37, 0.0, 0.0))
    last: Vector3 = (-1.37, 0.0, 0.0)
    cut, farthest_m = 0, 0.0
    for k in range(round(2.0 * math.tau / period_s)):  # two turns
        target = within_reach(
            _round(k * period_s), motion.position_m, CONFIG.horizontal_reach_m, CONFIG.vertical_reach_m
        )
        solution = mpc.solve(motion, target, against, last)
        assert solution.solved or solution.cut
        last = vector3(mpc.clip_input(solution.inputs_m_s2[0]).tolist())
        assert solution.inputs_m_s2[0] == pytest.approx(last, abs=ACCEPTED_PRIMAL)
        cut += solution.cut
        motion = advance(motion, add(last, against), period_s, LAGS_S)
        aside = _round((k + 1) * period_s).position_m[0] - motion.position_m
        farthest_m = max(farthest_m, float(np.linalg.norm(aside)))
    assert cut > 0
    assert farthest_m < CONFIG.horizontal_reach_m


@pytest.mark.parametrize("down_m_s2", [1.0, -1.0])
def test_a_wind_beyond_the_bounds_takes_no_height(down_m_s2: float) -> None:
    mpc, period_s, against = Mpc(CONFIG, LAGS_S), 1.0 / CONFIG.rate_hz, (0.0, -5.0, down_m_s2)
    motion = Motion((1.75, 0.0, -0.53), (0.0, 1.55, 0.0), (-1.37, 0.0, 0.0))
    last: Vector3 = (-1.37, 0.0, -down_m_s2)
    cut = 0
    for k in range(round(math.tau / period_s)):
        target = within_reach(
            _round(k * period_s), motion.position_m, CONFIG.horizontal_reach_m, CONFIG.vertical_reach_m
        )
        solution = mpc.solve(motion, target, against, last)
        last = vector3(mpc.clip_input(solution.inputs_m_s2[0]).tolist())
        cut += solution.cut
        motion = advance(motion, add(last, against), period_s, LAGS_S)
        assert motion.position_m[2] == pytest.approx(-0.53, abs=0.12)
    assert cut > 0
