"""Model predictive control on the paper's 12 states and U1..U4 (eqs. 38 and 39, with constraints).

Linearised along the reference's flat trajectory (`nominal.py`), which the estimated disturbance of the air
enters, so that nothing lasting is left over. Bounds on tilt, velocity, rates and height over the pad, and
half-spaces clear of obstacles, are soft and costly; what the rotors can do is hard. Solved by OSQP: the
structure is set up once, a step changes values, and starts from the last solution. Deterministic: iterations
bound the work.

`FullRiccatiTracker` is the paper's own recursion with the same weights, model and reference, unconstrained.
Axes: the paper's z-up ones, SI units.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import osqp
import scipy.linalg
from pydantic import Field
from scipy import sparse

from companion.base.geometry import FloatArray
from companion.config import StrictModel, find_file, load_model
from companion.control.baselines import riccati
from experiments.model.disturbance_filter import (
    NO_DISTURBANCE,
    DisturbanceFilterConfig,
    HorizonReference,
    Nominal,
    along,
)
from experiments.model.quadrotor import (
    ANGLES,
    INPUTS,
    POSITION,
    RATES,
    STATES,
    VELOCITY,
    QuadrotorModel,
    structure,
)

FAR: Final = 1e4  # a bound that does not bind; infinity would change the row's kind
# a soft bound's excess that costs 1, a tenth of the weights' own deviations and less: of roll and pitch,
# velocities, rates (rad, m/s, rad/s) and height (m); and of a half-space. Dearer ones make the solver slow.
SOFT_EXCESS: Final = (0.01, 0.01, 0.03, 0.03, 0.03, 0.1, 0.1, 0.1, 0.004)
PLANE_EXCESS_M: Final = 0.004
SOLVED: Final = 1
NEARLY_SOLVED: Final = (2, 7)
ACCEPTED_RESIDUAL: Final = 3e-2


class FullWeights(StrictModel):
    """Eq. 39's weights, each as the deviation from the nominal that costs 1."""

    position_m: float = Field(gt=0.0, le=10.0)
    velocity_m_s: float = Field(gt=0.0, le=20.0)
    tilt_rad: float = Field(gt=0.0, le=10.0)
    heading_rad: float = Field(gt=0.0, le=10.0)
    rate_rad_s: float = Field(gt=0.0, le=100.0)
    thrust_n: float = Field(gt=0.0, le=500.0)
    torque_n_m: float = Field(gt=0.0, le=50.0)
    yaw_torque_n_m: float = Field(gt=0.0, le=50.0)


class FullLimits(StrictModel):
    """What the vehicle must stay within; `margin` is the share of each that the MPC keeps off it."""

    tilt_deg: float = Field(gt=0.0, le=60.0)  # of roll, and of pitch
    horizontal_speed_m_s: float = Field(gt=0.0, le=20.0)  # along each axis
    vertical_speed_m_s: float = Field(gt=0.0, le=10.0)
    rate_rad_s: float = Field(gt=0.0, le=20.0)
    yaw_rate_rad_s: float = Field(gt=0.0, le=20.0)
    least_thrust_share: float = Field(ge=0.0, le=0.5)  # of a rotor's full thrust
    most_thrust_share: float = Field(gt=0.5, le=1.0)
    margin: float = Field(ge=0.0, le=0.3)


class FullMpcConfig(StrictModel):
    """The tracker on 12 states, as configs/control/*.yaml has it."""

    steps: int = Field(ge=5, le=100)
    step_s: float = Field(ge=0.005, le=0.2)
    reach_m: float = Field(default=1.0, gt=0.0, le=10.0)  # a reference farther off is drawn nearer
    maximum_iterations: int = Field(default=400, ge=50, le=10000)
    weights: FullWeights
    limits: FullLimits
    push: DisturbanceFilterConfig


def load_full(name: str | Path) -> FullMpcConfig:
    """Settings by name (from configs/control) or path.

    Raises:
        ConfigError: the file is missing, not YAML, or a value is out of range.
    """
    return load_model(FullMpcConfig, find_file("control", name))


@dataclass(frozen=True)
class ObstacleBounds:
    """What is in the way, for the states of rows 1..N.

    `floor_m` (N,) is the least height. A half-space allows positions with normal · position >= offset:
    `normals` (N, planes, 3), `offsets_m` (N, planes).
    """

    floor_m: FloatArray
    normals: FloatArray
    offsets_m: FloatArray


@dataclass(frozen=True)
class FullSolution:
    """Inputs (N, 4) and states (N + 1, 12); `solved` is false for the old plan."""

    inputs: FloatArray
    states: FloatArray
    solved: bool
    iterations: int

    @property
    def first(self) -> FloatArray:
        """U (4,) to apply now: Algorithm 2 plans again before the second."""
        first: FloatArray = self.inputs[0]
        return first


