"""The MPC: the right optimum, within its constraints, and unhurt by bad input."""

import math
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import osqp
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3
from companion.base.motion import Motion
from companion.config import ControlConfig, LimitsConfig
from companion.control.mpc.input_bounds import input_rows
from companion.control.mpc.mpc import Mpc
from companion.control.mpc.qp import (
    QpLayout,
    axis_cost,
    axis_costs,
    constraint_matrix,
    cost_matrix,
    step_matrices,
)
from companion.control.mpc.target import within_reach
from companion.control.response.flight_model import advance, discretise
from companion.control.tracking import Cone, Target, needed_inputs

TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
CONFIG = ControlConfig()
N, DT = CONFIG.horizon_steps, CONFIG.step_s


def _hover_at(position: Vector3, floor_down_m: float | None = None) -> Target:
    still = np.zeros((N + 1, 3))
    floor = None if floor_down_m is None else np.full(N + 1, floor_down_m)
    return Target(np.tile(np.array(position), (N + 1, 1)), still, still, floor)


def _curve() -> Target:
    """Some smooth reference that ends in rest, small enough for no constraint to bind."""
    t = DT * np.arange(N + 1)[:, None]
    w, phase = 2.0, np.array([0.0, 1.0, 2.0])
    rest = np.clip(1.0 - t / t[-3], 0.0, 1.0)
    position = 0.2 * np.sin(w * t + phase) * rest
    velocity = 0.3 * np.cos(w * t + phase) * rest
    acceleration = -0.4 * np.sin(w * t + phase) * rest
    return Target(position, velocity, acceleration)


def _batch_inputs(
    start: FloatArray,
    reference: FloatArray,
    needed: FloatArray,
    *,
    last: float,
    first_change: float,
    d: float,
    axis: int,
) -> FloatArray:
    """One axis by least squares over a horizon so long that its end does not matter; no constraints.

    start (3,); reference (N + 1, 3), needed (N,): held on after their ends.
    """
    M = N + 200
    A, B = discretise(DT, LAGS_S[axis])
    w = CONFIG.vertical if axis == 2 else CONFIG.horizontal
    answer = np.zeros((3, M))  # state's answer to each input, built up step by step
    free = start.copy()
    rows, targets = [], []
    weights = np.array([1.0 / w.position_m, 1.0 / w.velocity_m_s, 1.0 / w.acceleration_m_s2])
    for k in range(M):
        answer = A @ answer
        answer[:, k] += B
        free = A @ free + B * d
        goal = reference[min(k + 1, N)]
        rows.append(weights[:, None] * answer)
        targets.append(weights * (goal - free))
    wished = np.concatenate([needed, np.full(M - N, needed[-1])])
    rows.append(np.eye(M) / w.effort_m_s2)
    targets.append(wished / w.effort_m_s2)
    change = np.diff(wished, prepend=wished[0])
    change[0] = first_change + last
    rows.append((np.eye(M) - np.eye(M, k=-1)) / w.effort_change_m_s2)
    targets.append(change / w.effort_change_m_s2)
    solution, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)
    return np.array(solution[:N])


def test_unconstrained_answer_equals_the_batch_solution_over_an_endless_horizon() -> None:
    free = LimitsConfig(jerk_m_s3=200.0)
    mpc, target = Mpc(CONFIG.model_copy(update={"limits": free}), LAGS_S), _curve()
    start = Motion((0.05, -0.1, 0.02), (0.2, 0.0, -0.1), (0.1, -0.2, 0.0))
    disturbance, last = (0.3, -0.2, 0.1), (0.2, 0.1, -0.1)
    solution = mpc.solve(start, target, disturbance, last)
    assert solution.solved
    needed = needed_inputs(target, disturbance, LAGS_S, DT)
    first_change = (needed[1] - needed[0]) / (CONFIG.rate_hz * DT)
    for axis in range(3):
        state = np.array([start.position_m[axis], start.velocity_m_s[axis], start.acceleration_m_s2[axis]])
        rows = [target.position_m, target.velocity_m_s, target.acceleration_m_s2]
        reference = np.stack([row[:, axis] for row in rows], axis=1)
        expected = _batch_inputs(
            state,
            reference,
            needed[:, axis],
            last=last[axis],
            first_change=float(first_change[axis]),
            d=disturbance[axis],
            axis=axis,
        )
        np.testing.assert_allclose(solution.inputs_m_s2[:, axis], expected, atol=5e-3)


