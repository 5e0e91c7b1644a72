"""What pushes the 12-state model besides its inputs: six accelerations, for tracking without lasting offset.

An observer for each of three velocities and three rates y: y' = f(X, U) + push + noise, push a slow random
walk (eq. 38 with w = push), with a stationary Kalman gain (eq. 17 at its limit). The inputs are those flown,
after the motors' lag, or every change of thrust would look like a push. A mass or inertia that is off appears
here too, as the acceleration that it takes or adds now. Axes: the paper's z-up ones.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy.linalg
from pydantic import Field

from companion.config import StrictModel
from companion.control.quadrotor import RATES, STATES, VELOCITY, QuadrotorModel
from companion.geometry import FloatArray

OBSERVED: Final = [*VELOCITY, *RATES]


class PushConfig(StrictModel):
    """Noise of what is measured, and how fast a push may walk (per root second)."""

    velocity_noise_m_s: float = Field(gt=0.0, le=2.0)
    rate_noise_rad_s: float = Field(gt=0.0, le=2.0)
    force_walk_m_s2: float = Field(gt=0.0, le=50.0)
    torque_walk_rad_s2: float = Field(gt=0.0, le=200.0)
    velocity_walk_m_s: float = Field(gt=0.0, le=5.0)
    rate_walk_rad_s: float = Field(gt=0.0, le=5.0)
    largest_force_m_s2: float = Field(gt=0.0, le=20.0)
    largest_torque_rad_s2: float = Field(gt=0.0, le=200.0)


class PushObserver:
    """Estimates the push (6,) from the measured states and the inputs that were flown."""

    def __init__(self, config: PushConfig, model: QuadrotorModel, period_s: float) -> None:
        self._model = model
        self._period_s = period_s
        force = stationary_gain(
            period_s, config.velocity_noise_m_s, config.velocity_walk_m_s, config.force_walk_m_s2
        )
        torque = stationary_gain(
            period_s, config.rate_noise_rad_s, config.rate_walk_rad_s, config.torque_walk_rad_s2
        )
        self._gain = np.array([force] * 3 + [torque] * 3)
        self._largest = np.array([config.largest_force_m_s2] * 3 + [config.largest_torque_rad_s2] * 3)
        self._expected: FloatArray | None = None
        self._before: FloatArray = np.zeros(STATES)
        self.push: FloatArray = np.zeros(6)

    def step(self, state: FloatArray, flown: FloatArray) -> FloatArray:
        """The push (6,) now: m/s² along the axes, then rad/s² of the angles.

        Args:
            state: measured now (12,).
            flown: U (4,), the mean from a period ago until now, after the motors' lag (`Mixer.flown`).
        """
        measured = state[OBSERVED]
        if self._expected is None:
            self._expected = measured.copy()
        else:
            slope = self._model.derivative(self._before, flown)[OBSERVED] + self.push
            expected = self._expected + self._period_s * slope
            innovation = measured - expected
            self._expected = expected + self._gain[:, 0] * innovation
            self.push = np.clip(self.push + self._gain[:, 1] * innovation, -self._largest, self._largest)
        self._before = state
        return self.push


def stationary_gain(period_s: float, noise: float, walk: float, push_walk: float) -> tuple[float, float]:
    """Kalman gains from an innovation of a rate to the rate and to its push.

    `noise` is the measurement's standard deviation; the walks are per root second.
    """
    F = np.array([[1.0, period_s], [0.0, 1.0]])
    H = np.array([[1.0, 0.0]])
    process = np.diag([walk**2 * period_s, push_walk**2 * period_s])
    prior = scipy.linalg.solve_discrete_are(F.T, H.T, process, np.array([[noise**2]]))
    gain = prior @ H.T / float(prior[0, 0] + noise**2)
    return float(gain[0, 0]), float(gain[1, 0])