def eq39_weights(config: FullMpcConfig, model: QuadrotorModel) -> riccati.Weights:
    """Eq. 39's matrices with C the identity; S is the cost of going on in hover for ever."""
    w = config.weights
    deviations = np.empty(STATES)
    deviations[POSITION], deviations[VELOCITY] = w.position_m, w.velocity_m_s
    deviations[ANGLES] = w.tilt_rad, w.tilt_rad, w.heading_rad
    deviations[RATES] = w.rate_rad_s
    Q = np.diag(deviations**-2.0)
    R = np.diag(np.array([w.thrust_n, w.torque_n_m, w.torque_n_m, w.yaw_torque_n_m]) ** -2.0)
    A, B = model.linearise(np.zeros(STATES), model.hover, config.step_s)
    S = scipy.linalg.solve_discrete_are(A, B, Q, R)
    return riccati.Weights(np.eye(STATES), Q, R, 0.5 * (S + S.T))


class FullRiccatiTracker:
    """Eqs. 39-42 along the same trajectory as the MPC's; knows of no bound."""

    def __init__(self, config: FullMpcConfig, model: QuadrotorModel) -> None:
        self._step_s = config.step_s
        self._model = model
        self._weights = eq39_weights(config, model)

    def solve(
        self, state: FloatArray, reference: HorizonReference, disturbance: FloatArray = NO_DISTURBANCE
    ) -> FullSolution:
        """The best inputs from a state (12,) without bounds; the paper has no disturbance."""
        nominal = along(reference, self._model, self._step_s, disturbance)
        A, B = self._model.linearise(nominal.states[:-1], nominal.inputs, self._step_s)
        found = riccati.solve_tracking(
            state - nominal.states[0],
            A,
            B,
            np.zeros_like(nominal.states),
            self._weights,
            drift=nominal.remainder,
        )
        return FullSolution(found.inputs + nominal.inputs, found.states + nominal.states, True, 0)


