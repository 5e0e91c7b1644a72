"""The coarse alignment: time offset and rotation that make the camera's rotation match the gyroscope's.

Between two sightings the camera rotates by c (camera axes). Over the same time, shifted by the offset, the
gyroscope measures a rotation g (body axes). With the right offset g = R c + b dt, where b is the gyro bias.
For every offset on a grid, Kabsch's method with outlier weights gives R; the offset with the best fit wins.
This needs no initial guess, so it also finds a camera that is mounted the wrong way round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import ImuSamples, Indices, PadObservations
from calibration.mount.solve.rotations import log, nearest_rotation, transposed
from companion.base.geometry import FloatArray

PAIR_S: Final = 0.25  # long enough to rotate by more than a pose's noise, short enough to neglect coning
LONGEST_PAIR_S: Final = 0.5
WIDEST_OFFSET_S: Final = 0.3
OFFSET_STEP_S: Final = 0.005
CAUCHY_RAD: Final = 0.02
ITERATIONS: Final = 4


@dataclass(frozen=True, slots=True)
class CoarseAlignment:
    """Body from camera (3, 3), offset (s) to add to stamps, gyro bias (3,), and the misfit over the grid."""

    body_from_camera: FloatArray
    time_offset_s: float
    gyro_bias: FloatArray
    grid_s: FloatArray
    misfit_rad: FloatArray


def correlate(inertial: ImuSamples, sightings: PadObservations) -> CoarseAlignment:
    """Search for the offset, and with it the rotation and the bias.

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
    """Pairs of sightings PAIR_S apart, or a little more."""
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
    """Rotation, bias, and the misfit (rad): a Cauchy scale, which is robust against outliers."""
    weight = np.ones(len(camera))
    rotation, bias = np.eye(3), np.zeros(3)
    for _ in range(ITERATIONS):
        share = (weight / weight.sum())[:, None]
        camera_mean, gyro_mean = (share * camera).sum(axis=0), (share * gyro).sum(axis=0)
        rotation = nearest_rotation(((gyro - gyro_mean) * share).T @ (camera - camera_mean))
        bias = (gyro_mean - rotation @ camera_mean) / float((share[:, 0] * spans_s).sum())
        residuals = gyro - camera @ rotation.T - bias * spans_s[:, None]
        square = np.sum(residuals**2, axis=1) / CAUCHY_RAD**2
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
