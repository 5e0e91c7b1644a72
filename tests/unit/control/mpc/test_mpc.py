"""The MPC: the right optimum, unhurt by bad input and by lack of time."""

import math
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import osqp
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray, Vector3, add, tilt_from_quat, vector3
from companion.base.messages import DescentCone, LevelOff, Reference, Setpoint
from companion.base.motion import Motion
from companion.config import ControlConfig, LimitsConfig
from companion.control.attitude import attitude_from_acceleration, thrust_from_acceleration
from companion.control.limits import LimitsGate
from companion.control.mpc.input_bounds import LEAST_ROOM, input_bounds, input_rows, shrunk, side_left_m_s2
from companion.control.mpc.mpc import Mpc
from companion.control.mpc.qp import (
    ROWS,
    VARIABLES,
    axis_cost,
    axis_costs,
    constraint_matrix,
    cost_matrix,
    step_matrices,
)
from companion.control.mpc.target import make_target, sample, stop_reference, within_reach
from companion.control.pad_prediction import PadPrediction, origin_at_rest
from companion.control.response.flight_model import advance, discretise
from companion.control.setpoints import Heading
from companion.control.solver_health import ACCEPTED_PRIMAL
from companion.control.tracking import Cone, SolveOutcome, Target, needed_inputs

TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
CONFIG = ControlConfig()
N, DT = CONFIG.horizon_steps, CONFIG.step_s


def hover_at(position: Vector3, floor_down_m: float | None = None) -> Target:
    still = np.zeros((N + 1, 3))
    floor = None if floor_down_m is None else np.full(N + 1, floor_down_m)
    return Target(np.tile(np.array(position), (N + 1, 1)), still, still, floor)


def curve() -> Target:
    """Some smooth reference that ends in rest, small enough for no constraint to bind."""
    t = DT * np.arange(N + 1)[:, None]
    w, phase = 2.0, np.array([0.0, 1.0, 2.0])
    rest = np.clip(1.0 - t / t[-3], 0.0, 1.0)
    position = 0.2 * np.sin(w * t + phase) * rest
    velocity = 0.3 * np.cos(w * t + phase) * rest
    acceleration = -0.4 * np.sin(w * t + phase) * rest
    return Target(position, velocity, acceleration)


