"""The paper's recursion (eqs. 39-42) as a tracker: the MPC's model, weights and reference, no constraints.

The free motion x~ starts where the vehicle is and flies the inputs that the reference needs against the
disturbance. Around it the deviations e = x - x~ and v = u - needed follow e' = A e + B v from e_0 = 0, which
is the paper's problem with Z = reference - x~ and the needed inputs as the trim that is added back. The
input's change has a price too, so each axis carries its last v: the state is (e, v_last), the recursion's
input the change of v. Where no constraint binds, the answer is the MPC's; what a constraint would have
bounded is left to the gate of limits.

Frame: as the MPC's, NED axes that do not accelerate; SI units.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from companion.config import ControlConfig
from companion.control.flight_model import Motion
from companion.control.mpc import Solution, Target, needed_inputs
from companion.control.qp import axis_costs, step_matrices
from companion.geometry import FloatArray, Vector3


class RiccatiTracker:
    """The recursion with its gains set up once: model and weights never change, only the reference does."""

    def __init__(self, config: ControlConfig, lags_s: Vector3) -> None:
        """`lags_s` are `flight_model.lags`."""
