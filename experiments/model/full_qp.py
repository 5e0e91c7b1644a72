"""The MPC on 12 states as a sparse quadratic programme (eq. 39): its matrices, and which entries change.

Everything counts from a nominal trajectory (`nominal.py`). Variables, in this order, for N steps: states
x_1..x_N (12 each), inputs u_0..u_{N-1} (4 each), slacks (SOFT and one for each half-space). The slacks are
free and costly, so that a vehicle that already breaks a bound on its state still has a solution.

Rows, in this order: dynamics (12N, equalities), rotor thrusts (4N, hard), bounds on the state by step (roll,
pitch, three velocities, three rates, height: SOFT each), half-spaces (obstacles by step).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from companion.base.geometry import FloatArray
from experiments.model.quadrotor import ANGLES, INPUTS, POSITION, RATES, STATES, VELOCITY, structure

# states that have bounds: roll and pitch, velocities, rates, height
BOUNDED = [*ANGLES[:2], *VELOCITY, *RATES, POSITION[2]]
SOFT = len(BOUNDED)


@dataclass(frozen=True)
class FullLayout:
    """Where things are among the variables and rows, for N steps and so many half-spaces a step."""

    steps: int
    planes: int

    @property
    def states(self) -> slice:
        return slice(0, STATES * self.steps)

    @property
    def inputs(self) -> slice:
        return slice(self.states.stop, (STATES + INPUTS) * self.steps)

    @property
    def slacks(self) -> slice:
        return slice(self.inputs.stop, self.inputs.stop + (SOFT + self.planes) * self.steps)

    @property
    def variables(self) -> int:
        return (STATES + INPUTS + SOFT + self.planes) * self.steps

    @property
    def dynamics(self) -> slice:
        return slice(0, STATES * self.steps)

    @property
    def rotors(self) -> slice:
        return slice(self.dynamics.stop, self.dynamics.stop + INPUTS * self.steps)

    @property
    def bounds(self) -> slice:
        return slice(self.rotors.stop, self.rotors.stop + SOFT * self.steps)

    @property
    def half_spaces(self) -> slice:
        return slice(self.bounds.stop, self.bounds.stop + self.planes * self.steps)

    @property
    def rows(self) -> int:
        return (STATES + INPUTS + SOFT + self.planes) * self.steps


class ConstraintMatrix:
    """The rows' matrix with its structure fixed: `values` gives the data for new steps and half-spaces."""

    def __init__(self, layout: FullLayout, thrusts_from_inputs: FloatArray) -> None:
        """`thrusts_from_inputs` (4, 4) turns U into what the rotors' rows bound."""
        self._layout = layout
        a, b = structure()
        # the first state is given, so the first step's A is on the right-hand side
        self._a_rows, self._a_columns = np.nonzero(a)
        self._b_rows, self._b_columns = np.nonzero(b)
        fixed_rows, fixed_columns, self._fixed = _fixed_entries(layout, thrusts_from_inputs)
        rows, columns = self._changing_entries()
        rows, columns = np.concatenate([fixed_rows, rows]), np.concatenate([fixed_columns, columns])
        # numbered entries show where each goes in the compressed columns
        numbered = sparse.csc_matrix(
            (np.arange(1.0, len(rows) + 1.0), (rows, columns)), shape=(layout.rows, layout.variables)
        )
        self._order = numbered.data.astype(np.intp) - 1
        self._indices, self._pointers = numbered.indices, numbered.indptr

    def _changing_entries(self) -> tuple[FloatArray, FloatArray]:
        N, planes, layout = self._layout.steps, self._layout.planes, self._layout
        step = np.arange(N)[:, None]
        later = step[1:]
        half = layout.half_spaces.start + np.arange(N * planes)[:, None]
        rows = [STATES * later + self._a_rows, STATES * step + self._b_rows, half + np.zeros(3, dtype=int)]
        columns = [
            STATES * (later - 1) + self._a_columns,
            layout.inputs.start + INPUTS * step + self._b_columns,
            STATES * np.repeat(step, planes, axis=0) + POSITION,
        ]
        return np.concatenate([r.ravel() for r in rows]), np.concatenate([c.ravel() for c in columns])

    def values(self, A: FloatArray, B: FloatArray, normals: FloatArray) -> FloatArray:
        """Data of the compressed columns for A (N, 12, 12), B (N, 12, 4) and normals (N, planes, 3)."""
        entries = np.concatenate(
            [
                self._fixed,
                -A[1:, self._a_rows, self._a_columns].ravel(),
                -B[:, self._b_rows, self._b_columns].ravel(),
                normals.ravel(),
            ]
        )
        ordered: FloatArray = entries[self._order]
        return ordered

    def matrix(self, values: FloatArray) -> sparse.csc_matrix:
        """The matrix itself."""
        shape = (self._layout.rows, self._layout.variables)
        return sparse.csc_matrix((values, self._indices, self._pointers), shape=shape)


def _fixed_entries(
    layout: FullLayout, thrusts_from_inputs: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows, columns and values of what stays: the next states, the rotors, the bounds, all slacks."""
    N = layout.steps
    count = STATES * N
    rotor_rows, rotor_columns = (grid.ravel() for grid in np.indices((INPUTS, INPUTS)))
    step = np.arange(N)[:, None]
    slack = np.arange(layout.slacks.stop - layout.slacks.start)
    rows = [
        np.arange(count),
        (layout.rotors.start + INPUTS * step + rotor_rows).ravel(),
        np.arange(layout.bounds.start, layout.bounds.stop),
        layout.bounds.start + slack,
    ]
    columns = [
        np.arange(count),
        (layout.inputs.start + INPUTS * step + rotor_columns).ravel(),
        (STATES * step + BOUNDED).ravel(),
        layout.slacks.start + slack,
    ]
    values = [
        np.ones(count),
        np.tile(thrusts_from_inputs.ravel(), N),
        np.ones(SOFT * N),
        np.ones(len(slack)),
    ]
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def cost_matrix(
    layout: FullLayout, Q: FloatArray, R: FloatArray, S: FloatArray, slack_weights: FloatArray
) -> sparse.csc_matrix:
    """P, upper triangle: Q (12, 12) a step, S at the end, R (4, 4), and a weight for each slack of a step."""
    blocks = [Q] * (layout.steps - 1) + [S] + [R] * layout.steps
    slacks = sparse.diags(np.tile(slack_weights[:SOFT], layout.steps))
    spaces = sparse.identity(layout.planes * layout.steps) * slack_weights[-1]
    P = sparse.block_diag([*blocks, slacks, spaces], format="csc")
    return sparse.csc_matrix(sparse.triu(P, format="csc"))
