"""Held still: when a vehicle in somebody's hands counts as at rest, and what its sensors say then.

The camera distinguishes rest from motion: a slow move is hidden from an accelerometer by the hand's tremor, a
pad in the image shows it at once. Body axes FRD, SI, field µT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.base.geometry import (
    FloatArray,
    Quaternion,
    Vector3,
    norm,
    quat_conjugate,
    quat_multiply,
    quat_normalise,
    rotation_vector_from_quat,
    vector3,
)
from companion.base.messages import PadSighting
from companion.tools.pad_check.samples import RecentSamples, within

REST_S: Final = 1.2
LEAST_SIGHTINGS: Final = 6
LEAST_IMU_SAMPLES: Final = 20
OLDEST_SIGHTING_S: Final = 0.4
# a hand's sway is within these, a move of a second or two is not (standard deviations over REST_S)
STILL_M: Final = 0.015
STILL_RAD: Final = math.radians(1.5)
STRAY_RAD: Final = math.radians(8.0)  # a pose that is turned further from the others is a wrong one
MOST_STRAYS: Final = 0.25


@dataclass(frozen=True, slots=True)
class StandstillMeans:
    """Means over a time at rest.

    The pad's pose is by the camera (`body_from_pad` turns pad axes into body axes). `range_m` is the median
    echo, `field_ut` the magnetic field; None where there was none.
    """

    start_s: float
    end_s: float
    pad_position_body_m: Vector3
    body_from_pad: Quaternion
    force_m_s2: Vector3
    rate_rad_s: Vector3
    range_m: float | None
    field_ut: Vector3 | None


def find_rest(samples: RecentSamples, now_s: float) -> StandstillMeans | None:
    """The vehicle at rest over the last REST_S, if it was, in sight of the pad and with its IMU alive."""
    sightings = within(samples.sightings, now_s - REST_S - OLDEST_SIGHTING_S, now_s)
    if not sightings or now_s - sightings[-1].time_s > OLDEST_SIGHTING_S:
        return None
    end_s = sightings[-1].time_s
    pose = still_pose([s for s in sightings if s.time_s >= end_s - REST_S])
    imu = within(samples.imu, end_s - REST_S, end_s)
    if pose is None or len(imu) < LEAST_IMU_SAMPLES:
        return None
    ranges = [s.distance_m for s in within(samples.range, end_s - REST_S, end_s)]
    fields = [s.field_body_ut for s in within(samples.mag, end_s - REST_S, end_s)]
    return StandstillMeans(
        start_s=end_s - REST_S,
        end_s=end_s,
        pad_position_body_m=pose[0],
        body_from_pad=pose[1],
        force_m_s2=vector3(np.mean([s.specific_force_body_m_s2 for s in imu], axis=0)),
        rate_rad_s=vector3(np.mean([s.rate_body_rad_s for s in imu], axis=0)),
        range_m=float(np.median(ranges)) if ranges else None,
        field_ut=vector3(np.mean(fields, axis=0)) if fields else None,
    )


def still_pose(sightings: list[PadSighting]) -> tuple[Vector3, Quaternion] | None:
    """Mean position and rotation of sightings that agree; None when too few do, or they move.

    The mean is taken about the pose that is nearest to all others, so that single flipped poses fall out.
    """
    if len(sightings) < LEAST_SIGHTINGS:
        return None
    middle = _medoid(sightings)
    turns = [
        rotation_vector_from_quat(quat_multiply(quat_conjugate(middle), s.body_from_pad)) for s in sightings
    ]
    kept = [k for k, turn in enumerate(turns) if norm(turn) < STRAY_RAD]
    if len(kept) < max(LEAST_SIGHTINGS, (1.0 - MOST_STRAYS) * len(sightings)):
        return None
    positions = np.array([sightings[k].pad_position_body_m for k in kept])
    rotations = np.array([turns[k] for k in kept])
    if _spread(positions) > STILL_M or _spread(rotations) > STILL_RAD:
        return None
    half = 0.5 * rotations.mean(axis=0)
    mean = quat_multiply(middle, quat_normalise((1.0, float(half[0]), float(half[1]), float(half[2]))))
    return vector3(positions.mean(axis=0)), mean


def _medoid(sightings: list[PadSighting]) -> Quaternion:
    """The rotation with the smallest sum of distances to the others."""
    rotations = np.array([s.body_from_pad for s in sightings])
    angles = np.arccos(np.abs(rotations @ rotations.T).clip(0.0, 1.0))
    return sightings[int(np.argmin(angles.sum(axis=1)))].body_from_pad


def _spread(values: FloatArray) -> float:
    """The largest standard deviation of a component; values (n, 3)."""
    return float(values.std(axis=0).max())