def batch_inputs(
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


# ---------------- The MPC: the right optimum, unhurt by bad input and by lack of time


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
    variables = N * sum(VARIABLES.values())
    P = cost_matrix(axis_costs(CONFIG, LAGS_S), N)
    assert P.shape == (variables, variables)
    rows = constraint_matrix(*step_matrices(DT, LAGS_S), N, inputs=input_rows(CONFIG.limits))
    assert rows.shape == (N * sum(ROWS.values()), variables)
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
    answer = SimpleNamespace(x=np.full(N * sum(VARIABLES.values()), value), info=info)
    with monkeypatch.context() as patch:
        patch.setattr(osqp.OSQP, "solve", lambda _self, **_kwargs: answer)
        refused = mpc.solve(start, target, ZERO3, ZERO3)
    assert not refused.solved
    assert refused.iterations == 7
    np.testing.assert_allclose(refused.inputs_m_s2[0], good.inputs_m_s2[0], atol=0.5)
    assert mpc.solve(start, target, ZERO3, ZERO3).solved


# ---------------------------------------------------------------- the start, and a limit in time


def test_where_no_constraint_binds_nothing_is_searched() -> None:
    mpc, target = Mpc(CONFIG, LAGS_S), curve()
    start, last = Motion((0.05, -0.1, 0.02), (0.2, 0.0, -0.1), (0.1, -0.2, 0.0)), (-0.6, 1.2, 0.3)
    free = mpc.solve(start, target, (0.3, -0.2, 0.1), last)
    assert (free.solved, free.iterations) == (True, 0)


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


# ---------------- The MPC within its constraints: input and state bounds, thrust, tilt, floor and cone


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
    assert free.states[-1, 2] > -0.56  # far below the floor
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
    mpc = Mpc(CONFIG, LAGS_S)
    strong = mpc.solve(start, up, ZERO3, ZERO3).inputs_m_s2
    weak = mpc.solve(start, replace(up, hover_thrust=0.8), ZERO3, ZERO3).inputs_m_s2
    most = CONFIG.limits.maximum_thrust / 0.8 * GRAVITY_M_S2
    assert np.linalg.norm(strong - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() > most
    assert np.linalg.norm(weak - [0.0, 0.0, GRAVITY_M_S2], axis=1).max() <= most + 5e-3


def test_pressed_down_by_more_than_the_bound_on_acceleration_it_keeps_its_height() -> None:
    start, target = (
        Motion((0.0, 0.0, -3.0), ZERO3, ZERO3),
        replace(hover_at((0.0, 0.0, -3.0)), hover_thrust=0.4),
    )
    pressed_m_s2 = 1.5 * CONFIG.limits.vertical_acceleration_m_s2
    heights = -_flown(start, target, against=(0.0, 0.0, pressed_m_s2))[:, 2]
    assert heights.min() > 2.5
    assert heights[-1] == pytest.approx(3.0, abs=0.05)


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


def _flown(
    motion: Motion, target: Target, *, against: Vector3 = ZERO3, duration_s: float = 4.0
) -> FloatArray:
    """Positions (n, 3) of a closed loop."""
    mpc, period_s, places, last = Mpc(CONFIG, LAGS_S), 1.0 / CONFIG.rate_hz, [motion.position_m], ZERO3
    for _ in range(round(duration_s / period_s)):
        solution = mpc.solve(motion, target, against, last)
        last = vector3(mpc.clip_input(solution.inputs_m_s2[0]).tolist())
        motion = advance(motion, add(last, against), period_s, LAGS_S)
        places.append(motion.position_m)
    return np.array(places)


@pytest.mark.parametrize("slope", [0.1, 0.2, 0.4])
def test_a_descent_keeps_within_the_cone(slope: float) -> None:
    edge = 0.1 + slope * 2.0
    target = hover_at((0.8 * edge, 0.0, -0.8))
    free = _flown(Motion((edge, 0.0, -2.0), ZERO3, ZERO3), target)
    held = _flown(Motion((edge, 0.0, -2.0), ZERO3, ZERO3), replace(target, cone=_cone(slope)))
    assert _outside(free, slope) > 0.5 * slope
    # as low as it may be there, but for what the soft bound lets through
    assert _outside(held, slope) < 0.15 * slope
    assert held[-1, 2] == pytest.approx((0.1 - 0.8 * edge) / slope, abs=0.15)


def test_outside_the_cone_it_comes_in_without_a_climb() -> None:
    start = Motion((1.0, 0.0, -2.0), ZERO3, ZERO3)
    target = replace(hover_at((0.0, 0.0, -2.0)), cone=_cone())
    states = Mpc(CONFIG, LAGS_S).solve(start, target, ZERO3, ZERO3).states
    assert states[:, 2].min() > -2.03
    assert states[-1, 0] < 0.3


@pytest.mark.parametrize(
    ("push_m_s2", "hover_thrust", "short_of"), [(7.0, 0.5, "tilt"), (5.0, 0.85, "thrust"), (2.0, 0.5, "")]
)
def test_what_the_wind_takes_all_of_is_named(push_m_s2: float, hover_thrust: float, short_of: str) -> None:
    mpc, target = Mpc(CONFIG, LAGS_S), replace(hover_at(ZERO3), hover_thrust=hover_thrust)
    motion = Motion((-1.0, 0.0, 0.0), ZERO3, ZERO3)
    against: Vector3 = (-push_m_s2, 0.0, 0.0)
    for _ in range(10):
        solution = mpc.solve(motion, target, against, (min(push_m_s2, 5.0), 0.0, 0.0))
    assert solution.short_of == short_of


def test_carried_out_of_the_cone_by_what_it_cannot_resist_it_does_not_climb() -> None:
    target = replace(hover_at((0.0, 0.0, -0.5)), cone=_cone(0.2))
    flown = _flown(Motion((0.0, 0.0, -0.5), ZERO3, ZERO3), target, against=(-9.0, 0.0, 0.0), duration_s=1.0)
    assert flown[-1, 0] < -1.0
    assert np.abs(flown[:, 2] + 0.5).max() < 0.05


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
def test_against_a_wind_that_takes_more_than_the_bounds_allow_it_tilts_all_the_same(wind_m_s2: float) -> None:
    mpc, period_s, against = Mpc(CONFIG, LAGS_S), 1.0 / CONFIG.rate_hz, (0.0, -wind_m_s2, 0.0)
    motion = Motion((1.75, 0.0, -0.53), (0.0, 1.55, 0.0), (-1.37, 0.0, 0.0))
    last: Vector3 = (-1.37, 0.0, 0.0)
    most_m_s2, farthest_m = 0.0, 0.0
    for k in range(round(2.0 * math.tau / period_s)):  # two turns
        target = within_reach(
            _round(k * period_s), motion.position_m, CONFIG.horizontal_reach_m, CONFIG.vertical_reach_m
        )
        solution = mpc.solve(motion, target, against, last)
        assert solution.outcome is not SolveOutcome.KEPT
        last = vector3(mpc.clip_input(solution.inputs_m_s2[0]).tolist())
        assert solution.inputs_m_s2[0] == pytest.approx(last, abs=ACCEPTED_PRIMAL)
        most_m_s2 = max(most_m_s2, math.hypot(*last[:2]))
        motion = advance(motion, add(last, against), period_s, LAGS_S)
        aside = _round((k + 1) * period_s).position_m[0] - motion.position_m
        farthest_m = max(farthest_m, float(np.linalg.norm(aside)))
    assert most_m_s2 > 0.92 * GRAVITY_M_S2 * math.tan(math.radians(CONFIG.limits.tilt_deg))
    assert farthest_m < CONFIG.horizontal_reach_m


@pytest.mark.parametrize("down_m_s2", [1.0, -1.0])
def test_a_wind_beyond_the_bounds_takes_no_height(down_m_s2: float) -> None:
    mpc, period_s, against = Mpc(CONFIG, LAGS_S), 1.0 / CONFIG.rate_hz, (0.0, -5.0, down_m_s2)
    motion = Motion((1.75, 0.0, -0.53), (0.0, 1.55, 0.0), (-1.37, 0.0, 0.0))
    last: Vector3 = (-1.37, 0.0, -down_m_s2)
    farthest_m = 0.0
    for k in range(round(math.tau / period_s)):
        target = within_reach(
            _round(k * period_s), motion.position_m, CONFIG.horizontal_reach_m, CONFIG.vertical_reach_m
        )
        solution = mpc.solve(motion, target, against, last)
        last = vector3(mpc.clip_input(solution.inputs_m_s2[0]).tolist())
        motion = advance(motion, add(last, against), period_s, LAGS_S)
        aside = _round((k + 1) * period_s).position_m[0] - motion.position_m
        farthest_m = max(farthest_m, math.hypot(*aside[:2]))
        assert motion.position_m[2] == pytest.approx(-0.53, abs=0.03)
    assert farthest_m > 1.0


# ----------------
# The polytope of the MPC's inputs: all within every limit, and hardly anything of that given away.

LIMITS = LimitsConfig()


def _allowed(limits: LimitsConfig, hover_thrust: float, count: int = 3000) -> FloatArray:
    """Inputs on the polytope's surface, in directions from everywhere."""
    rows = input_rows(limits)
    lower, upper = input_bounds(limits, rows, hover_thrust)
    directions = np.random.default_rng(1).normal(size=(count, 3))
    return np.array([shrunk(1e3 * each, rows, lower, upper) for each in directions])


@pytest.mark.parametrize("tilt_deg", [10.0, 25.0, 45.0])
@pytest.mark.parametrize("hover_thrust", [0.3, 0.5, 0.75])
def test_the_gate_cuts_nothing_that_is_allowed(tilt_deg: float, hover_thrust: float) -> None:
    limits = LimitsConfig(
        tilt_deg=tilt_deg, horizontal_acceleration_m_s2=10.0, vertical_acceleration_m_s2=8.0
    )
    for u in _allowed(limits, hover_thrust, 400):
        wanted = vector3(u.tolist())
        setpoint = Setpoint(
            0.0,
            acceleration_ned_m_s2=wanted,
            attitude=attitude_from_acceleration(wanted, 0.0),
            thrust=thrust_from_acceleration(wanted, hover_thrust),
        )
        assert LimitsGate(limits).apply(setpoint, 0.0)[1] == ()
        assert tilt_from_quat(attitude_from_acceleration(wanted, 0.0)) <= math.radians(tilt_deg) + 1e-9


def test_hardly_anything_is_given_away() -> None:
    u = _allowed(LIMITS, 0.5)
    assert np.abs(u[:, 2]).max() == pytest.approx(LIMITS.vertical_acceleration_m_s2)
    assert np.hypot(u[:, 0], u[:, 1]).max() > 0.98 * LIMITS.horizontal_acceleration_m_s2
    strong = LimitsConfig(vertical_acceleration_m_s2=8.0)
    force = np.linalg.norm(_allowed(strong, 0.85) - [0.0, 0.0, GRAVITY_M_S2], axis=1)
    most = strong.maximum_thrust / 0.85 * GRAVITY_M_S2
    assert 0.97 * most < force.max() <= most


def test_a_vehicle_that_lets_itself_fall_may_push_less_to_the_side() -> None:
    rows = input_rows(LIMITS)
    lower, upper = input_bounds(LIMITS, rows, 0.5)
    level, falling = (shrunk(np.array([8.0, 0.0, z]), rows, lower, upper) for z in (0.0, 5.0))
    assert level[0] == pytest.approx(LIMITS.horizontal_acceleration_m_s2 * math.cos(math.pi / 8))
    tilt = math.degrees(math.atan(falling[0] / (GRAVITY_M_S2 - falling[2])))
    assert 0.9 * LIMITS.tilt_deg < tilt < LIMITS.tilt_deg


@pytest.mark.parametrize("hover_thrust", [0.05, 0.1, 0.9, 1.3])
def test_whatever_was_learnt_hovering_is_allowed(hover_thrust: float) -> None:
    limits = LimitsConfig(minimum_thrust=0.5, maximum_thrust=0.6)
    lower, upper = input_bounds(limits, input_rows(limits), hover_thrust)
    assert (upper > 0.0).all()
    assert (lower < 0.0).all()


@pytest.mark.parametrize("hover_thrust", [0.7, 0.8, 0.88])
def test_sideways_gets_what_height_leaves_of_the_thrust(hover_thrust: float) -> None:
    side = side_left_m_s2(LIMITS, hover_thrust)
    most = LIMITS.maximum_thrust / hover_thrust * GRAVITY_M_S2
    assert math.hypot(side, (1.0 + LEAST_ROOM) * GRAVITY_M_S2) == pytest.approx(most)
    push = np.array([0.0, 6.0, 0.0])
    target = replace(hover_at((0.0, 0.0, 0.0)), hover_thrust=hover_thrust)
    mpc = Mpc(CONFIG, LAGS_S)
    motion = Motion(ZERO3, ZERO3, ZERO3)
    u = mpc.solve(motion, target, vector3((-push).tolist()), vector3(push.tolist())).inputs_m_s2
    later = np.hypot(u[4:, 0], u[4:, 1])
    assert later.max() == pytest.approx(min(side, LIMITS.horizontal_acceleration_m_s2), rel=0.09)


@pytest.mark.parametrize("hover_thrust", [0.95, 1.2])
def test_who_has_no_thrust_to_spare_still_leans_a_little(hover_thrust: float) -> None:
    assert side_left_m_s2(LIMITS, hover_thrust) == LEAST_ROOM * GRAVITY_M_S2


def test_planes_that_others_imply_are_left_out() -> None:
    assert np.isinf(
        input_bounds(LIMITS, input_rows(LIMITS), 0.5)[1][13:]
    ).all()  # 0.9 of full thrust is out of reach
    assert np.isfinite(input_bounds(LIMITS, input_rows(LIMITS), 0.8)[1][13:]).all()


# ---------------- References resampled and carried along with the pad

ROWS_S: FloatArray = 5.0 + 0.1 * np.arange(6, dtype=np.float64)


def _parabola(origin: str = "pad", minimum_height_m: float | None = None) -> Reference:
    t = 0.1 * np.arange(11)[:, None]
    a = np.array([0.4, -0.2, 0.1])
    return Reference(
        5.0,
        "pad" if origin == "pad" else "local",
        0.1,
        0.5 * a * t * t,
        a * t,
        np.tile(a, (11, 1)),
        0.0,
        minimum_height_m,
    )


def test_between_rows_the_reference_is_interpolated() -> None:
    times = np.array([5.0, 5.05, 5.333, 6.0])
    position, velocity, acceleration = sample(_parabola(), times)
    t = (times - 5.0)[:, None]
    a = np.array([0.4, -0.2, 0.1])
    np.testing.assert_allclose(position, 0.5 * a * t * t, atol=1e-3)
    np.testing.assert_allclose(velocity, a * t, atol=1e-12)
    np.testing.assert_allclose(acceleration, np.tile(a, (4, 1)))


def test_beyond_its_end_the_reference_goes_straight_on_and_before_its_start_it_waits() -> None:
    position, velocity, acceleration = sample(_parabola(), np.array([4.0, 6.5]))
    assert position[0].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(position[1], [0.2 + 0.4 * 0.5, -0.1 - 0.2 * 0.5, 0.05 + 0.1 * 0.5])
    np.testing.assert_allclose(velocity[1], [0.4, -0.2, 0.1])
    assert not acceleration[1].any()


def test_a_single_row_is_a_place_to_stay() -> None:
    target = make_target(stop_reference(0.0, (1.0, 2.0, -3.0), 0.0), np.arange(3.0), origin_at_rest(3))
    np.testing.assert_allclose(target.position_m, [(1.0, 2.0, -3.0)] * 3)
    assert not target.velocity_m_s.any()
    assert target.floor_down_m is None


def test_the_pads_motion_and_the_floor_over_it_are_added() -> None:
    times = ROWS_S
    path = PadPrediction(np.full((6, 3), 2.0), np.full((6, 3), 0.5), np.full((6, 3), 0.1))
    bare = make_target(_parabola(), times, origin_at_rest(6))
    target = make_target(_parabola(minimum_height_m=-0.5), times, path)
    np.testing.assert_allclose(target.position_m, bare.position_m + 2.0)
    np.testing.assert_allclose(target.velocity_m_s, bare.velocity_m_s + 0.5)
    np.testing.assert_allclose(target.acceleration_m_s2, bare.acceleration_m_s2 + 0.1)
    assert target.floor_down_m is not None
    np.testing.assert_allclose(target.floor_down_m, 2.0 + 0.5)


def test_a_local_reference_knows_no_floor_over_the_pad() -> None:
    reference = _parabola(origin="local", minimum_height_m=0.3)
    assert make_target(reference, ROWS_S[:3], origin_at_rest(3)).floor_down_m is None


@pytest.mark.parametrize("wanted_deg", [170.0, -170.0])
def test_heading_turns_no_faster_than_allowed_and_the_shorter_way(wanted_deg: float) -> None:
    heading = Heading(math.radians(-160.0)).after(0.1, math.radians(wanted_deg), 0.5)
    assert math.remainder(heading.heading_rad - math.radians(-160.0), math.tau) == pytest.approx(-0.05)


def test_heading_rate_follows_a_steady_turn() -> None:
    heading = Heading(0.0)
    for k in range(120):
        heading = heading.after(1.0 / 30.0, 0.3 * (k + 1) / 30.0, 1.0)
    assert heading.rate_rad_s == pytest.approx(0.3, abs=0.01)
    assert heading.heading_rad == pytest.approx(1.2)


def test_heading_stays_when_the_wish_is_no_number() -> None:
    assert Heading.at(0.4).after(0.1, math.nan, 1.0) == Heading(0.4)
    assert Heading.at(math.nan) == Heading(0.0)


def test_a_far_reference_is_drawn_within_reach_as_a_whole_and_keeps_its_floor() -> None:
    times = ROWS_S
    target = make_target(_parabola(minimum_height_m=0.3), times, origin_at_rest(6))
    near = within_reach(target, (-30.0, 40.0, 5.0), 2.0, 0.7)
    np.testing.assert_allclose(near.position_m[0], [-30.0 + 1.2, 40.0 - 1.6, 5.0 - 0.7])
    np.testing.assert_allclose(np.diff(near.position_m, axis=0), np.diff(target.position_m, axis=0))
    assert near.floor_down_m is target.floor_down_m


def test_a_near_reference_is_left_alone() -> None:
    target = make_target(_parabola(), ROWS_S, origin_at_rest(6))
    assert within_reach(target, (1.9, 0.0, 0.69), 2.0, 0.7) is target
    assert within_reach(target, (0.0, 0.0, 0.0), 2.0, 0.7) is target


def test_a_reference_below_the_floor_is_lifted_to_it() -> None:
    reference = Reference(
        0.0, "pad", 1.0, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), 0.0, minimum_height_m=0.5
    )
    assert make_target(reference, np.arange(3.0), origin_at_rest(3)).position_m[:, 2].tolist() == [-0.5] * 3


def test_a_cone_stands_on_the_pad_as_it_moves() -> None:
    times: FloatArray = 0.1 * np.arange(6, dtype=np.float64)
    up = np.stack([times, 0.0 * times, -0.3 * times], axis=1)
    path = PadPrediction(up, np.zeros((6, 3)), np.zeros((6, 3)))
    cone = DescentCone(slope=0.2, radius_m=0.1, apex_height_m=0.18)
    target = make_target(replace(_parabola(), cone=cone), times, path)
    assert target.cone is not None
    assert (target.cone.slope, target.cone.radius_m) == (0.2, 0.1)
    np.testing.assert_allclose(target.cone.apex_m, up - [0.0, 0.0, 0.18])
    assert make_target(replace(_parabola(origin="local"), cone=cone), times, path).cone is None
    assert make_target(_parabola(), times, path).cone is None


# ----------------
# The vehicle is level when its feet touch: the bound goes from the plan through the target into the MPC.

LEVEL_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(6.0))


