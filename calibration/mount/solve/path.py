"""Dead reckoning in short stretches: what gyroscope and accelerometer say of the motion between sightings.

A stretch begins with an unknown pose and velocity; from there rotation, velocity and position follow by
integrating rates and specific forces ("preintegration": Lupton and Sukkarieh, IEEE T-RO 28, 2012). Over a
couple of seconds that is better than a sighting, so the sightings of a stretch must fit one such path.

All stretches run at once on one uniform grid of time; each array's first axis is the stretch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import ImuSamples, Indices
from calibration.mount.solve.rotations import exp
from companion.base.geometry import FloatArray

STRETCH_S: Final = 2.0
MARGIN_S: Final = 0.35  # what the stamps may be off


@dataclass(frozen=True, slots=True)
class ImuSegments:
    """Inertial samples (s, n, 3) at the middles of the grid's steps; k's begins at start_s[k]."""

    start_s: FloatArray
    step_s: float
    rate: FloatArray
    force: FloatArray


@dataclass(frozen=True, slots=True)
class IntegratedAttitude:
    """Rotation from the stretch's beginning: at each grid point (s, n + 1, 3, 3), at middles (s, n, 3, 3)."""

    at: FloatArray
    middle: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True)
class MotionSamples:
    """The motion at some times (k,): rotation, position and velocity in the stretch's first axes, rate."""

    rotation: FloatArray
    position: FloatArray
    velocity: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True)
class IntegratedMotion:
    """Acceleration (s, n, 3) in each step, velocity and position (s, n + 1, 3), by the force alone."""

    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray


def cut(inertial: ImuSamples, first_s: float, last_s: float) -> ImuSegments:
    """Cut a recording into stretches of STRETCH_S that begin at `first_s`; those with a gap are left out.

    Each one's grid reaches MARGIN_S further on both sides.
    """
    step_s = inertial.period_s
    begins = np.arange(first_s, last_s, STRETCH_S)
    gaps = inertial.gaps()
    from_s, to_s = begins - MARGIN_S, begins + STRETCH_S + MARGIN_S
    # what the recording does not reach is held at its last sample: nothing was seen there either
    whole = ~((gaps[:, 0] < to_s[:, None]) & (gaps[:, 1] > from_s[:, None])).any(axis=1)
    start_s = from_s[whole]
    middles = start_s[:, None] + step_s * (
        np.arange(int(np.ceil((STRETCH_S + 2.0 * MARGIN_S) / step_s))) + 0.5
    )
    at = [np.interp(middles, inertial.time_s, column) for column in (*inertial.rate.T, *inertial.force.T)]
    return ImuSegments(start_s, step_s, np.stack(at[:3], axis=-1), np.stack(at[3:], axis=-1))


def turn(stretches: ImuSegments, rate: FloatArray) -> IntegratedAttitude:
    """Integrate rates (s, n, 3), right but for their change within a step."""
    half = exp(rate * (0.5 * stretches.step_s))
    steps = half @ half
    at = np.empty((rate.shape[0], rate.shape[1] + 1, 3, 3))
    at[:, 0] = np.eye(3)
    for k in range(rate.shape[1]):
        at[:, k + 1] = at[:, k] @ steps[:, k]
    return IntegratedAttitude(at, at[:, :-1] @ half, rate)


def move(stretches: ImuSegments, turning: IntegratedAttitude, force: FloatArray) -> IntegratedMotion:
    """Integrate specific forces (s, n, 3) twice in the stretch's first body axes."""
    h = stretches.step_s
    acceleration = (turning.middle @ force[..., None])[..., 0]
    start = np.zeros((force.shape[0], 1, 3))
    velocity = np.concatenate((start, np.cumsum(acceleration * h, axis=1)), axis=1)
    steps = velocity[:, :-1] * h + (0.5 * h * h) * acceleration
    return IntegratedMotion(acceleration, velocity, np.concatenate((start, np.cumsum(steps, axis=1)), axis=1))


def at_times(
    stretches: ImuSegments,
    turning: IntegratedAttitude,
    moving: IntegratedMotion,
    which: Indices,
    since_s: FloatArray,
) -> MotionSamples:
    """The motion of stretches `which` (k,), `since_s` (k,) after their beginning."""
    index = np.clip((since_s / stretches.step_s).astype(int), 0, turning.rate.shape[1] - 1)
    rest = (since_s - index * stretches.step_s)[:, None]
    rate, acceleration = turning.rate[which, index], moving.acceleration[which, index]
    velocity = moving.velocity[which, index]
    return MotionSamples(
        rotation=turning.at[which, index] @ exp(rate * rest),
        position=moving.position[which, index] + velocity * rest + 0.5 * acceleration * rest**2,
        velocity=velocity + acceleration * rest,
        rate=rate,
    )