def test_predicted_states_obey_the_model() -> None:
    start = Motion((0.5, -0.5, 0.3), (0.2, 0.0, -0.1), (0.1, -0.2, 0.0))
    disturbance = (0.3, -0.2, 0.1)
    solution = Mpc(CONFIG, LAGS_S).solve(start, _curve(), disturbance, ZERO3)
    motion = start
    for u, state in zip(solution.inputs_m_s2, solution.states, strict=True):
        push = tuple(u + np.array(disturbance))
        motion = advance(motion, push, DT, LAGS_S)
        flown = (*motion.position_m, *motion.velocity_m_s, *motion.acceleration_m_s2)
        np.testing.assert_allclose(state, flown, atol=5e-3)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, 180.0, 225.0, 270.0])
def test_a_far_goal_meets_every_bound_and_uses_the_room(direction_deg: float) -> None:
    limits = LimitsConfig(horizontal_speed_m_s=4.0)
    angle = math.radians(direction_deg)
    goal = (40.0 * math.cos(angle), 40.0 * math.sin(angle), -20.0)
    config = CONFIG.model_copy(update={"limits": limits})
    mpc, motion, last = Mpc(config, LAGS_S), Motion(ZERO3, ZERO3, ZERO3), ZERO3
    fastest = hardest = 0.0
    for k in range(150):
        target = within_reach(_hover_at(goal), motion.position_m, 4.0, 1.2)
        solution = mpc.solve(motion, target, ZERO3, last)
        assert solution.solved or k < 3  # a cold start may take more iterations than one step has
        u = solution.inputs_m_s2
        lean = math.tan(math.radians(limits.tilt_deg)) * 9.80665
        most = min(lean, limits.horizontal_acceleration_m_s2)
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
    free = Mpc(CONFIG, LAGS_S).solve(start, _hover_at((0.0, 0.0, -0.5)), ZERO3, ZERO3)
    held = Mpc(CONFIG, LAGS_S).solve(start, _hover_at((0.0, 0.0, -0.5), -0.6), ZERO3, ZERO3)
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
    target = within_reach(_hover_at((0.0, 0.0, -2.0), -0.5), start.position_m, 2.0, 0.7)
    for _ in range(10):
        solution = mpc.solve(start, target, ZERO3, last)
    assert solution.solved
    first_speed = np.hypot(*solution.states[0, 3:5]) + abs(solution.states[0, 5])
    assert np.hypot(*solution.states[-1, 3:5]) + abs(solution.states[-1, 5]) < first_speed
    assert np.abs(solution.inputs_m_s2).max() <= CONFIG.limits.horizontal_acceleration_m_s2 + 0.01


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_numbers_get_the_old_plan_and_do_no_lasting_harm(bad: float) -> None:
    start, target = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), _hover_at((0.0, 0.0, -2.0))
    mpc = Mpc(CONFIG, LAGS_S)
    good = mpc.solve(start, target, ZERO3, ZERO3)
    poisoned = Motion((bad, 0.0, -2.0), ZERO3, ZERO3)
    after = mpc.solve(poisoned, target, ZERO3, ZERO3)
    assert not after.solved
    assert np.isfinite(after.inputs_m_s2).all()
    share = 1.0 / (CONFIG.rate_hz * DT)
    between = good.inputs_m_s2[0] + share * (good.inputs_m_s2[1] - good.inputs_m_s2[0])
    np.testing.assert_allclose(after.inputs_m_s2[0], between, atol=1e-9)
    assert not mpc.solve(start, _hover_at((0.0, bad, 0.0)), ZERO3, ZERO3).solved
    again = mpc.solve(start, target, ZERO3, ZERO3)
    assert again.solved
    np.testing.assert_allclose(again.inputs_m_s2, good.inputs_m_s2, atol=2e-2)


def test_the_old_plan_runs_out_into_no_acceleration() -> None:
    mpc = Mpc(CONFIG, LAGS_S)
    mpc.solve(Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), _hover_at(ZERO3), ZERO3, ZERO3)
    bad = Motion((math.nan, 0.0, 0.0), ZERO3, ZERO3)
    for _ in range(300):
        solution = mpc.solve(bad, _hover_at(ZERO3), ZERO3, ZERO3)
    assert np.abs(solution.inputs_m_s2[0]).max() < 1e-3


def test_running_out_of_iterations_is_told_and_mended_by_going_on() -> None:
    mpc = Mpc(ControlConfig(maximum_iterations=50), LAGS_S)
    start, target = Motion((2.0, -1.0, -2.7), (2.0, 1.0, 0.5), ZERO3), _hover_at((0.0, 0.0, -2.0))
    solutions = [mpc.solve(start, target, ZERO3, ZERO3) for _ in range(40)]
    assert max(s.iterations for s in solutions) <= 50
    assert all(np.isfinite(s.inputs_m_s2).all() for s in solutions)
    assert solutions[-1].solved


