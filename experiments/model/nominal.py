"""What the 12-state model has to do to fly a reference: the trajectory that it is linearised along.

A multirotor's position and heading are flat outputs: position, velocity and acceleration with the disturbance
of the air give tilt and thrust, their changes give rates and torques. Axes: the paper's z-up ones, SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.base.geometry import GRAVITY_M_S2, FloatArray
from experiments.model.quadrotor import (
    ANGLES,
    INPUTS,
    POSITION,
    RATES,
    STATES,
    VELOCITY,
    QuadrotorModel,
)

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
