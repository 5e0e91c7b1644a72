"""Model predictive control (eqs. 38 and 39, with constraints): the next accelerations to command.

Frame: NED axes, at rest or in straight unaccelerated motion; the controller puts the pad's own motion into
the reference, so that nothing here knows of pads. SI units. Solved by OSQP: the matrices are set up once, a
step changes vectors only and starts from the last solution. Deterministic: iterations bound the work, never
time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp

from companion.config import ControlConfig
from companion.control.flight_model import Motion
from companion.control.qp import (
    OCTAGON_WITHIN_CIRCLE,
    Layout,
    axis_costs,
    constraint_matrix,
    cost_matrix,
    step_matrices,
)
from companion.geometry import GRAVITY_M_S2, FloatArray, Vector3

FAR = 1e6  # a bound that does not bind; infinity would change the row's kind and cost a factorisation
ACCEPTED_RESIDUAL = 1e-2
# measured: 20 to 30 iterations from a warm start; rho moves only when a far start takes more than 50, and by
# OSQP's count of iterations, since its own choice of interval goes by time
RHO = 3.0
RHO_BY_ITERATIONS = 1
RHO_INTERVAL = 50
# OSQP's status values: solved; inaccurate and out of iterations
SOLVED = 1
NEARLY_SOLVED = (2, 7)
# the gate bounds the whole vector's jerk, here it is each axis': stay within it, and clear of jitter
JERK_SHARE = 0.95 / 3.0**0.5


@dataclass(frozen=True)
class Target:
    """What to track: rows 0..N hold at 0, dt, .. N dt from the start.

    `floor_down_m` (N+1,) is the greatest allowed position along down, or None. The first row is near
    the vehicle (see `target.within_reach`): the costs are quadratic, the bounds on speed and height soft.
    """

    position_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
    floor_down_m: FloatArray | None = None


@dataclass(frozen=True)
class Solution:
    """Inputs (N, 3) in m/s2 and the predicted states (N, 9); `solved` is false for a shifted old solution."""

    inputs_m_s2: FloatArray
    states: FloatArray
    solved: bool
    iterations: int


def needed_inputs(target: Target, disturbance_m_s2: Vector3, lags_s: Vector3, step_s: float) -> FloatArray:
    """Inputs (N, 3) under which the model flies the target's acceleration against the disturbance."""
    a = target.acceleration_m_s2
    slope = np.diff(a, axis=0) / step_s
    needed: FloatArray = 0.5 * (a[:-1] + a[1:]) + np.array(lags_s) * slope - np.array(disturbance_m_s2)
    return needed


