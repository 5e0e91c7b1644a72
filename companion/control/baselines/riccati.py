"""The paper's tracking recursion: finite-horizon LQ tracking without constraints (eqs. 38-42).

Minimised is eq. 39,
    J = 1/2 |C x_N - Z_N|²_S + 1/2 sum_{i<N} (|C x_i - Z_i|²_Q + |u_i - trim_i|²_R),
under eq. 38 without its noise, along a trajectory whose matrices may differ from step to step:
    x_{i+1} = A_i x_i + B_i (u_i - trim_i) + w_i.

Swept backwards, P and g of eqs. 41 and 42 give the inputs of eq. 40. The paper has no w; with it each g_{i+1}
becomes g_{i+1} - P_{i+1} w_i. Here K = (R + B'PB)⁻¹ B'PA stands for the paper's (I + B R⁻¹ B' P)⁻¹: by the
matrix inversion lemma A'P (I + B R⁻¹ B' P)⁻¹ A = A'P (A - B K), which needs no inverse of R and solves m
equations, not n. Frame-free, in the units of the model that is handed in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.base.geometry import FloatArray


@dataclass(frozen=True)
class Weights:
    """Eq. 39: Q and S (p, p) on the outputs C x of a step and of the last one, R (m, m) on the inputs."""

    C: FloatArray
    Q: FloatArray
    R: FloatArray
    S: FloatArray


@dataclass(frozen=True)
class Tracking:
    """Inputs (N, m) with their trim, the states (N + 1, n) they lead to, and gains K (N, m, n).

    In closed loop u_i = trim_i - K_i x_i + feedforward_i (N, m).
    """

    inputs: FloatArray
    states: FloatArray
    gains: FloatArray
    feedforward: FloatArray


def solve_tracking(
    start: FloatArray,
    A: FloatArray,
    B: FloatArray,
    reference: FloatArray,
    weights: Weights,
    *,
    trim: FloatArray | None = None,
    drift: FloatArray | None = None,
) -> Tracking:
    """The inputs that minimise eq. 39 over the horizon, and where they lead.

    Args:
        start: x_0 (n,).
        A: (n, n) for all steps, or (N, n, n).
        B: (n, m) for all steps, or (N, n, m).
        reference: Z (N + 1, p), rows 0..N; it says how long the horizon is.
        weights: C (p, n), Q, R and S; R positive definite, Q and S positive semidefinite.
        trim: input of the linearisation (m,) or (N, m), which costs nothing; none is zero.
        drift: w (n,) or (N, n), what moves the state besides: a disturbance or the remainder of a
            linearisation; none is zero, as in the paper.

    Raises:
        ValueError: shapes do not fit one another.
        numpy.linalg.LinAlgError: R + B'PB is singular.
    """
    N, n, m = len(reference) - 1, start.shape[0], B.shape[-1]
    steps_A, steps_B = np.broadcast_to(A, (N, n, n)), np.broadcast_to(B, (N, n, m))
    w = np.broadcast_to(np.zeros(n) if drift is None else drift, (N, n))
    trims = np.broadcast_to(np.zeros(m) if trim is None else trim, (N, m))
    gains, feedforward = _sweep_back(steps_A, steps_B, w, reference, weights)
    states, relative = np.empty((N + 1, n)), np.empty((N, m))
    states[0] = start
    for i in range(N):
        relative[i] = feedforward[i] - gains[i] @ states[i]
        states[i + 1] = steps_A[i] @ states[i] + steps_B[i] @ relative[i] + w[i]
    return Tracking(relative + trims, states, gains, feedforward)


def _sweep_back(
    A: FloatArray, B: FloatArray, w: FloatArray, Z: FloatArray, weights: Weights
) -> tuple[FloatArray, FloatArray]:
    """K (N, m, n) and feed-forward (N, m) of eq. 40, by eqs. 41 and 42 from the end to the start."""
    C, R = weights.C, weights.R
    V = C.T @ weights.Q @ C
    pulls = Z @ (weights.Q @ C)  # rows (W Z_i)', since Q is symmetric
    N, n, m = B.shape
    gains, feedforward = np.empty((N, m, n)), np.empty((N, m))
    P, g = C.T @ weights.S @ C, C.T @ (weights.S @ Z[-1])
    for i in range(N - 1, -1, -1):
        a, b = A[i], B[i]
        g = g - P @ w[i]
        PA, PB = P @ a, P @ b
        right = np.column_stack((PB.T @ a, b.T @ g))
        solved = np.linalg.solve(R + b.T @ PB, right)
        K = gains[i] = solved[:, :n]
        feedforward[i] = solved[:, n]
        P = V + a.T @ (PA - PB @ K)
        P = 0.5 * (P + P.T)  # else rounding makes it drift from symmetry over a hundred steps
        g = pulls[i] + a.T @ (g - PB @ feedforward[i])
    return gains, feedforward
