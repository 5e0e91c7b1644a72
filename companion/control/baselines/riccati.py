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


@dataclass(frozen=True)
class Gains:
    """What of the answer depends on neither reference nor drift, for i = 0..N-1.

    K_i (N, m, n) of eq. 40, P_{i+1} (N, n, n) of eq. 41, P_{i+1} B_i (N, n, m), and (R + B'PB)⁻¹ B'
    (N, m, n), which makes the feed-forward of g.
    """

    K: FloatArray
    P: FloatArray
    PB: FloatArray
    forward: FloatArray


def solve_tracking(
    start: FloatArray,
    A: FloatArray,
    B: FloatArray,
    reference: FloatArray,
    weights: Weights,
    *,
    trim: FloatArray | None = None,
    drift: FloatArray | None = None,
    gains: Gains | None = None,
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
        gains: `tracking_gains` of these A, B and weights, where they are kept from call to call.

    Raises:
        ValueError: shapes do not fit one another.
        numpy.linalg.LinAlgError: R + B'PB is singular.
    """
    N, n, m = len(reference) - 1, start.shape[0], B.shape[-1]
    steps_A, steps_B = np.broadcast_to(A, (N, n, n)), np.broadcast_to(B, (N, n, m))
    w = np.broadcast_to(np.zeros(n) if drift is None else drift, (N, n))
    trims = np.broadcast_to(np.zeros(m) if trim is None else trim, (N, m))
    if gains is None:
        gains = tracking_gains(steps_A, steps_B, weights, N)
    feedforward = _feedforward(steps_A, gains, w, reference, weights)
    states, relative = np.empty((N + 1, n)), np.empty((N, m))
    states[0] = start
    for i in range(N):
        relative[i] = feedforward[i] - gains.K[i] @ states[i]
        states[i + 1] = steps_A[i] @ states[i] + steps_B[i] @ relative[i] + w[i]
    return Tracking(relative + trims, states, gains.K, feedforward)


def tracking_gains(A: FloatArray, B: FloatArray, weights: Weights, steps: int) -> Gains:
    """Eq. 41 swept from the end of `steps` steps to their start.

    Args:
        A: (n, n) for all steps, or (N, n, n).
        B: (n, m) for all steps, or (N, n, m).
        weights: as in `solve_tracking`.
        steps: N.

    Raises:
        numpy.linalg.LinAlgError: R + B'PB is singular.
    """
    n, m = B.shape[-2:]
    A, B = np.broadcast_to(A, (steps, n, n)), np.broadcast_to(B, (steps, n, m))
    C = weights.C
    V, P = C.T @ weights.Q @ C, C.T @ weights.S @ C
    swept = Gains(
        np.empty((steps, m, n)), np.empty((steps, n, n)), np.empty((steps, n, m)), np.empty((steps, m, n))
    )
    for i in range(steps - 1, -1, -1):
        a, b = A[i], B[i]
        PA, PB = P @ a, P @ b
        solved = np.linalg.solve(weights.R + b.T @ PB, np.hstack((PB.T @ a, b.T)))
        K = solved[:, :n]
        swept.K[i], swept.P[i], swept.PB[i], swept.forward[i] = K, P, PB, solved[:, n:]
        P = V + a.T @ (PA - PB @ K)
        P = 0.5 * (P + P.T)  # else rounding makes it drift from symmetry over a hundred steps
    return swept


def _feedforward(A: FloatArray, gains: Gains, w: FloatArray, Z: FloatArray, weights: Weights) -> FloatArray:
    """The feed-forward (N, m) of eq. 40, by eq. 42 from the end to the start."""
    pulls = Z @ (weights.Q @ weights.C)  # rows (W Z_i)', since Q is symmetric
    found = np.empty(gains.K.shape[:2])
    g = weights.C.T @ (weights.S @ Z[-1])
    for i in range(len(found) - 1, -1, -1):
        g = g - gains.P[i] @ w[i]
        found[i] = gains.forward[i] @ g
        g = pulls[i] + A[i].T @ (g - gains.PB[i] @ found[i])
    return found
