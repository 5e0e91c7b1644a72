"""The MPC as a sparse quadratic programme (eq. 39): its matrices, built once.

Variables, in this order, for N steps: states x_1..x_N (9 each: position, velocity, acceleration, NED),
inputs u_0..u_{N-1} (3 each), velocity slacks (3 each), floor slacks (1 each). The slacks are free and costly,
so that a vehicle that already breaks a bound on its state still has a solution.

Rows, in this order: dynamics (9N, equalities), inputs (`input_bounds`: 17N), input change (3N), speed octagon
(4N), vertical speed (N), floor (N). The flown acceleration needs no rows: behind a lag it stays between where
it starts and the bounds of the inputs, plus the disturbance.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
from scipy import sparse

from companion.base.geometry import FloatArray, Vector3
from companion.config import ControlConfig, TrackingConfig
from companion.control.mpc.input_bounds import INPUT_ROWS, OCTAGON
from companion.control.response.flight_model import discretise

VELOCITY_SLACK_WEIGHT = 400.0  # 1 / (0.05 m/s)^2
FLOOR_SLACK_WEIGHT = 4000.0  # 1 / (1.6 cm)^2
# variables and rows of one step, in their order
VARIABLES: Final = {"states": 9, "inputs": 3, "velocity_slacks": 3, "floor_slacks": 1}
ROWS: Final = {"dynamics": 9, "input": INPUT_ROWS, "change": 3, "speed": 4, "vertical_speed": 1, "floor": 1}


@dataclass(frozen=True)
class AxisCost:
    """Weights of one axis: Q on (p, v, a), R on the input, S on its change, and the terminal (4, 4) on
    (p, v, a, last input), which is the cost of going on for ever without constraints (eq. 42)."""

    Q: FloatArray
    R: float
    S: float
    terminal: FloatArray


@dataclass(frozen=True)
class QuadraticProgram:
    """Least 1/2 z'Pz + q'z with lower <= A z <= upper; P is its upper triangle."""

    P: sparse.csc_matrix
    q: FloatArray
    A: sparse.csc_matrix
    lower: FloatArray
    upper: FloatArray


def places(each_step: Mapping[str, int], steps: int) -> dict[str, slice]:
    """Where each kind of variable, or of row, stands by its name: all of one kind together."""
    slices, start = {}, 0
    for name, each in each_step.items():
        slices[name] = slice(start, start + each * steps)
        start += each * steps
    return slices


def axis_cost(weights: TrackingConfig, step_s: float, tau_s: float) -> AxisCost:
    """Weights of one axis and the terminal cost that makes the horizon as good as endless."""
    Q = np.diag([weights.position_m**-2, weights.velocity_m_s**-2, weights.acceleration_m_s2**-2])
    R, S = weights.effort_m_s2**-2, weights.effort_change_m_s2**-2
    A, B = discretise(step_s, tau_s)
    # the last input joins the state, so that the price of changing it has a memory
    F = scipy.linalg.block_diag(A, 0.0)
    G = np.append(B, 1.0)[:, None]
    cost = scipy.linalg.block_diag(Q, S)
    cross = np.array([[0.0], [0.0], [0.0], [-S]])
    terminal = scipy.linalg.solve_discrete_are(F, G, cost, np.array([[R + S]]), s=cross)
    return AxisCost(Q, R, S, 0.5 * (terminal + terminal.T))


def axis_costs(config: ControlConfig, lags_s: Vector3) -> tuple[AxisCost, AxisCost, AxisCost]:
    """Costs along north, east and down."""
    x, y, z = lags_s
    sideways = {lag_s: axis_cost(config.horizontal, config.step_s, lag_s) for lag_s in {x, y}}
    return sideways[x], sideways[y], axis_cost(config.vertical, config.step_s, z)


def step_matrices(step_s: float, lags_s: Vector3) -> tuple[FloatArray, FloatArray]:
    """A (9, 9) and B (9, 3) of one step of all axes; the state is position, velocity, acceleration, NED."""
    A, B = np.zeros((9, 9)), np.zeros((9, 3))
    for axis, lag_s in enumerate(lags_s):
        A[axis::3, axis::3], B[axis::3, axis] = discretise(step_s, lag_s)
    return A, B


def cost_matrix(costs: tuple[AxisCost, AxisCost, AxisCost], steps: int) -> sparse.csc_matrix:
    """P, upper triangle, of 1/2 z'Pz + q'z.

    The terminal cost covers the last change's memory: it is on x_N and u_{N-1} and replaces no stage's.
    """
    at, count = places(VARIABLES, steps), steps * sum(VARIABLES.values())
    P = np.zeros((count, count))
    for axis, cost in enumerate(costs):
        for k in range(steps):
            x = [9 * k + axis, 9 * k + 3 + axis, 9 * k + 6 + axis]
            u = at["inputs"].start + 3 * k + axis
            P[u, u] += cost.R + cost.S
            if k + 1 < steps:
                P[np.ix_(x, x)] += cost.Q
                P[u, u] += cost.S
                P[u, u + 3] += -cost.S
            else:
                last = [*x, u]
                P[np.ix_(last, last)] += cost.terminal
    for slacks, weight in (
        (at["velocity_slacks"], VELOCITY_SLACK_WEIGHT),
        (at["floor_slacks"], FLOOR_SLACK_WEIGHT),
    ):
        for i in range(slacks.start, slacks.stop):
            P[i, i] = weight
    return sparse.csc_matrix(np.triu(P))


def constraint_matrix(A: FloatArray, B: FloatArray, steps: int, *, inputs: FloatArray) -> sparse.csc_matrix:
    """The rows' matrix, in the order of the module's docstring, for one step's `step_matrices`.

    `inputs` (17, 3) are `input_bounds.input_rows`.
    """
    eye, previous = sparse.identity(steps), sparse.eye(steps, k=-1)
    three = sparse.identity(3)
    state = sparse.kron(eye, sparse.identity(9)) - sparse.kron(previous, A)
    octagon = np.hstack([OCTAGON, np.zeros((4, 1))])
    down = np.array([[0.0, 0.0, 1.0]])

    def each(rows: FloatArray) -> sparse.spmatrix:
        return sparse.kron(eye, rows)

    def on_states(rows: FloatArray, offset: int) -> sparse.spmatrix:
        return each(np.pad(rows, ((0, 0), (offset, 6 - offset))))

    blocks = [
        [state, -each(B), None, None],
        [None, each(inputs), None, None],
        [None, sparse.kron(eye - previous, three), None, None],
        [on_states(octagon, 3), None, each(octagon), None],
        [on_states(down, 3), None, each(down), None],
        [on_states(down, 0), None, None, eye],
    ]
    return sparse.csc_matrix(sparse.bmat(blocks, format="csc"))