def turning(horizontal_bound_m_s2: FloatArray | None) -> Target:
    """A pad that accelerates eastwards at 2 m/s2, flown along with."""
    t = DT * np.arange(N + 1)[:, None]
    push = np.array([0.0, 2.0, 0.0])
    return Target(
        0.5 * push * t * t, push * t, np.tile(push, (N + 1, 1)), horizontal_bound_m_s2=horizontal_bound_m_s2
    )


def window(first: int, last: int) -> FloatArray:
    bound = np.full(N, np.inf)
    bound[first:last] = LEVEL_M_S2
    return bound


def sideways(mpc: Mpc, target: Target) -> FloatArray:
    solution = mpc.solve(
        Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), target, (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)
    )
    assert solution.solved
    return np.hypot(solution.inputs_m_s2[:, 0], solution.inputs_m_s2[:, 1])


def test_the_reference_tells_the_steps_within_the_time() -> None:
    still, level_off = np.zeros((2, 3)), LevelOff(5.3, 5.6, math.radians(6.0))
    reference = Reference(5.0, "pad", 0.1, still, still, still, 0.0, level_off=level_off)
    target = make_target(reference, 5.0 + 0.1 * np.arange(11, dtype=np.float64), origin_at_rest(11))
    assert target.horizontal_bound_m_s2 is not None
    expected = [math.inf] * 3 + [LEVEL_M_S2] * 3 + [math.inf] * 4
    assert target.horizontal_bound_m_s2.tolist() == pytest.approx(expected)
    later = make_target(
        replace(reference, level_off=LevelOff(6.5, 7.0, 0.1)),
        5.0 + 0.1 * np.arange(11, dtype=np.float64),
        origin_at_rest(11),
    )
    assert later.horizontal_bound_m_s2 is None


