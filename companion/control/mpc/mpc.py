"""Model predictive control (eqs. 38 and 39, with constraints): the next accelerations to command.

Frame: NED axes, at rest or in straight unaccelerated motion; the controller puts the pad's own motion into
the reference, so that nothing here depends on the pad. SI units. If the optimum without constraints breaks
none, it is the answer, by one solve with factors that are made once. Otherwise OSQP continues from it, or
from its own last solution: its matrices are set up once, and a step changes vectors only.

The number of iterations is bounded, and they run in slices. Between two slices an optional stopwatch may
end the solve. An answer that has not nearly converged is replaced. If time ran out, the last solution is
shifted and used. If the iterations ran out, which happens while a wind needs more than the bounds allow,
the optimum without constraints is used, limited to the inputs' bounds.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from companion.base.geometry import GRAVITY_M_S2, FloatArray, Vector3
from companion.base.late_import import imported_late
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.mpc.input_bounds import (
    INPUT_ROWS,
    OCTAGON,
    OCTAGON_WITHIN_CIRCLE,
    cut_sideways,
    input_bounds,
    input_rows,
    shrunk,
    side_left_m_s2,
)
from companion.control.mpc.qp import (
    ROWS,
    VARIABLES,
    QuadraticProgram,
    axis_costs,
    constraint_matrix,
    cost_matrix,
    places,
    step_matrices,
)
from companion.control.solver_health import UNFINISHED, outcome
from companion.control.tracking import Cone, SolveOutcome, Target, TrackingSolution, needed_inputs

with imported_late("jinja2"):  # with which it would write C code
    import osqp

# measured: 15 to 25 iterations from a warm start; rho moves only when a far start takes more than 50, and by
# OSQP's count of iterations, since its own choice of interval goes by time
SETTINGS: Final[dict[str, Any]] = {
    "eps_abs": 1e-4,
    "eps_rel": 1e-4,
    "check_termination": 5,
    "rho": 1.0,
    "adaptive_rho": 1,
    "adaptive_rho_interval": 50,
    "polishing": False,
    "warm_starting": True,
    "verbose": False,
}
SLICE_ITERATIONS = 100  # four times what a warm start takes, before the stopwatch is asked
FIRST_HOVER_THRUST = 0.5  # share of full thrust that carries the weight, until a target gives it
AT_BOUND = 0.98  # of it, sideways: OSQP stops short of a bound
# the gate bounds the whole vector's jerk, here it is each axis': stay within it, and clear of jitter
JERK_SHARE = 0.95 / 3.0**0.5


class FreeOptimum:
    """The minimum of 1/2 z'Pz + q'z with A z = b, for fixed P and A: eq. 39 under eq. 38, no inequalities.

    Solves P z + q + A'y = 0, A z = b by a factorisation that is made once.
    """

    def __init__(self, P_upper: sparse.csc_matrix, A: sparse.csc_matrix) -> None:
        """`P_upper` (n, n) is P's upper triangle; `A` (m, n)."""
        self.P = P_upper + sparse.triu(P_upper, k=1).T
        self._factors = splu(sparse.bmat([[self.P, A.T], [A, None]], format="csc"))
        self._n = self.P.shape[0]

    def solve(self, q: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """z (n,) and the multipliers y (m,)."""
        answer = self._factors.solve(np.concatenate([-q, b]))
        return answer[: self._n], answer[self._n :]


class Mpc:
    """The tracker. Keeps the last solution, for a warm start and for when a solve fails."""

    def __init__(
        self,
        config: ControlConfig,
        lags_s: Vector3,
        stopwatch: Callable[[], float] | None = None,
    ) -> None:
        """`lags_s` are `flight_model.lags`; `stopwatch` gives seconds, by which a solve may end."""
        self._limits = config.limits
        self._stopwatch = stopwatch or (lambda: 0.0)
        self._solve_limit_s = config.solve_limit_s
        self._slices = -(-config.maximum_iterations // SLICE_ITERATIONS)
        self._N = config.horizon_steps
        self._dt = config.step_s
        self._lags_s = lags_s
        self._period_s = 1.0 / config.rate_hz
        self._costs = axis_costs(config, lags_s)
        self._at, self._rows = places(VARIABLES, self._N), places(ROWS, self._N)
        self._variables = self._N * sum(VARIABLES.values())
        self._A, self._B = step_matrices(self._dt, lags_s)
        self._q_state = np.array([np.diag(c.Q)[i] for i in range(3) for c in self._costs])
        self._R = np.array([c.R for c in self._costs])
        self._S = np.array([c.S for c in self._costs])
        self._terminal = np.stack([c.terminal for c in self._costs])
        self._fixed_bounds(config)
        self._solver = self._set_up(min(SLICE_ITERATIONS, config.maximum_iterations))
        self.reset()

    def reset(self) -> None:
        """Forget the last solution."""
        self._last = np.zeros(self._variables)
        self._last_apex: FloatArray | None = None  # of the cone (N, 3), when it was solved
        self._short = "", math.inf
        self._cold = True

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> TrackingSolution:
        """Best inputs from `start`; the last solution shifted, then zeros, when there is none."""
        if not _finite(start):
            return self._answer(SolveOutcome.KEPT)
        self._bound_inputs(target.hover_thrust, max(0.0, disturbance_m_s2[2]))
        needed = needed_inputs(target, disturbance_m_s2, self._lags_s, self._dt)
        last_input = self.clip_input(np.array(last_input_m_s2))
        self._q = q = self._linear_cost(target, needed, last_input)
        self._update_bounds(start, target, np.array(disturbance_m_s2), last_input, needed[:, 2])
        if not self._consistent(q):
            return self._answer(SolveOutcome.KEPT)
        x, y = self._free_optimum.solve(q, self._l[self._rows["dynamics"]])
        if self._allowed(x):
            self._last, self._cold = x, True
            return self._answer(SolveOutcome.SOLVED)
        self._solver.update(q=q, l=self._l, u=self._u)
        if self._cold:
            self._solver.warm_start(x=x, y=np.concatenate([y, np.zeros(self._l.size - y.size)]))
            self._cold = False
        return self._take(*self._search())

    def _allowed(self, x: FloatArray) -> bool:
        """Whether the rows hold, to OSQP's own tolerance."""
        reached, slack = self._constraints @ x, SETTINGS["eps_abs"]
        return bool((reached >= self._l - slack).all() and (reached <= self._u + slack).all())

    def _consistent(self, q: FloatArray) -> bool:
        """Whether OSQP may see the data: it goes on with the old data on l > u, and never forgets a NaN."""
        return bool(np.isfinite(q).all() and (self._l <= self._u).all())

    def problem(self) -> QuadraticProgram:
        """The last step's quadratic programme, for who wants to solve it in another way."""
        P, A = cost_matrix(self._costs, self._N), self._constraints.copy()
        return QuadraticProgram(P, self._q.copy(), A, self._l.copy(), self._u.copy())

    def clip_input(self, input_m_s2: FloatArray) -> FloatArray:
        """The input (3,), or as much of it as meets the bounds."""
        return shrunk(input_m_s2, self._input_rows, self._input_lower, self._input_upper)

    # ------------------------------------------------------------ set-up

    def _fixed_bounds(self, config: ControlConfig) -> None:
        limits, rows = config.limits, self._rows
        count = rows["floor"].stop
        self._l, self._u = np.full(count, -np.inf), np.full(count, np.inf)
        speed, jerk_m_s3 = limits.horizontal_speed_m_s * OCTAGON_WITHIN_CIRCLE, JERK_SHARE * limits.jerk_m_s3
        for name, low, high in (
            ("change", -jerk_m_s3 * self._dt, jerk_m_s3 * self._dt),
            ("speed", -speed, speed),
            ("vertical_speed", -limits.climb_speed_m_s, limits.descent_speed_m_s),
        ):
            self._l[rows[name]], self._u[rows[name]] = low, high
        self._l[rows["dynamics"]] = self._u[rows["dynamics"]] = 0.0
        self._later_changes = jerk_m_s3 * self._dt * np.arange(self._N)
        self._first_change = jerk_m_s3 * self._period_s
        self._input_rows = input_rows(limits)
        self._tilt_tangent = math.tan(math.radians(limits.tilt_deg))
        self._bounded_for = math.nan, 0.0
        self._bound_inputs(FIRST_HOVER_THRUST, 0.0)

    def _set_up(self, iterations: int) -> osqp.OSQP:
        P = cost_matrix(self._costs, self._N)
        self._q = np.zeros(self._variables)
        self._constraints = constraint_matrix(self._A, self._B, self._N, inputs=self._input_rows)
        self._free_optimum = FreeOptimum(P, self._constraints[self._rows["dynamics"]])
        solver = osqp.OSQP()
        solver.setup(
            P,
            self._q,
            self._constraints,
            self._l,
            self._u,
            max_iter=iterations,
            **SETTINGS,
        )
        return solver

    # ------------------------------------------------------------ each step

    def _linear_cost(self, target: Target, needed: FloatArray, last_input: FloatArray) -> FloatArray:
        q = np.zeros(self._variables)
        rows = (target.position_m, target.velocity_m_s, target.acceleration_m_s2)
        reference = np.concatenate(rows, axis=1)
        states = q[self._at["states"]].reshape(self._N, 9)
        states[:-1] = -self._q_state * reference[1:-1]
        inputs = q[self._at["inputs"]].reshape(self._N, 3)
        # the change that the reference itself needs is free
        change = needed[1:] - needed[:-1]
        first = last_input + change[0] * (self._period_s / self._dt)
        inputs[:] = -self._R * needed
        inputs[1:] -= self._S * change
        inputs[:-1] += self._S * change
        inputs[0] -= self._S * first
        self._terminal_cost(states[-1], inputs[-1], reference[-1], needed[-1])
        return q

    def _terminal_cost(
        self, state: FloatArray, last: FloatArray, reference: FloatArray, needed: FloatArray
    ) -> None:
        goal = np.concatenate((reference.reshape(3, 3), needed[None])).T  # (axis, [p, v, a, u])
        pull = np.einsum("aij,aj->ai", self._terminal, goal)
        state[:] = -pull[:, :3].T.reshape(9)
        last -= pull[:, 3]

    def _update_bounds(
        self,
        start: Motion,
        target: Target,
        disturbance: FloatArray,
        last_input: FloatArray,
        needed_down: FloatArray,
    ) -> None:
        rows, lower, upper = self._rows, self._l, self._u
        drift = self._B @ disturbance
        dynamics = lower[rows["dynamics"]].reshape(self._N, 9)
        dynamics[:] = drift
        dynamics[0] += self._A @ np.array([*start.position_m, *start.velocity_m_s, *start.acceleration_m_s2])
        upper[rows["dynamics"]] = lower[rows["dynamics"]]
        change = rows["change"].start
        lower[change : change + 3] = last_input - self._first_change
        upper[change : change + 3] = last_input + self._first_change
        floor = np.inf if target.floor_down_m is None else target.floor_down_m[1:]
        if target.cone is None:
            self._last_apex = None
        else:
            floor = np.minimum(floor, self._cone_floor(target.cone, start.position_m))
        upper[rows["floor"]] = floor
        self._bound_sideways(target.horizontal_bound_m_s2, last_input, needed_down)

    def _bound_inputs(self, hover_thrust: float | None, pressed_m_s2: float) -> None:
        """Bounds of all inputs, by what hovering takes and what presses it down."""
        bounded_for = hover_thrust or self._bounded_for[0], pressed_m_s2
        if bounded_for == self._bounded_for:
            return
        self._bounded_for = hover_thrust, _ = bounded_for
        self._input_lower, self._input_upper = input_bounds(
            self._limits, self._input_rows, hover_thrust, pressed_m_s2
        )
        self._side_left_m_s2 = side_left_m_s2(self._limits, hover_thrust)
        rows = self._rows["input"]
        self._l[rows].reshape(self._N, INPUT_ROWS)[:] = self._input_lower
        self._u[rows].reshape(self._N, INPUT_ROWS)[:] = self._input_upper

    def _bound_sideways(
        self, horizontal_bound_m_s2: FloatArray | None, last_input: FloatArray, needed_down: FloatArray
    ) -> None:
        """Bound the horizontal input over each step, no faster than it may change.

        Height comes first: what its own input down leaves of the thrust, and of the tilt, is for the place.
        """
        full = self._input_upper[0]
        down = np.minimum(np.maximum(needed_down, 0.0), self._limits.vertical_acceleration_m_s2)
        by_tilt = self._tilt_tangent * (GRAVITY_M_S2 - down)
        most = np.minimum(full, np.minimum(self._side_left_m_s2, by_tilt) * OCTAGON_WITHIN_CIRCLE)
        self._short = "thrust" if self._side_left_m_s2 < by_tilt[0] else "tilt", float(most[0])
        if horizontal_bound_m_s2 is not None:
            most = np.minimum(most, horizontal_bound_m_s2 * OCTAGON_WITHIN_CIRCLE)
        reach = float(np.abs(OCTAGON @ last_input[:2]).max())
        still = reach - self._first_change - self._later_changes
        most = np.minimum(full, np.maximum(most, still))
        rows = self._rows["input"]
        self._u[rows].reshape(self._N, INPUT_ROWS)[:, :4] = most[:, None]
        self._l[rows].reshape(self._N, INPUT_ROWS)[:, :4] = -most[:, None]

    def _cone_floor(self, cone: Cone, position_m: Vector3) -> FloatArray:
        """How low (N,; m, down) it may be: within the cone as far aside as the last solution has it.

        Never higher than it is now, and outside the cone as low as it comes in: it comes back, or is carried
        out by what it cannot resist, without a climb. Rows on all three axes would let height buy place.
        """
        now, apex = np.subtract(position_m, cone.apex_m[0]), cone.apex_m[1:]
        aside = np.hypot(now[0], now[1])
        ahead = np.full(self._N, aside)
        if self._last_apex is not None:
            states = self._last[self._at["states"]].reshape(self._N, 9)
            ahead = np.hypot(*(states[:, :2] - self._last_apex[:, :2]).T)
        self._last_apex = apex
        radius = max(cone.radius_m, aside + cone.slope * now[2])
        floor: FloatArray = np.maximum(apex[:, 2] + (radius - ahead) / cone.slope, position_m[2])
        return floor

    def _search(self) -> tuple[Any, int, bool]:
        """OSQP's last result, how many iterations it took, and whether the stopwatch ended it."""
        began_s, iterations = self._stopwatch(), 0
        for _ in range(self._slices):
            result = self._solver.solve(raise_error=False)
            iterations += int(result.info.iter)
            if result.info.status_val not in UNFINISHED:
                return result, iterations, False
            if self._stopwatch() - began_s >= self._solve_limit_s:
                return result, iterations, True
        return result, iterations, False

    def _take(self, result: Any, iterations: int, late: bool) -> TrackingSolution:
        info, x = result.info, np.array(result.x)
        if not np.isfinite(x).all():
            self._cold = True
            return self._answer(SolveOutcome.KEPT, iterations)
        gradient = max(1.0, float(np.abs(self._free_optimum.P @ x).max()), float(np.abs(self._q).max()))
        found = outcome(info.status_val, primal=info.prim_res, dual_share=info.dual_res / gradient, late=late)
        if found is SolveOutcome.SOLVED:
            self._last = x
        # else it goes on from this iterate next time, but from what is no answer
        elif info.status_val not in UNFINISHED:
            self._cold = True
        return self._answer(found, iterations, late=late)

    def _answer(self, outcome: SolveOutcome, iterations: int = 0, *, late: bool = False) -> TrackingSolution:
        """The last solution, or what takes its place and becomes it."""
        inputs = self._last[self._at["inputs"]].reshape(self._N, 3)
        states = self._last[self._at["states"]].reshape(self._N, 9)
        if outcome is SolveOutcome.CUT:
            self._cut(inputs, states)
        elif outcome is SolveOutcome.KEPT:
            self._move_on(inputs, states)
        short_of, most = self._short
        at_bound = float(np.abs(OCTAGON @ inputs[0, :2]).max()) >= AT_BOUND * most
        short_of = short_of if at_bound else ""
        return TrackingSolution(inputs.copy(), states.copy(), outcome, iterations, late, short_of)

    def _cut(self, inputs: FloatArray, states: FloatArray) -> None:
        """The optimum without constraints, its inputs cut to their bounds, sideways first."""
        rows, N = self._rows, self._N
        dynamics = self._l[rows["dynamics"]]
        best = self._free_optimum.solve(self._q, dynamics)[0][self._at["inputs"]].reshape(N, 3)
        bounds = zip(
            *(edge[rows["input"]].reshape(N, INPUT_ROWS) for edge in (self._l, self._u)), strict=True
        )
        for k, (lower, upper) in enumerate(bounds):
            inputs[k] = cut_sideways(best[k], self._input_rows, lower, upper)
            moved = self._A @ states[k - 1] if k else 0.0
            states[k] = moved + self._B @ inputs[k] + dynamics[9 * k : 9 * k + 9]

    def _move_on(self, inputs: FloatArray, states: FloatArray) -> None:
        """The old plan, one period on; when it runs out, it commands no acceleration."""
        share = min(1.0, self._period_s / self._dt)
        following = np.vstack([inputs[1:], np.zeros((1, 3))])
        inputs += share * (following - inputs)
        states[:-1] += share * (states[1:] - states[:-1])


def _finite(motion: Motion) -> bool:
    numbers = (*motion.position_m, *motion.velocity_m_s, *motion.acceleration_m_s2)
    return all(map(math.isfinite, numbers))