class FullMpc:
    """The constrained tracker. Keeps the last plan, for a warm start and for when a solve fails."""

    def __init__(self, config: FullMpcConfig, model: QuadrotorModel, planes: int = 0) -> None:
        """`planes`: half-spaces of a step, at most; it is part of the structure."""
        self._config = config
        self._model = model
        self._layout = FullLayout(config.steps, planes)
        self._rotor_rows = model.thrusts_from_inputs / model.full_rotor_thrust_n
        self._constraints = ConstraintMatrix(self._layout, self._rotor_rows)
        self._low, self._high = _state_bounds(config.limits)
        self._solver = self._set_up(eq39_weights(config, model))
        self._plan: FullSolution | None = None
        self._poisoned = False

    def _set_up(self, weights: riccati.Weights) -> osqp.OSQP:
        layout = self._layout
        nominal_A, nominal_B = self._model.linearise(
            np.zeros((layout.steps, STATES)),
            np.tile(self._model.hover, (layout.steps, 1)),
            self._config.step_s,
        )
        # no entry may be zero at the start, or the structure would lose it in scaling
        normals = np.full((layout.steps, layout.planes, 3), 0.5)
        values = self._constraints.values(nominal_A, nominal_B, normals)
        self._lower, self._upper = np.full(layout.rows, -FAR), np.full(layout.rows, FAR)
        self._lower[layout.dynamics] = self._upper[layout.dynamics] = 0.0
        slack_weights = np.array([*SOFT_EXCESS, PLANE_EXCESS_M]) ** -2.0
        solver = osqp.OSQP()
        solver.setup(
            cost_matrix(layout, weights.Q, weights.R, weights.S, slack_weights),
            np.zeros(layout.variables),
            self._constraints.matrix(values),
            self._lower,
            self._upper,
            eps_abs=1e-3,
            eps_rel=1e-3,
            max_iter=self._config.maximum_iterations,
            check_termination=10,
            # SI units are balanced as they are: OSQP's own scaling, made for the first matrix, takes twice
            # the iterations where bounds are active
            scaling=0,
            rho=10.0,
            adaptive_rho=1,
            adaptive_rho_interval=50,
            polishing=False,
            warm_starting=True,
            verbose=False,
        )
        return solver

    def reset(self) -> None:
        """Forget the last plan."""
        self._plan, self._poisoned = None, True

    def solve(
        self,
        state: FloatArray,
        reference: HorizonReference,
        surroundings: ObstacleBounds,
        disturbance: FloatArray = NO_DISTURBANCE,
    ) -> FullSolution:
        """The best inputs from a state (12,) within the bounds; the last plan, then hover, if there are none.

        Args:
            state: now (12,).
            reference: rows 0..N at multiples of the step from now.
            surroundings: the floor and the half-spaces of rows 1..N.
            disturbance: estimated accelerations (6,), see `nominal.along`.
        """
        if not (np.isfinite(state).all() and np.isfinite(disturbance).all()):
            return self._fall_back(0)
        near = within_reach(reference, state[POSITION], self._config.reach_m)
        nominal = along(near, self._model, self._config.step_s, disturbance)
        A, B = self._model.linearise(nominal.states[:-1], nominal.inputs, self._config.step_s)
        self._update_bounds(A[0] @ (state - nominal.states[0]), nominal, surroundings)
        values = self._constraints.values(A, B, surroundings.normals)
        if not (np.isfinite(values).all() and (self._lower <= self._upper).all()):
            return self._fall_back(0)
        self._solver.update(Ax=values, l=self._lower, u=self._upper)
        if self._poisoned:
            self._solver.warm_start(x=np.zeros(self._layout.variables), y=np.zeros(self._layout.rows))
            self._poisoned = False
        return self._take(self._solver.solve(raise_error=False), state, nominal)

    def _update_bounds(self, first: FloatArray, nominal: Nominal, around: ObstacleBounds) -> None:
        layout, lower, upper, limits = self._layout, self._lower, self._upper, self._config.limits
        dynamics = lower[layout.dynamics].reshape(-1, STATES)
        dynamics[:] = nominal.remainder
        dynamics[0] += first
        upper[layout.dynamics] = lower[layout.dynamics]
        shares = nominal.inputs @ self._rotor_rows.T
        lower[layout.rotors] = (limits.least_thrust_share - shares).ravel()
        upper[layout.rotors] = (limits.most_thrust_share - shares).ravel()
        bounded = nominal.states[1:, BOUNDED]
        lower_bounds = lower[layout.bounds].reshape(-1, SOFT)
        lower_bounds[:] = self._low - bounded
        lower_bounds[:, -1] = around.floor_m - bounded[:, -1]
        upper[layout.bounds] = (self._high - bounded).ravel()
        along_normals = np.einsum("kpi,ki->kp", around.normals, nominal.states[1:, POSITION])
        lower[layout.half_spaces] = (around.offsets_m - along_normals).ravel()

    def _take(self, result: Any, state: FloatArray, nominal: Nominal) -> FullSolution:
        info, x = result.info, np.array(result.x)
        iterations = int(info.iter)
        if not np.isfinite(x).all() or info.status_val not in (SOLVED, *NEARLY_SOLVED):
            self._poisoned = True
            return self._fall_back(iterations)
        if info.status_val != SOLVED and max(info.prim_res, info.dual_res) > ACCEPTED_RESIDUAL:
            return self._fall_back(iterations)  # and go on from this iterate next time
        inputs = nominal.inputs + x[self._layout.inputs].reshape(-1, INPUTS)
        states = nominal.states.copy()
        states[0] = state
        states[1:] += x[self._layout.states].reshape(-1, STATES)
        self._plan = FullSolution(inputs, states, True, iterations)
        return self._plan

    def _fall_back(self, iterations: int) -> FullSolution:
        """The old plan a step on; when it runs out, it hovers."""
        N, old = self._layout.steps, self._plan
        if old is None:
            inputs, states = np.tile(self._model.hover, (N, 1)), np.zeros((N + 1, STATES))
        else:
            inputs = np.vstack([old.inputs[1:], self._model.hover])
            states = np.vstack([old.states[1:], old.states[-1:]])
        self._plan = FullSolution(inputs, states, False, iterations)
        return self._plan


def within_reach(reference: HorizonReference, position_m: FloatArray, reach_m: float) -> HorizonReference:
    """The reference, drawn as a whole to within a distance of where the vehicle is: costs are quadratic and
    the bounds on the state soft, so that from far away it would pay to break them."""
    gap_m = position_m - reference.position_m[0]
    excess = 1.0 - reach_m / max(float(np.linalg.norm(gap_m)), reach_m)
    return (
        reference if excess <= 0.0 else replace(reference, position_m=reference.position_m + excess * gap_m)
    )


def _state_bounds(limits: FullLimits) -> tuple[FloatArray, FloatArray]:
    """Least and greatest of the bounded states, the margin off; the floor comes with each step."""
    tilt, side, up = np.radians(limits.tilt_deg), limits.horizontal_speed_m_s, limits.vertical_speed_m_s
    rate, yaw_rate = limits.rate_rad_s, limits.yaw_rate_rad_s
    high = (1.0 - limits.margin) * np.array([tilt, tilt, side, side, up, rate, rate, yaw_rate, FAR])
    low = -high
    high[-1] = FAR
    return low, high


# ---------------------------------------------------------------- full qp
# The MPC on 12 states as a sparse quadratic programme (eq. 39): its matrices, and which entries change.
#
# Everything counts from a nominal trajectory (`nominal.py`). Variables, in this order, for N steps: states
# x_1..x_N (12 each), inputs u_0..u_{N-1} (4 each), slacks (SOFT and one for each half-space). The slacks are
# free and costly, so that a vehicle that already breaks a bound on its state still has a solution.
#
# Rows, in this order: dynamics (12N, equalities), rotor thrusts (4N, hard), bounds on the state by step
# (roll, pitch, three velocities, three rates, height: SOFT each), half-spaces (obstacles by step).

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
