"""The paper's recursion (eqs. 39-42) as a tracker: the MPC's model, weights and reference, unconstrained.

Eq. 39 prices the input itself. Here, as in the MPC, the cost is on the command's deviation v from what the
reference needs, and on its change. So each axis carries its last v: the state is (p, v, a of three axes,
three last deviations), the recursion's input is the change of the deviations, and what the reference needs
against the disturbance enters as a known drift. If no constraint binds, the answer is the MPC's; otherwise
the limits gate bounds it.

Frame: as the MPC's, NED axes that do not accelerate; SI units.
"""

import numpy as np

from companion.base.geometry import FloatArray, Vector3
from companion.base.motion import Motion
from companion.config import ControlConfig
from companion.control.baselines.riccati import Weights, solve_tracking, tracking_gains
from companion.control.mpc.qp import axis_costs, step_matrices
from companion.control.tracking import SolveOutcome, Target, TrackingSolution, needed_inputs


class RiccatiTracker:
    """The recursion on the flight model. From one call to the next its gains alone are kept."""

    def __init__(self, config: ControlConfig, lags_s: Vector3) -> None:
        """`lags_s` are `flight_model.lags`."""
        self._lags_s, self._dt, self._N = lags_s, config.step_s, config.horizon_steps
        self._period_s = 1.0 / config.rate_hz
        self._B = step_matrices(self._dt, lags_s)[1]
        self._model = _with_memory(*step_matrices(self._dt, lags_s))
        self._weights = _weights(config, lags_s)
        self._gains = tracking_gains(*self._model, self._weights, self._N)

    def reset(self) -> None:
        """Begin a flight: there is nothing to forget."""

    def solve(
        self, start: Motion, target: Target, disturbance_m_s2: Vector3, last_input_m_s2: Vector3
    ) -> TrackingSolution:
        """Best inputs from `start` were there no constraints; without finite numbers: none, not solved."""
        needed = needed_inputs(target, disturbance_m_s2, self._lags_s, self._dt)
        # over the first, shorter step the change that the reference itself needs is free
        free = (needed[1] - needed[0]) * (self._period_s / self._dt)
        deviation = np.array(last_input_m_s2) + free - needed[0]
        state = np.array([*start.position_m, *start.velocity_m_s, *start.acceleration_m_s2, *deviation])
        rows = [target.position_m, target.velocity_m_s, target.acceleration_m_s2]
        reference = np.hstack([*rows, np.zeros((self._N + 1, 3))])
        drift = np.zeros((self._N, 12))
        drift[:, :9] = (needed + np.array(disturbance_m_s2)) @ self._B.T
        if not (np.isfinite(state).all() and np.isfinite(reference).all() and np.isfinite(drift).all()):
            return TrackingSolution(np.zeros((self._N, 3)), np.zeros((self._N, 9)), SolveOutcome.KEPT)
        answer = solve_tracking(state, *self._model, reference, self._weights, drift=drift, gains=self._gains)
        states = answer.states[1:]
        return TrackingSolution(needed + states[:, 9:], states[:, :9])


def _with_memory(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A (12, 12) and B (12, 3) with the last deviations as states and their change as the input."""
    memory = np.block([[A, B], [np.zeros((3, 9)), np.eye(3)]])
    return memory, np.vstack([B, np.eye(3)])


def _weights(config: ControlConfig, lags_s: Vector3) -> Weights:
    """The MPC's: a deviation that has been flown is in the state, so its cost moves into Q."""
    costs = axis_costs(config, lags_s)
    Q, S = np.zeros((12, 12)), np.zeros((12, 12))
    for axis, cost in enumerate(costs):
        own = slice(axis, None, 3)  # position, velocity, acceleration and deviation of this axis
        Q[own, own] = np.diag([*np.diag(cost.Q), cost.R])
        S[own, own] = cost.terminal + np.diag([0.0, 0.0, 0.0, cost.R])
    return Weights(np.eye(12), Q, np.diag([cost.S for cost in costs]), S)
