"""State of the 12-state model and what disturbs it besides its inputs, by a Kalman filter.

For each axis and each angle y: y'' = f(X, U) + disturbance, disturbance a slow random walk (eq. 38 with w =
disturbance), y and y' measured with noise; the gain is the stationary one (eq. 17 in the limit). The inputs
are those flown, after the motors' lag, or every change of thrust would look like a disturbance. A mass or
inertia that is off appears here too, as the acceleration that it takes or adds now. Axes: the paper's z-up
ones.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy.linalg
from pydantic import Field

from companion.base.geometry import FloatArray
from companion.config import StrictModel
from experiments.model.nominal import disturbance_effect
from experiments.model.quadrotor import ANGLES, POSITION, RATES, VELOCITY, QuadrotorModel

PLACES: Final = [*POSITION, *ANGLES]
SPEEDS: Final = [*VELOCITY, *RATES]


class DisturbanceFilterConfig(StrictModel):
    """Noise of what is measured, and how fast a disturbance may walk (per root second)."""

    position_noise_m: float = Field(gt=0.0, le=2.0)
    velocity_noise_m_s: float = Field(gt=0.0, le=2.0)
    angle_noise_rad: float = Field(gt=0.0, le=0.5)
    rate_noise_rad_s: float = Field(gt=0.0, le=2.0)
    force_walk_m_s2: float = Field(gt=0.0, le=50.0)
    torque_walk_rad_s2: float = Field(gt=0.0, le=200.0)
    velocity_walk_m_s: float = Field(gt=0.0, le=5.0)
    rate_walk_rad_s: float = Field(gt=0.0, le=5.0)
    largest_force_m_s2: float = Field(gt=0.0, le=20.0)
    largest_torque_rad_s2: float = Field(gt=0.0, le=200.0)


class DisturbanceFilter:
    """Estimates the state (12,) and the disturbance (6,) from measured states and the inputs flown."""

    def __init__(self, config: DisturbanceFilterConfig, model: QuadrotorModel, period_s: float) -> None:
        self._model = model
        self._period_s = period_s
        force = stationary_gain(
            period_s,
            (config.position_noise_m, config.velocity_noise_m_s),
            (config.velocity_walk_m_s, config.force_walk_m_s2),
        )
        torque = stationary_gain(
            period_s,
            (config.angle_noise_rad, config.rate_noise_rad_s),
            (config.rate_walk_rad_s, config.torque_walk_rad_s2),
        )
        self._gain = np.array([force] * 3 + [torque] * 3)
        self._largest = np.array([config.largest_force_m_s2] * 3 + [config.largest_torque_rad_s2] * 3)
        self._state: FloatArray | None = None
        self.disturbance: FloatArray = np.zeros(6)

    def step(self, measured: FloatArray, flown: FloatArray) -> FloatArray:
        """The state (12,) now; `disturbance` (6,) is then m/s² along the axes, rad/s² of the angles.

        Args:
            measured: state now, with noise (12,).
            flown: U (4,), the mean from a period ago until now, after the motors' lag (`Mixer.flown`).
        """
        if self._state is None:
            self._state = measured.copy()
            return self._state
        state = self._model.advance(self._state, flown, self._period_s)
        state += disturbance_effect(self.disturbance, self._period_s)
        off = measured - state
        off[ANGLES] = np.arctan2(np.sin(off[ANGLES]), np.cos(off[ANGLES]))
        places, speeds, disturbances = np.einsum(
            "ijk,ki->ji", self._gain, np.array([off[PLACES], off[SPEEDS]])
        )
        state[PLACES] += places
        state[SPEEDS] += speeds
        self.disturbance = np.clip(self.disturbance + disturbances, -self._largest, self._largest)
        self._state = state
        return state


def stationary_gain(period_s: float, noise: tuple[float, float], walk: tuple[float, float]) -> FloatArray:
    """Kalman gains (3, 2) from the innovations of a place and its rate to place, rate and disturbance.

    `noise` is the two measurements' standard deviation; the walks, of rate and disturbance, are per root
    second.
    """
    F = np.array([[1.0, period_s, 0.5 * period_s**2], [0.0, 1.0, period_s], [0.0, 0.0, 1.0]])
    H = np.eye(2, 3)
    process = np.diag([0.0, walk[0] ** 2 * period_s, walk[1] ** 2 * period_s])
    R = np.diag(np.square(noise))
    prior = scipy.linalg.solve_discrete_are(F.T, H.T, process, R)
    gain: FloatArray = np.linalg.solve(H @ prior @ H.T + R, H @ prior).T
    return gain
