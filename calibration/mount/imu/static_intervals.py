"""Finds the static intervals of a recording: where the IMU lay still.

Pure; axes as given. A static interval lasts at least REST_S. In it, both sensors scatter by no more than
noise and the vibration of a table, and the specific force is constant. Both ends are cut off, because hands
let go and take hold there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import ImuSamples, Indices
from companion.base.geometry import FloatArray

BLOCK_S: Final = 0.25
REST_S: Final = 1.5
STILL_RATE_RAD_S: Final = 0.02
STILL_FORCE_M_S2: Final = 0.15
SAME_FORCE_M_S2: Final = 0.1


@dataclass(frozen=True, slots=True)
class StaticInterval:
    """Means over one static interval: specific force (3,) m/s², rate (3,) rad/s; `samples` is their count."""

    force: FloatArray
    rate: FloatArray
    temperature_c: float
    samples: int
    from_s: float
    to_s: float


def find_static_intervals(inertial: ImuSamples) -> list[StaticInterval]:
    """All static intervals of a recording, in order of time."""
    times = inertial.time_s
    if len(times) < 3:
        return []
    numbers = np.floor((times - times[0]) / BLOCK_S).astype(int)
    edges = np.concatenate(([0], np.flatnonzero(np.diff(numbers)) + 1, [len(times)]))
    forces = np.add.reduceat(inertial.force, edges[:-1], axis=0) / np.diff(edges)[:, None]
    rests, begin = [], 0
    for k in range(len(edges)):
        goes_on = k < len(edges) - 1 and _still(inertial, edges[k], edges[k + 1])
        if k > begin and not (goes_on and _same(forces, begin, k)):
            rests += _rest(inertial, edges, begin, k)
            begin = k
        if not goes_on:
            begin = k + 1
    return rests


def _same(forces: FloatArray, begin: int, k: int) -> bool:
    """Whether block k measures the same force as the blocks from `begin` on."""
    return float(np.linalg.norm(forces[k] - forces[begin:k].mean(axis=0))) < SAME_FORCE_M_S2


def _still(inertial: ImuSamples, a: int, b: int) -> bool:
    if b - a < 3:
        return False
    rate = float(np.linalg.norm(inertial.rate[a:b].std(axis=0)))
    force = float(np.linalg.norm(inertial.force[a:b].std(axis=0)))
    return rate < STILL_RATE_RAD_S and force < STILL_FORCE_M_S2


def _rest(inertial: ImuSamples, edges: Indices, begin: int, end: int) -> list[StaticInterval]:
    """The static interval from block `begin` to `end`, without the first and last block, if long enough."""
    if (end - begin) * BLOCK_S < REST_S:
        return []
    inside = slice(int(edges[begin + 1]), int(edges[end - 1]))
    times = inertial.time_s[inside]
    return [
        StaticInterval(
            inertial.force[inside].mean(axis=0),
            inertial.rate[inside].mean(axis=0),
            float(np.mean(inertial.temperature_c[inside])),
            len(times),
            float(times[0]),
            float(times[-1]),
        )
    ]
