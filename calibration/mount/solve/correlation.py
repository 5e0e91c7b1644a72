"""Where the search starts: the time offset and the rotation at which the camera turns as the gyroscope does.

Between two sightings the camera has turned by c (camera axes); over the same time, shifted by the offset,
the gyroscope has turned by g (body axes). With the right offset g = R c + b dt, b being the gyroscope's bias.
For every offset on a grid R is Kabsch's, with outliers weighed down; the offset that fits best is kept. No
guess is needed for either, so a camera that is mounted the wrong way round is found as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import ImuSamples, Indices, PadObservations
from calibration.mount.solve.rotations import log, nearest_rotation, transposed
from companion.base.geometry import FloatArray

PAIR_S: Final = 0.25  # long enough to turn by more than a pose's noise, short enough for coning not to count
LONGEST_PAIR_S: Final = 0.5
WIDEST_OFFSET_S: Final = 0.3
OFFSET_STEP_S: Final = 0.005
CAUCHY_RAD: Final = 0.02
ITERATIONS: Final = 4


@dataclass(frozen=True, slots=True)
class CoarseAlignment:
    """A start: body from camera (3, 3), offset (s) to add to stamps, bias (3,), and the fit over the grid."""

    body_from_camera: FloatArray
    time_offset_s: float
    gyro_bias: FloatArray
    grid_s: FloatArray
    misfit_rad: FloatArray


def correlate(inertial: ImuSamples, sightings: PadObservations) -> CoarseAlignment:
    """Search the offset, and with it the rotation and the bias.

    Raises:
        ValueError: no two sightings are close enough to one another.
    """
    first, second = _pairs(sightings.time_s)
    if len(first) < 3:
        raise ValueError("no sightings that follow one another")
    turned = transposed(sightings.camera_from_pad)
    # camera axes at the first, from camera axes at the second
    camera = log(transposed(turned[first]) @ turned[second])
    angle = _running_angle(inertial)
    spans = sightings.time_s[second] - sightings.time_s[first]
    grid = np.arange(-WIDEST_OFFSET_S, WIDEST_OFFSET_S + 1e-9, OFFSET_STEP_S)
    fits = []
    for offset_s in grid:
        gyro = angle(sightings.time_s[second] + offset_s) - angle(sightings.time_s[first] + offset_s)
        fits.append(_fit(camera, gyro, spans))
    misfit = np.array([fit[2] for fit in fits])
    best = int(np.argmin(misfit))
    return CoarseAlignment(fits[best][0], _refined(grid, misfit, best), fits[best][1], grid, misfit)


def _pairs(times_s: FloatArray) -> tuple[Indices, Indices]:
    """Of each sighting the first one that is PAIR_S later, if it is not much later."""
    second = np.searchsorted(times_s, times_s + PAIR_S)
    first = np.arange(len(times_s))
    inside = second < len(times_s)
    first, second = first[inside], second[inside]
    near = times_s[second] - times_s[first] <= LONGEST_PAIR_S
    return first[near], second[near]


class _running_angle:  # noqa: N801 - it reads as the function that it makes
    """The integral of the rate (rad, each axis by itself) up to a time."""

    def __init__(self, inertial: ImuSamples) -> None:
        steps = np.diff(inertial.time_s)[:, None] * 0.5 * (inertial.rate[1:] + inertial.rate[:-1])
        self._time_s = inertial.time_s
        self._angle = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))

    def __call__(self, times_s: FloatArray) -> FloatArray:
        return np.stack([np.interp(times_s, self._time_s, a) for a in self._angle.T], axis=1)


def _fit(camera: FloatArray, gyro: FloatArray, spans_s: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Rotation, bias, and how large the misfit is (rad): a Cauchy scale that outliers hardly move."""
    weight = np.ones(len(camera))
    rotation, bias = np.eye(3), np.zeros(3)
    for _ in range(ITERATIONS):
        share = (weight / weight.sum())[:, None]
        camera_mean, gyro_mean = (share * camera).sum(axis=0), (share * gyro).sum(axis=0)
        rotation = nearest_rotation(((gyro - gyro_mean) * share).T @ (camera - camera_mean))
        bias = (gyro_mean - rotation @ camera_mean) / float((share[:, 0] * spans_s).sum())
        misses = gyro - camera @ rotation.T - bias * spans_s[:, None]
        square = np.sum(misses**2, axis=1) / CAUCHY_RAD**2
        weight = 1.0 / (1.0 + square)
    return rotation, bias, CAUCHY_RAD * float(np.sqrt(np.mean(np.log1p(square))))


def _refined(grid: FloatArray, misfit: FloatArray, best: int) -> float:
    """The minimum of the parabola through the best point and its neighbours."""
    if best in {0, len(grid) - 1}:
        return float(grid[best])
    before, here, after = misfit[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    shift = 0.0 if bend <= 0.0 else 0.5 * (before - after) / bend
    return float(grid[best] + shift * OFFSET_STEP_S)
