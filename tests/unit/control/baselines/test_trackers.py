"""The trackers beside the MPC: the recursion's optimum, the PID's law, and both in closed loop."""

import math
from dataclasses import dataclass

import numpy as np
import osqp
import pytest
import scipy.linalg
from scipy import sparse

from companion.base.geometry import ZERO3, FloatArray, Vector3
from companion.base.motion import Motion
from companion.config import ControlConfig, LimitsConfig, PidConfig, PidGains
from companion.control.baselines.pid_tracker import PidTracker
from companion.control.baselines.riccati import Tracking, Weights, solve_tracking
from companion.control.baselines.riccati_tracker import RiccatiTracker
from companion.control.mpc.mpc import Mpc
from companion.control.tracker import Tracker, make_tracker
from companion.control.tracking import Target, needed_inputs
from tests.unit.control.control_plants import (
    Loop,
    PadMotion,
    circle,
    controller,
    line,
    min_jerk_offset,
    still,
)
from tests.unit.control.control_vehicles import AttitudeAutopilot, VelocityAutopilot
from tests.unit.control.mpc.test_mpc import CONFIG, DT, LAGS_S, N, batch_inputs, curve, hover_at

START = Motion((0.05, -0.1, 0.02), (0.2, 0.0, -0.1), (0.1, -0.2, 0.0))
AT_REST = Motion(ZERO3, ZERO3, ZERO3)
DISTURBANCE = (0.3, -0.2, 0.1)
LAST = (0.2, 0.1, -0.1)
OTHERS = ("riccati", "pid")
GAINS = PidGains(
    position_gain_1_s2=2.0, velocity_gain_1_s=2.5, integral_gain_1_s3=1.0, integral_limit_m_s2=0.5
)
BY_PID = CONFIG.model_copy(update={"pid": PidConfig(horizontal=GAINS, vertical=GAINS)})


def _tracker(name: str) -> Tracker:
    return make_tracker(ControlConfig.model_validate({"controller": name}), LAGS_S)


def _nan_target() -> Target:
    target = hover_at((1.0, 0.0, 0.0))
    target.velocity_m_s[3, 1] = math.nan
    return target


def test_the_settings_choose() -> None:
    assert type(_tracker("mpc")) is Mpc
    assert type(_tracker("riccati")) is RiccatiTracker
    assert type(_tracker("pid")) is PidTracker
    assert ControlConfig().controller == "mpc"


# ---------------------------------------------------------------- the recursion


def test_the_recursion_is_the_batch_optimum_without_constraints() -> None:
    target = curve()
    solution = RiccatiTracker(CONFIG, LAGS_S).solve(START, target, DISTURBANCE, LAST)
    needed = needed_inputs(target, DISTURBANCE, LAGS_S, DT)
    first_change = (needed[1] - needed[0]) / (CONFIG.rate_hz * DT)
    rows = [target.position_m, target.velocity_m_s, target.acceleration_m_s2]
    for axis in range(3):
        expected = batch_inputs(
            np.array([START.position_m[axis], START.velocity_m_s[axis], START.acceleration_m_s2[axis]]),
            np.stack([row[:, axis] for row in rows], axis=1),
            needed[:, axis],
            last=LAST[axis],
            first_change=float(first_change[axis]),
            d=DISTURBANCE[axis],
            axis=axis,
        )
        np.testing.assert_allclose(solution.inputs_m_s2[:, axis], expected, atol=1e-6)


def test_the_recursion_is_the_mpc_where_no_constraint_binds() -> None:
    free = CONFIG.model_copy(update={"limits": LimitsConfig(jerk_m_s3=200.0)})
    ours = RiccatiTracker(free, LAGS_S).solve(START, curve(), DISTURBANCE, LAST)
    theirs = Mpc(free, LAGS_S).solve(START, curve(), DISTURBANCE, LAST)
    # as near as OSQP's own tolerance lets it come
    np.testing.assert_allclose(ours.inputs_m_s2, theirs.inputs_m_s2, atol=5e-3)
    np.testing.assert_allclose(ours.states, theirs.states, atol=5e-3)


def test_the_recursion_knows_no_bounds() -> None:
    far = RiccatiTracker(CONFIG, LAGS_S).solve(AT_REST, hover_at((8.0, 0.0, 0.0)), ZERO3, ZERO3)
    assert far.inputs_m_s2[:, 0].max() > CONFIG.limits.horizontal_acceleration_m_s2