def test_same_inputs_give_bit_identical_outputs() -> None:
    def fly() -> list[bytes]:
        mpc, motion, last, out = Mpc(CONFIG, LAGS_S), Motion((3.0, -2.0, -5.0), ZERO3, ZERO3), ZERO3, []
        for _ in range(40):
            u = mpc.solve(motion, _hover_at((0.0, 0.0, -2.0)), ZERO3, last).inputs_m_s2
            last = (float(u[0, 0]), float(u[0, 1]), float(u[0, 2]))
            motion = advance(motion, last, 1.0 / 30.0, LAGS_S)
            out.append(u.tobytes())
        return out

    assert fly() == fly()


def test_a_reset_forgets_the_past() -> None:
    start, target = Motion((1.0, -0.5, -1.0), ZERO3, ZERO3), _hover_at(ZERO3)
    mpc = Mpc(CONFIG, LAGS_S)
    fresh = mpc.solve(start, target, ZERO3, ZERO3)
    assert fresh.solved
    mpc.solve(Motion((-9.0, 0.0, 0.0), ZERO3, ZERO3), target, ZERO3, ZERO3)
    mpc.reset()
    again = mpc.solve(start, target, ZERO3, ZERO3)
    # to the solver's tolerance: it keeps the step size that it has found
    np.testing.assert_allclose(again.inputs_m_s2, fresh.inputs_m_s2, atol=5e-3)


def test_terminal_cost_is_the_riccati_fixed_point() -> None:
    cost = axis_cost(CONFIG.horizontal, DT, TAU_S)
    A, B = discretise(DT, TAU_S)
    F, G = np.zeros((4, 4)), np.append(B, 1.0)
    F[:3, :3] = A
    stage = np.zeros((4, 4))
    stage[:3, :3], stage[3, 3] = cost.Q, cost.S
    cross = np.array([0.0, 0.0, 0.0, -cost.S])
    T = cost.terminal
    pull = F.T @ T @ G + cross
    next_T = stage + F.T @ T @ F - np.outer(pull, pull) / (cost.R + cost.S + G @ T @ G)
    np.testing.assert_allclose(next_T, T, rtol=1e-6, atol=1e-6)


def test_matrices_have_the_documented_shape_and_a_convex_cost() -> None:
    layout = QpLayout(N)
    P = cost_matrix(axis_costs(CONFIG, LAGS_S), N)
    assert P.shape == (layout.variables, layout.variables)
    assert constraint_matrix(
        *step_matrices(DT, LAGS_S), N, inputs=input_rows(CONFIG.limits), cone_slope=0.2
    ).shape == (
        layout.rows()["cone"].stop,
        layout.variables,
    )
    full = P.toarray()
    full = full + np.triu(full, 1).T
    assert np.linalg.eigvalsh(full).min() > -1e-9


@pytest.mark.parametrize(("status", "value"), [(3, 2e9), (1, math.nan), (5, 0.0)])
def test_an_answer_that_is_none_is_not_flown(
    monkeypatch: pytest.MonkeyPatch, status: int, value: float
) -> None:
    # OSQP's way of saying "infeasible" is a status and numbers that look like a solution
    mpc, start, target = Mpc(CONFIG, LAGS_S), Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), _hover_at(ZERO3)
    good = mpc.solve(start, target, ZERO3, ZERO3)
    info = SimpleNamespace(status_val=status, iter=7, prim_res=0.0, dual_res=0.0)
    answer = SimpleNamespace(x=np.full(QpLayout(N).variables, value), info=info)
    with monkeypatch.context() as patch:
        patch.setattr(osqp.OSQP, "solve", lambda _self, **_kwargs: answer)
        refused = mpc.solve(start, target, ZERO3, ZERO3)
    assert not refused.solved
    assert refused.iterations == 7
    np.testing.assert_allclose(refused.inputs_m_s2[0], good.inputs_m_s2[0], atol=0.5)
    assert mpc.solve(start, target, ZERO3, ZERO3).solved


# ---------------------------------------------------------------- thrust, lean and cone


