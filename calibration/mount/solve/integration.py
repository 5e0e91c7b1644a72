"""IMU preintegration over short segments: the motion between sightings by gyroscope and accelerometer.

A segment starts with an unknown pose and velocity. From there, integrating rates and specific forces gives
rotation, velocity and position ("preintegration": Lupton and Sukkarieh, IEEE T-RO 28, 2012). Over two seconds
this is more precise than a sighting, so the sightings of a segment must fit one such path.

All segments share one uniform time grid; the first axis of each array is the segment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import ImuSamples, Indices
from calibration.mount.solve.rotations import exp
from companion.base.geometry import FloatArray

SEGMENT_S: Final = 2.0
MARGIN_S: Final = 0.35  # the largest error of the stamps


@dataclass(frozen=True, slots=True)
class ImuSegments:
    """IMU samples (s, n, 3) at the middle of each grid step; segment k starts at start_s[k]."""

    start_s: FloatArray
    step_s: float
    rate: FloatArray
    force: FloatArray


@dataclass(frozen=True, slots=True)
class IntegratedAttitude:
    """Rotation since the segment's start: at grid points (s, n + 1, 3, 3), at their middles (s, n, 3, 3)."""

    at: FloatArray
    middle: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True)
class MotionSamples:
    """The motion at some times (k,): rotation, position and velocity in the segment's first axes, rate."""

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


def split_into_segments(inertial: ImuSamples, first_s: float, last_s: float) -> ImuSegments:
    """Split a recording into segments of SEGMENT_S from `first_s` on, without those that have a gap.

    The grid of each segment extends by MARGIN_S on both sides.
    """
    step_s = inertial.period_s
    begins = np.arange(first_s, last_s, SEGMENT_S)
    gaps = inertial.gaps()
    from_s, to_s = begins - MARGIN_S, begins + SEGMENT_S + MARGIN_S
    # outside the recording the last sample is held: there are no sightings there either
    whole = ~((gaps[:, 0] < to_s[:, None]) & (gaps[:, 1] > from_s[:, None])).any(axis=1)
    start_s = from_s[whole]
    middles = start_s[:, None] + step_s * (
        np.arange(int(np.ceil((SEGMENT_S + 2.0 * MARGIN_S) / step_s))) + 0.5
    )
    at = [np.interp(middles, inertial.time_s, column) for column in (*inertial.rate.T, *inertial.force.T)]
    return ImuSegments(start_s, step_s, np.stack(at[:3], axis=-1), np.stack(at[3:], axis=-1))


def integrate_rates(segments: ImuSegments, rate: FloatArray) -> IntegratedAttitude:
    """Integrate rates (s, n, 3), each constant within its step."""
    half = exp(rate * (0.5 * segments.step_s))
    steps = half @ half
    at = np.empty((rate.shape[0], rate.shape[1] + 1, 3, 3))
    at[:, 0] = np.eye(3)
    for k in range(rate.shape[1]):
        at[:, k + 1] = at[:, k] @ steps[:, k]
    return IntegratedAttitude(at, at[:, :-1] @ half, rate)


def integrate_forces(
    segments: ImuSegments, attitude: IntegratedAttitude, force: FloatArray
) -> IntegratedMotion:
    """Integrate specific forces (s, n, 3) twice in the segment's first body axes."""
    h = segments.step_s
    acceleration = (attitude.middle @ force[..., None])[..., 0]
    start = np.zeros((force.shape[0], 1, 3))
    velocity = np.concatenate((start, np.cumsum(acceleration * h, axis=1)), axis=1)
    steps = velocity[:, :-1] * h + (0.5 * h * h) * acceleration
    return IntegratedMotion(acceleration, velocity, np.concatenate((start, np.cumsum(steps, axis=1)), axis=1))


def at_times(
    segments: ImuSegments,
    attitude: IntegratedAttitude,
    motion: IntegratedMotion,
    which: Indices,
    since_s: FloatArray,
) -> MotionSamples:
    """The motion of segments `which` (k,), `since_s` (k,) after their beginning."""
    index = np.clip((since_s / segments.step_s).astype(int), 0, attitude.rate.shape[1] - 1)
    rest = (since_s - index * segments.step_s)[:, None]
    rate, acceleration = attitude.rate[which, index], motion.acceleration[which, index]
    velocity = motion.velocity[which, index]
    return MotionSamples(
        rotation=attitude.at[which, index] @ exp(rate * rest),
        position=motion.position[which, index] + velocity * rest + 0.5 * acceleration * rest**2,
        velocity=velocity + acceleration * rest,
        rate=rate,
    )