class Mpc:
    """The tracker. Keeps the last solution, for a warm start and for when a solve fails."""

    def __init__(self, config: ControlConfig, lags_s: Vector3) -> None:
        self._N = config.horizon_steps
        self._dt = config.step_s
        self._lags_s = lags_s
        self._period_s = 1.0 / config.rate_hz
        self._costs = axis_costs(config, lags_s)
        self._layout = Layout(self._N)
        self._rows = self._layout.rows()
        self._A, self._B = step_matrices(self._dt, lags_s)
        self._stack_weights()
        self._fixed_bounds(config)
        self._solver = self._set_up(config)
        self._last = np.zeros(self._layout.variables)
        self._poisoned = False

    def reset(self) -> None:
        """Forget the last solution."""
        self._last = np.zeros(self._layout.variables)
        self._poisoned = True

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> Solution:
        """Best inputs from `start`; the last solution shifted, then zeros, when there is none."""
        if not _finite(start):
            return self._fall_back()
        needed = needed_inputs(target, disturbance_m_s2, self._lags_s, self._dt)
        last_input = self.clip_input(np.array(last_input_m_s2))
        q = self._linear_cost(target, needed, last_input)
        self._update_bounds(start, target, np.array(disturbance_m_s2), last_input)
        if not self._consistent(q):
            return self._fall_back()
        self._solver.update(q=q, l=self._l, u=self._u)
        if self._poisoned:
            self._solver.warm_start(x=np.zeros(self._layout.variables), y=np.zeros(self._l.size))
            self._poisoned = False
        return self._take(self._solver.solve(raise_error=False))

    def _consistent(self, q: FloatArray) -> bool:
        """Whether OSQP may see the data: it goes on with the old data on l > u, and never forgets a NaN."""
        finite = np.isfinite(q).all() and np.isfinite(self._l).all() and np.isfinite(self._u).all()
        return bool(finite and (self._l <= self._u).all())

    def clip_input(self, input_m_s2: FloatArray) -> FloatArray:
        """The nearest input (3,) along the same horizontal direction that meets the bounds."""
        clipped = input_m_s2.copy()
        horizontal = float(np.hypot(clipped[0], clipped[1]))
        if horizontal > self._horizontal_input:
            clipped[:2] *= self._horizontal_input / horizontal
        clipped[2] = min(max(clipped[2], -self._vertical_input), self._vertical_input)
        return clipped

    # ------------------------------------------------------------ set-up

    def _stack_weights(self) -> None:
        self._q_state = np.array([[np.diag(c.Q)[i] for i in range(3) for c in self._costs]])[0]
        self._R = np.array([c.R for c in self._costs])
        self._S = np.array([c.S for c in self._costs])
        self._terminal = np.stack([c.terminal for c in self._costs])

    def _fixed_bounds(self, config: ControlConfig) -> None:
        limits, rows = config.limits, self._rows
        lean = GRAVITY_M_S2 * float(np.tan(np.radians(limits.tilt_deg)))
        side = min(lean, limits.horizontal_acceleration_m_s2) * OCTAGON_WITHIN_CIRCLE
        self._horizontal_input, self._vertical_input = side, limits.vertical_acceleration_m_s2
        count = rows["floor"].stop
        self._l, self._u = np.full(count, -FAR), np.full(count, FAR)
        speed = limits.horizontal_speed_m_s * OCTAGON_WITHIN_CIRCLE
        for name, low, high in (
            ("tilt", -side, side),
            ("vertical_input", -self._vertical_input, self._vertical_input),
            ("change", -JERK_SHARE * limits.jerk_m_s3 * self._dt, JERK_SHARE * limits.jerk_m_s3 * self._dt),
            ("speed", -speed, speed),
            ("vertical_speed", -limits.climb_speed_m_s, limits.descent_speed_m_s),
        ):
            self._l[rows[name]], self._u[rows[name]] = low, high
        self._l[rows["dynamics"]] = self._u[rows["dynamics"]] = 0.0
        self._first_change = JERK_SHARE * limits.jerk_m_s3 * self._period_s

    def _set_up(self, config: ControlConfig) -> osqp.OSQP:
        solver = osqp.OSQP()
        solver.setup(
            cost_matrix(self._costs, self._N),
            np.zeros(self._layout.variables),
            constraint_matrix(self._A, self._B, self._N),
            self._l,
            self._u,
            eps_abs=1e-4,
            eps_rel=1e-4,
            max_iter=config.maximum_iterations,
            check_termination=10,
            rho=RHO,
            adaptive_rho=RHO_BY_ITERATIONS,
            adaptive_rho_interval=RHO_INTERVAL,
            polishing=False,
            warm_starting=True,
            verbose=False,
        )
        return solver

    # ------------------------------------------------------------ each step

    def _linear_cost(self, target: Target, needed: FloatArray, last_input: FloatArray) -> FloatArray:
        q = np.zeros(self._layout.variables)
        reference = np.hstack([target.position_m, target.velocity_m_s, target.acceleration_m_s2])
        states = q[self._layout.states].reshape(self._N, 9)
        states[:-1] = -self._q_state * reference[1:-1]
        inputs = q[self._layout.inputs].reshape(self._N, 3)
        # the change that the reference itself needs is free
        change = np.diff(needed, axis=0, prepend=needed[:1])
        first = last_input + (needed[1] - needed[0]) * (self._period_s / self._dt)
        inputs[:] = -self._R * needed - self._S * change
        inputs[:-1] += self._S * change[1:]
        inputs[0] -= self._S * first
        self._terminal_cost(states[-1], inputs[-1], reference[-1], needed[-1])
        return q

    def _terminal_cost(
        self, state: FloatArray, last: FloatArray, reference: FloatArray, needed: FloatArray
    ) -> None:
        goal = np.vstack([reference.reshape(3, 3), needed]).T  # (axis, [p, v, a, u])
        pull = np.einsum("aij,aj->ai", self._terminal, goal)
        state[:] = -pull[:, :3].T.reshape(9)
        last -= pull[:, 3]

    def _update_bounds(
        self, start: Motion, target: Target, disturbance: FloatArray, last_input: FloatArray
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
        upper[rows["floor"]] = FAR if target.floor_down_m is None else target.floor_down_m[1:]

    def _take(self, result: Any) -> Solution:
        info, x = result.info, np.array(result.x)
        iterations = int(info.iter)
        if not np.isfinite(x).all() or info.status_val not in (SOLVED, *NEARLY_SOLVED):
            self._poisoned = True
            return self._fall_back(iterations)
        if info.status_val != SOLVED and max(info.prim_res, info.dual_res) > ACCEPTED_RESIDUAL:
            return self._fall_back(iterations)  # and go on from this iterate next time
        self._last = x
        return self._solution(solved=True, iterations=iterations)

    def _fall_back(self, iterations: int = 0) -> Solution:
        """The old plan, one period on; when it runs out, it commands no acceleration."""
        inputs = self._last[self._layout.inputs].reshape(self._N, 3)
        states = self._last[self._layout.states].reshape(self._N, 9)
        share = min(1.0, self._period_s / self._dt)
        following = np.vstack([inputs[1:], np.zeros((1, 3))])
        inputs += share * (following - inputs)
        states[:-1] += share * (states[1:] - states[:-1])
        return self._solution(solved=False, iterations=iterations)

    def _solution(self, *, solved: bool, iterations: int) -> Solution:
        inputs = self._last[self._layout.inputs].reshape(self._N, 3).copy()
        states = self._last[self._layout.states].reshape(self._N, 9).copy()
        return Solution(inputs, states, solved, iterations)


def _finite(motion: Motion) -> bool:
    numbers = (*motion.position_m, *motion.velocity_m_s, *motion.acceleration_m_s2)
    return all(map(math.isfinite, numbers))