def test_it_moves_against_the_drift_before_it_levels_off() -> None:
    mpc, target = Mpc(CONFIG, (0.11, 0.11, 0.04)), turning(window(5, 9))
    solution = mpc.solve(
        Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), target, (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)
    )
    drift_m_s = solution.states[:, 4] - target.velocity_m_s[1:, 1]
    assert drift_m_s[4] > 0.03
    assert drift_m_s[9] < -0.03


def test_it_levels_off_in_time_and_tilts_again_afterwards() -> None:
    mpc = Mpc(CONFIG, (0.11, 0.11, 0.04))
    free = sideways(mpc, turning(None))
    assert free.min() > 1.5
    levelled = sideways(mpc, turning(window(5, 9)))
    assert levelled[5:9].max() <= LEVEL_M_S2 + 0.02
    assert levelled[12] > 1.5
    for _ in range(5):  # from a solution so different the first ones are as exact as they need to be
        again = sideways(mpc, turning(None))
    np.testing.assert_allclose(again, free, atol=0.05)


def test_a_bound_that_comes_at_once_is_met_as_fast_as_the_command_may_change() -> None:
    levelled = sideways(Mpc(CONFIG, (0.11, 0.11, 0.04)), turning(window(0, 6)))
    assert levelled[0] < 2.0
    assert levelled[3:6].max() <= LEVEL_M_S2 + 0.02
