"""The recursion of eqs. 40-42 against the batch problem it solves: dense, and OSQP without constraints."""

from dataclasses import dataclass

import numpy as np
import osqp
import pytest
import scipy.linalg
from scipy import sparse

from companion.base.geometry import FloatArray
from companion.control.baselines.riccati import Tracking, Weights, solve_tracking


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