# ---------------------------------------------------------------- the PID


def test_the_pid_is_its_law() -> None:
    target = Target(
        np.tile([0.3, 0.0, 0.0], (N + 1, 1)),
        np.tile([0.0, 0.2, 0.0], (N + 1, 1)),
        np.tile([0.0, 0.0, 0.1], (N + 1, 1)),
    )
    first = PidTracker(BY_PID, LAGS_S).solve(AT_REST, target, DISTURBANCE, LAST).inputs_m_s2[0]
    grown = 1.0 * 0.3 / CONFIG.rate_hz
    assert first == pytest.approx((2.0 * 0.3 + grown, 2.5 * 0.2, 0.1))


def _integral_after(tracker: PidTracker, error_m: float, seconds: float) -> float:
    """The input at no error, after so long at one: what has been integrated."""
    for _ in range(round(seconds * CONFIG.rate_hz)):
        tracker.solve(AT_REST, hover_at((error_m, 0.0, 0.0)), ZERO3, ZERO3)
    return float(tracker.solve(AT_REST, hover_at(ZERO3), ZERO3, ZERO3).inputs_m_s2[0, 0])


def test_the_integral_grows_to_its_bound_and_forgets_on_reset() -> None:
    tracker = PidTracker(BY_PID, LAGS_S)
    assert _integral_after(tracker, 0.2, 1.0) == pytest.approx(0.2, rel=1e-6)
    assert _integral_after(tracker, 0.2, 3.0) == pytest.approx(0.5)
    tracker.reset()
    assert _integral_after(tracker, 0.0, 0.2) == 0.0


def test_the_integral_waits_while_the_command_is_at_its_bound() -> None:
    assert _integral_after(PidTracker(BY_PID, LAGS_S), 5.0, 2.0) == 0.0
    # and comes back from its own bound as soon as the error turns
    tracker = PidTracker(BY_PID, LAGS_S)
    assert _integral_after(tracker, 0.2, 4.0) == pytest.approx(0.5)
    assert _integral_after(tracker, -0.2, 1.0) == pytest.approx(0.3)


@pytest.mark.parametrize("name", OTHERS)
def test_numbers_that_are_none_command_nothing_and_say_so(name: str) -> None:
    tracker = _tracker(name)
    bad_start = Motion((math.nan, 0.0, 0.0), ZERO3, ZERO3)
    for start, target in ((bad_start, hover_at(ZERO3)), (AT_REST, _nan_target())):
        solution = tracker.solve(start, target, ZERO3, ZERO3)
        assert not solution.solved
        assert not solution.inputs_m_s2.any()
    assert tracker.solve(AT_REST, hover_at((0.1, 0.0, 0.0)), ZERO3, ZERO3).inputs_m_s2[0, 0] > 0.0


# ---------------------------------------------------------------- closed loop

APPROACH = min_jerk_offset((2.0, -1.0, -5.0), (0.0, 0.0, -2.0), 6.0)


def _wind(_time_s: float) -> Vector3:
    return (0.8, -0.6, 0.0)


@pytest.mark.parametrize(("pad", "bound_m"), [(still, 0.03), (line, 0.03), (circle, 0.06)])
@pytest.mark.parametrize("name", OTHERS)
def test_the_others_stay_over_the_pad_too(name: str, pad: PadMotion, bound_m: float) -> None:
    flight = Loop(controller(controller=name), VelocityAutopilot(), pad, APPROACH).fly(20.0)
    assert flight.lateral_error_m(12.0) < bound_m
    assert np.abs(flight.error_m(12.0)[:, 2]).max() < 0.05


@pytest.mark.parametrize("name", OTHERS)
def test_the_others_meet_steady_wind_by_attitude_too(name: str) -> None:
    fly = controller(controller=name, setpoint="attitude")
    flight = Loop(fly, AttitudeAutopilot(), line, APPROACH, wind=_wind).fly(20.0)
    assert flight.lateral_error_m(15.0) < 0.05


# ----------------
# The recursion of eqs. 40-42 against the batch problem it solves: dense, and OSQP without constraints.


@dataclass(frozen=True)
class Problem:
    """A random tracking problem whose matrices change from step to step."""

    start: FloatArray
    A: FloatArray
    B: FloatArray
    reference: FloatArray
    weights: Weights
    trim: FloatArray
    drift: FloatArray

    def solve(self) -> Tracking:
        return solve_tracking(
            self.start, self.A, self.B, self.reference, self.weights, trim=self.trim, drift=self.drift
        )


