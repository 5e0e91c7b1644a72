"""U1..U4 to what each motor is commanded: eq. 5 backwards, within what the rotors can do.

When a rotor would go beyond its range the thrust of all is shifted, since tilt matters more than height
and yaw. The motors' lag is made up for in part: a command that is further off than the thrust wanted brings
it there sooner.
"""

from __future__ import annotations

import math

import numpy as np

from companion.base.geometry import FloatArray
from experiments.model.quadrotor import QuadrotorModel

Four = tuple[float, float, float, float]


class ThrustMixer:
    """One airframe's mixer; keeps what its motors are taken to give now.

    `flown`: U (4,) that they are taken to give on the mean over the period that the last command begins.
    """

    def __init__(self, model: QuadrotorModel, period_s: float, lead: float) -> None:
        """`lead`: 0 passes the thrust wanted on, 1 would have the motors there within a period."""
        self._shares_from_inputs = model.thrusts_from_inputs / model.full_rotor_thrust_n
        tau_s = model.config.motor_time_constant_s
        self._left = math.exp(-period_s / tau_s)
        self._mean_left = tau_s / period_s * (1.0 - self._left)
        self._inputs_from_shares = np.linalg.inv(self._shares_from_inputs)
        self.flown: FloatArray = model.hover.copy()
        self._gain = 1.0 + lead * (1.0 / (1.0 - self._left) - 1.0)
        self._flown: FloatArray = self._shares_from_inputs @ model.hover

    def step(self, inputs: FloatArray) -> Four:
        """Share of full thrust (0..1) to command of each motor for U (4,)."""
        wanted = _within_range(self._shares_from_inputs @ inputs)
        command = np.clip(self._flown + self._gain * (wanted - self._flown), 0.0, 1.0)
        behind = self._flown - command
        self.flown = self._inputs_from_shares @ (command + self._mean_left * behind)
        self._flown = command + self._left * behind
        a, b, c, d = command.tolist()
        return (a, b, c, d)


def _within_range(shares: FloatArray) -> FloatArray:
    low, high = float(shares.min()), float(shares.max())
    if high - low <= 1.0:
        shares = shares - max(high - 1.0, 0.0) - min(low, 0.0)
    clipped: FloatArray = np.clip(shares, 0.0, 1.0)
    return clipped
