"""The MPC: the right optimum, unhurt by bad input and by lack of time."""

import math
from itertools import count
from types import SimpleNamespace

import numpy as np
import osqp
import pytest

from companion.base.geometry import ZERO3
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
from companion.control.response.flight_model import advance, discretise
from companion.control.tracking import Target, needed_inputs
from tests.unit.control.mpc.mpc_cases import CONFIG, DT, LAGS_S, TAU_S, N, batch_inputs, curve, hover_at


def test_unconstrained_answer_equals_the_batch_solution_over_an_endless_horizon() -> None:
    free = LimitsConfig(jerk_m_s3=200.0)
    mpc, target = Mpc(CONFIG.model_copy(update={"limits": free}), LAGS_S), curve()
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
        expected = batch_inputs(
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
    solution = Mpc(CONFIG, LAGS_S).solve(start, curve(), disturbance, ZERO3)
    motion = start
    for u, state in zip(solution.inputs_m_s2, solution.states, strict=True):
        push = tuple(u + np.array(disturbance))
        motion = advance(motion, push, DT, LAGS_S)
        flown = (*motion.position_m, *motion.velocity_m_s, *motion.acceleration_m_s2)
        np.testing.assert_allclose(state, flown, atol=5e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_numbers_get_the_old_plan_and_do_no_lasting_harm(bad: float) -> None:
    start, target = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), hover_at((0.0, 0.0, -2.0))
    mpc = Mpc(CONFIG, LAGS_S)
    good = mpc.solve(start, target, ZERO3, ZERO3)
    poisoned = Motion((bad, 0.0, -2.0), ZERO3, ZERO3)
    after = mpc.solve(poisoned, target, ZERO3, ZERO3)
    assert not after.solved
    assert np.isfinite(after.inputs_m_s2).all()
    share = 1.0 / (CONFIG.rate_hz * DT)
    between = good.inputs_m_s2[0] + share * (good.inputs_m_s2[1] - good.inputs_m_s2[0])
    np.testing.assert_allclose(after.inputs_m_s2[0], between, atol=1e-9)
    assert not mpc.solve(start, hover_at((0.0, bad, 0.0)), ZERO3, ZERO3).solved
    again = mpc.solve(start, target, ZERO3, ZERO3)
    assert again.solved
    np.testing.assert_allclose(again.inputs_m_s2, good.inputs_m_s2, atol=2e-2)


def test_the_old_plan_runs_out_into_no_acceleration() -> None:
    mpc = Mpc(CONFIG, LAGS_S)
    mpc.solve(Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), hover_at(ZERO3), ZERO3, ZERO3)
    bad = Motion((math.nan, 0.0, 0.0), ZERO3, ZERO3)
    for _ in range(300):
        solution = mpc.solve(bad, hover_at(ZERO3), ZERO3, ZERO3)
    assert np.abs(solution.inputs_m_s2[0]).max() < 1e-3


def test_running_out_of_iterations_is_reported_and_mended_by_going_on() -> None:
    mpc = Mpc(ControlConfig(maximum_iterations=50), LAGS_S)
    start, target = Motion((2.0, -1.0, -2.7), (2.0, 1.0, 0.5), ZERO3), hover_at((0.0, 0.0, -2.0))
    solutions = [mpc.solve(start, target, ZERO3, ZERO3) for _ in range(40)]
    assert max(s.iterations for s in solutions) <= 50
    assert all(np.isfinite(s.inputs_m_s2).all() for s in solutions)
    assert solutions[-1].solved


def test_same_inputs_give_bit_identical_outputs() -> None:
    def fly() -> list[bytes]:
        mpc, motion, last, out = Mpc(CONFIG, LAGS_S), Motion((3.0, -2.0, -5.0), ZERO3, ZERO3), ZERO3, []
        for _ in range(40):
            u = mpc.solve(motion, hover_at((0.0, 0.0, -2.0)), ZERO3, last).inputs_m_s2
            last = (float(u[0, 0]), float(u[0, 1]), float(u[0, 2]))
            motion = advance(motion, last, 1.0 / 30.0, LAGS_S)
            out.append(u.tobytes())
        return out

    assert fly() == fly()


def test_a_reset_forgets_the_past() -> None:
    start, target = Motion((1.0, -0.5, -1.0), ZERO3, ZERO3), hover_at(ZERO3)
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
    mpc, start, target = Mpc(CONFIG, LAGS_S), Motion((1.0, 0.0, -2.0), ZERO3, ZERO3), hover_at(ZERO3)
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


# ---------------------------------------------------------------- the start, and a limit in time


def test_a_start_costs_no_more_than_a_step() -> None:
    mpc, target = Mpc(CONFIG, LAGS_S), curve()
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
    good = hurried.solve(easy, hover_at((0.0, 0.0, -2.0)), ZERO3, ZERO3)
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