def test_thrust_is_bounded_by_what_hovering_takes_by_now() -> None:
    start, up = Motion((0.0, 0.0, 0.0), ZERO3, ZERO3), _hover_at((0.0, 0.0, -0.7))
    mpc = Mpc(CONFIG, LAGS_S, hover_thrust=0.5)
    strong = mpc.solve(start, up, ZERO3, ZERO3).inputs_m_s2
    weak = mpc.solve(start, replace(up, hover_thrust=0.8), ZERO3, ZERO3).inputs_m_s2
    most = CONFIG.limits.maximum_thrust / 0.8 * GRAVITY_M_S2
    assert np.linalg.norm(strong - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() > most
    assert np.linalg.norm(weak - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() <= most + 5e-3


def test_the_lean_is_bounded_while_it_drops() -> None:
    start, target = Motion((0.0, 0.0, -9.0), ZERO3, ZERO3), _hover_at((3.0, 3.0, -7.0))
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
    free = Mpc(CONFIG, LAGS_S).solve(start, _hover_at((edge, 0.0, -1.4)), ZERO3, ZERO3)
    target = replace(_hover_at((edge, 0.0, -1.4)), cone=_cone(slope))
    held = Mpc(CONFIG, LAGS_S).solve(start, target, ZERO3, ZERO3)
    assert _outside(free.states, slope) > 0.4 * slope
    assert _outside(held.states, slope) < 0.1 * slope
    assert held.states[-1, 2] > -1.9  # it does go down, by coming in


def test_outside_the_cone_it_comes_in_without_a_climb() -> None:
    start = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3)
    target = replace(_hover_at((0.0, 0.0, -2.0)), cone=_cone())
    states = Mpc(CONFIG, LAGS_S).solve(start, target, ZERO3, ZERO3).states
    assert states[:, 2].min() > -2.03
    assert states[-1, 0] < 0.3


def test_a_cone_that_is_no_more_leaves_no_trace() -> None:
    start, target = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), _hover_at((1.0, 0.0, -1.4))
    mpc = Mpc(CONFIG, LAGS_S)
    free = mpc.solve(start, target, ZERO3, ZERO3)
    mpc.solve(start, replace(target, cone=_cone()), ZERO3, ZERO3)
    for _ in range(6):
        again = mpc.solve(start, target, ZERO3, ZERO3)
    np.testing.assert_allclose(again.inputs_m_s2, free.inputs_m_s2, atol=5e-2)


# ---------------------------------------------------------------- the start, and a limit in time


def test_a_start_costs_no_more_than_a_step() -> None:
    mpc, target = Mpc(CONFIG, LAGS_S), _curve()
    start, last = Motion((0.05, -0.1, 0.02), (0.2, 0.0, -0.1), (0.1, -0.2, 0.0)), (-0.6, 1.2, 0.3)
    assert mpc.solve(start, target, (0.3, -0.2, 0.1), last).iterations <= 10
    mpc.reset()
    assert mpc.solve(start, target, (0.3, -0.2, 0.1), last).iterations <= 10


def _hard() -> tuple[Motion, Target]:
    """Takes more than one slice: too fast, too low, and a jump ahead."""
    position = np.tile([0.0, 0.0, -2.0], (N + 1, 1))
    position[N // 2 :] += [40.0, -30.0, -10.0]
    still = np.zeros((N + 1, 3))
    return Motion((2.0, -1.0, -2.7), (7.0, 3.0, 2.5), ZERO3), Target(position, still, still)


def test_past_its_time_the_last_solution_goes_on_shifted() -> None:
    ticks = count(0.0, 1.0)
    hurried = Mpc(CONFIG, LAGS_S, lambda: next(ticks))
    easy = Motion((0.3, 0.0, -2.0), ZERO3, ZERO3)
    good = hurried.solve(easy, _hover_at((0.0, 0.0, -2.0)), ZERO3, ZERO3)
    assert good.solved
    assert not good.late
    late = hurried.solve(*_hard(), ZERO3, ZERO3)
    assert late.late
    assert not late.solved
    assert late.iterations <= 100  # one slice
    share = 1.0 / (CONFIG.rate_hz * DT)
    between = good.inputs_m_s2[0] + share * (good.inputs_m_s2[1] - good.inputs_m_s2[0])
    np.testing.assert_allclose(late.inputs_m_s2[0], between, atol=1e-9)


def test_a_clock_that_stands_still_leaves_iterations_alone_to_bound_it() -> None:
    patient = Mpc(CONFIG, LAGS_S, lambda: 5.0)
    found = patient.solve(*_hard(), ZERO3, ZERO3)
    assert not found.late
    assert 100 < found.iterations <= CONFIG.maximum_iterations


def test_the_flown_acceleration_keeps_within_the_inputs_and_what_pushes() -> None:
    start, push = Motion((0.0, 0.0, -9.0), ZERO3, ZERO3), (1.0, 0.0, 0.0)
    solution = Mpc(CONFIG, LAGS_S).solve(start, _hover_at((2.0, 1.0, -8.5)), push, ZERO3)
    flown = solution.states[:, 6:] - np.array(push)
    assert np.hypot(flown[:, 0], flown[:, 1]).max() <= CONFIG.limits.horizontal_acceleration_m_s2 + 1.0
    assert np.abs(flown[:, 2]).max() <= CONFIG.limits.vertical_acceleration_m_s2 + 5e-3
