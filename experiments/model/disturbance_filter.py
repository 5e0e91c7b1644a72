"""State of the 12-state model and what disturbs it besides its inputs, by a Kalman filter.

For each axis and each angle y: y'' = f(X, U) + disturbance, disturbance a slow random walk (eq. 38 with w =
disturbance), y and y' measured with noise; the gain is the stationary one (eq. 17 in the limit). The inputs
are those flown, after the motors' lag, or every change of thrust would look like a disturbance. A mass or
inertia that is off appears here too, as the acceleration that it takes or adds now. Axes: the paper's z-up
ones.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
from pydantic import Field

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from companion.config import StrictModel
from experiments.model.quadrotor import ANGLES, INPUTS, POSITION, RATES, STATES, VELOCITY, QuadrotorModel

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


# ---------------------------------------------------------------- nominal
# What the 12-state model has to do to fly a reference: the trajectory that it is linearised along.
#
# A multirotor's position and heading are flat outputs: position, velocity and acceleration with the
# disturbance of the air give tilt and thrust, their changes give rates and torques. Axes: the paper's z-up
# ones, SI units.

NO_DISTURBANCE: FloatArray = np.zeros(6)


@dataclass(frozen=True)
class HorizonReference:
    """Rows 0..N of position (m), velocity (m/s) and acceleration (m/s²), each (N + 1, 3), and the heading."""

    position_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
    heading_rad: float = 0.0


@dataclass(frozen=True)
class Nominal:
    """States (N + 1, 12), inputs (N, 4), and what a step adds besides the inputs (N, 12): where the model
    would go from each state, less the next state (the remainder of the linearisation)."""

    states: FloatArray
    inputs: FloatArray
    remainder: FloatArray


def along(
    reference: HorizonReference,
    model: QuadrotorModel,
    step_s: float,
    disturbance: FloatArray = NO_DISTURBANCE,
) -> Nominal:
    """The flat trajectory of a reference.

    Args:
        reference: rows 0..N at multiples of the step.
        model: the airframe.
        step_s: the step (s).
        disturbance: lasting accelerations besides the inputs (6,): along the axes (m/s²), of the angles
            (rad/s²).
    """
    states = _states(reference, step_s, disturbance)
    inputs = _inputs(states, reference.acceleration_m_s2, model, step_s, disturbance)
    after = model.advance(states[:-1], inputs, step_s) + disturbance_effect(disturbance, step_s)
    return Nominal(states, inputs, after - states[1:])


def disturbance_effect(disturbance: FloatArray, step_s: float) -> FloatArray:
    """What accelerations (6,) add to the state (12,) over a step."""
    effect = np.zeros(STATES)
    effect[VELOCITY + RATES] = disturbance * step_s
    effect[POSITION + ANGLES] = disturbance * (0.5 * step_s * step_s)
    return effect


def _states(reference: HorizonReference, step_s: float, disturbance: FloatArray) -> FloatArray:
    force = reference.acceleration_m_s2 - disturbance[:3]
    cp, sp = np.cos(reference.heading_rad), np.sin(reference.heading_rad)
    forward, left = cp * force[:, 0] + sp * force[:, 1], cp * force[:, 1] - sp * force[:, 0]
    lift = force[:, 2] + GRAVITY_M_S2
    states = np.empty((len(force), STATES))
    states[:, POSITION], states[:, VELOCITY] = reference.position_m, reference.velocity_m_s
    states[:, ANGLES[0]] = np.arctan2(-left, np.hypot(forward, lift))
    states[:, ANGLES[1]] = np.arctan2(forward, lift)
    states[:, ANGLES[2]] = reference.heading_rad
    states[:, RATES] = np.gradient(states[:, ANGLES], step_s, axis=0)
    return states


def _inputs(
    states: FloatArray,
    acceleration: FloatArray,
    model: QuadrotorModel,
    step_s: float,
    disturbance: FloatArray,
) -> FloatArray:
    force = acceleration - disturbance[:3] + [0.0, 0.0, GRAVITY_M_S2]
    inputs = np.empty((len(states) - 1, INPUTS))
    inputs[:, 0] = model.mass_kg * np.linalg.norm(0.5 * (force[1:] + force[:-1]), axis=1)
    turning = np.diff(states[:, RATES], axis=0) / step_s - disturbance[3:]
    inputs[:, 1:] = turning * model.inertia_kg_m2
    return inputs