def _positive(rng: np.random.Generator, size: int) -> FloatArray:
    root = rng.normal(size=(size, size))
    made: FloatArray = root @ root.T + 0.5 * np.eye(size)
    return made


def problem(seed: int, N: int = 12, n: int = 5, m: int = 2, p: int = 3) -> Problem:
    rng = np.random.default_rng(seed)
    weights = Weights(rng.normal(size=(p, n)), _positive(rng, p), _positive(rng, m), _positive(rng, p))
    return Problem(
        rng.normal(size=n),
        np.eye(n) + 0.2 * rng.normal(size=(N, n, n)),
        rng.normal(size=(N, n, m)),
        rng.normal(size=(N + 1, p)),
        weights,
        rng.normal(size=(N, m)),
        0.3 * rng.normal(size=(N, n)),
    )


def batch(made: Problem) -> tuple[FloatArray, FloatArray]:
    """Hessian and gradient of eq. 39 in the stacked inputs without their trim, the states eliminated."""
    N, n, m = made.B.shape
    w = made.weights
    free, forced = made.start, np.zeros((n, N * m))
    hessian = np.zeros((N * m, N * m))
    hessian += np.kron(np.eye(N), w.R)
    gradient = np.zeros(N * m)
    for i in range(N):
        free = made.A[i] @ free + made.drift[i]
        forced = made.A[i] @ forced
        forced[:, i * m : (i + 1) * m] += made.B[i]
        weight = w.S if i == N - 1 else w.Q
        seen = w.C @ forced
        hessian += seen.T @ weight @ seen
        gradient += seen.T @ weight @ (w.C @ free - made.reference[i + 1])
    return hessian, gradient


@pytest.mark.parametrize("seed", range(5))
def test_equals_the_dense_batch_solution(seed: int) -> None:
    made = problem(seed)
    hessian, gradient = batch(made)
    expected = -np.linalg.solve(hessian, gradient).reshape(made.trim.shape) + made.trim
    assert np.allclose(made.solve().inputs, expected, atol=1e-9)


def test_equals_osqp_without_constraints() -> None:
    made = problem(7)
    hessian, gradient = batch(made)
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(hessian)),
        gradient,
        sparse.csc_matrix((0, gradient.size)),
        np.zeros(0),
        np.zeros(0),
        eps_abs=1e-10,
        eps_rel=1e-10,
        max_iter=20000,
        verbose=False,
    )
    found = np.array(solver.solve(raise_error=False).x).reshape(made.trim.shape) + made.trim
    assert np.abs(found - made.solve().inputs).max() < 1e-6


def test_the_states_are_where_the_inputs_lead_and_the_gains_say_the_same() -> None:
    made = problem(3)
    found = made.solve()
    x = made.start
    for i in range(len(made.trim)):
        u = made.trim[i] - found.gains[i] @ x + found.feedforward[i]
        assert np.allclose(u, found.inputs[i])
        x = made.A[i] @ x + made.B[i] @ (u - made.trim[i]) + made.drift[i]
        assert np.allclose(x, found.states[i + 1])


def test_one_pair_of_matrices_serves_all_steps_and_nothing_need_be_added() -> None:
    made = problem(4)
    once = solve_tracking(made.start, made.A[0], made.B[0], made.reference, made.weights)
    A, B = (np.repeat(matrix[:1], len(made.trim), axis=0) for matrix in (made.A, made.B))
    trim, drift = np.zeros(2), np.zeros(5)
    each = solve_tracking(made.start, A, B, made.reference, made.weights, trim=trim, drift=drift)
    assert np.array_equal(once.inputs, each.inputs)


def test_a_long_horizon_gives_the_stationary_gain() -> None:
    A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
    weights = Weights(np.eye(2), np.diag([4.0, 1.0]), np.array([[0.5]]), np.eye(2))
    found = solve_tracking(np.zeros(2), A, B, np.zeros((301, 2)), weights)
    P = scipy.linalg.solve_discrete_are(A, B, weights.Q, weights.R)
    assert np.allclose(found.gains[0], np.linalg.solve(weights.R + B.T @ P @ B, B.T @ P @ A), rtol=1e-8)
