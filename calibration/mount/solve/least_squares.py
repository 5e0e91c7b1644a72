"""The least-squares problem of a mount calibration: residuals of sightings, and the normal equations.

The prediction of a sighting follows from its segment's start state, the integrated motion since then, and the
extrinsics. The difference, in standard deviations of the sighting, gives six residuals. The start states
(nine unknowns per segment) are eliminated with the Schur complement, so the system to solve is 35 x 35 for a
recording of any length. Derivatives are numerical differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import Indices, PadObservations
from calibration.mount.solve.integration import (
    ImuSegments,
    IntegratedAttitude,
    IntegratedMotion,
    at_times,
    integrate_forces,
    integrate_rates,
)
from calibration.mount.solve.rotations import log, transposed
from calibration.mount.solve.unknowns import (
    ACCEL_BIAS,
    COUNT,
    FIRST_OF_PATH,
    OFFSET,
    POSITION,
    SEGMENT_STATE_COUNT,
    SegmentStarts,
    Unknowns,
)
from companion.base.geometry import FloatArray

DIFFERENCE: Final = 1e-6
# of a start state, so that a segment with few sightings has a solution: metres, rad, m/s
WEAK_INFORMATION: Final = 1e-4


@dataclass(frozen=True, slots=True)
class Linearization:
    """Linearization: residuals (k, 6), Jacobians by the unknowns (k, 6, 35) and by the start state."""

    residuals: FloatArray
    by_unknowns: FloatArray
    by_start: FloatArray


@dataclass(frozen=True, slots=True)
class ReducedNormalEquations:
    """The normal equations of the unknowns alone, and the back substitution for the start states.

    `scores` (s, 35) are the gradient's parts by segment.
    """

    information: FloatArray
    scores: FloatArray
    own: FloatArray  # (s, 9, 9)
    mixed: FloatArray  # (s, 9, 35)
    own_gradient: FloatArray  # (s, 9)

    def start_steps(self, step: FloatArray) -> FloatArray:
        """The steps (s, 9) of the start states that go with a step of the unknowns."""
        rest = self.own_gradient - self.mixed @ step
        return np.asarray(np.linalg.solve(self.own, rest[..., None])[..., 0])


class MountLeastSquares:
    """Sightings in segments. `which` (k,) is the segment of each sighting, in rising order."""

    def __init__(self, segments: ImuSegments, sightings: PadObservations, which: Indices) -> None:
        self.segments, self.sightings, self.which = segments, sightings, which
        self._first = np.searchsorted(which, np.arange(len(segments.start_s)))
        self._whiten = np.linalg.inv(np.linalg.cholesky(sightings.covariance))

    def path(
        self, unknowns: Unknowns, attitude: IntegratedAttitude | None = None
    ) -> tuple[IntegratedAttitude, IntegratedMotion]:
        """The motion within the segments; with `attitude` given, only forces are integrated."""
        if attitude is None:
            attitude = integrate_rates(self.segments, unknowns.true_rate(self.segments.rate))
        return attitude, integrate_forces(self.segments, attitude, unknowns.true_force(self.segments.force))

    def since_s(self, unknowns: Unknowns) -> FloatArray:
        """The time (k,) of each sighting since its segment's start, with the current time offset."""
        stamps: FloatArray = self.sightings.time_s + unknowns.values[OFFSET]
        return np.asarray(stamps - self.segments.start_s[self.which])

    def residuals(
        self,
        unknowns: Unknowns,
        starts: SegmentStarts,
        attitude: IntegratedAttitude,
        motion: IntegratedMotion,
    ) -> FloatArray:
        """Residuals of the sightings (k, 6): position, rotation; whitened."""
        since = self.since_s(unknowns)
        moment = at_times(self.segments, attitude, motion, self.which, since)
        start, t = starts.pad_from_body[self.which], since[:, None]
        place = (
            starts.position_m[self.which]
            + starts.velocity_m_s[self.which] * t
            + 0.5 * unknowns.gravity_pad * t**2
            + (start @ moment.position[..., None])[..., 0]
        )
        speed = starts.velocity_m_s[self.which] + unknowns.gravity_pad * t
        speed = speed + (start @ moment.velocity[..., None])[..., 0]
        pad_from_camera = start @ moment.rotation @ unknowns.body_from_camera
        lever = unknowns.body_from_camera.T @ unknowns.values[POSITION]
        predicted = -(transposed(pad_from_camera) @ place[..., None])[..., 0] - lever
        closing = np.einsum("ki,ki->k", pad_from_camera[..., 2], speed) / self.sightings.position_m[:, 2]
        roll = moment.rate @ unknowns.body_from_camera[:, 2]
        turned = log(self.sightings.camera_from_pad @ pad_from_camera) - unknowns.shutter_turn(closing, roll)
        residuals = np.concatenate((self.sightings.position_m - predicted, turned), axis=1)
        return np.asarray((self._whiten @ residuals[..., None])[..., 0])

    def linear(self, unknowns: Unknowns, starts: SegmentStarts) -> Linearization:
        """Residuals and their Jacobians at a point."""
        path = self.path(unknowns)
        here = self.residuals(unknowns, starts, *path)
        by_unknowns = np.empty((*here.shape, COUNT))
        for k, step in enumerate(np.eye(COUNT) * DIFFERENCE):
            there = unknowns.moved(step)
            own_path = path
            if k >= FIRST_OF_PATH:
                own_path = self.path(there, path[0] if k >= ACCEL_BIAS.start else None)
            by_unknowns[..., k] = (self.residuals(there, starts, *own_path) - here) / DIFFERENCE
        by_start = np.empty((*here.shape, SEGMENT_STATE_COUNT))
        everywhere = np.ones((len(self.segments.start_s), 1))
        for k, step in enumerate(np.eye(SEGMENT_STATE_COUNT) * DIFFERENCE):
            moved = starts.moved(everywhere * step)
            by_start[..., k] = (self.residuals(unknowns, moved, *path) - here) / DIFFERENCE
        return Linearization(here, by_unknowns, by_start)

    def reduced(self, linear: Linearization, weight: FloatArray) -> ReducedNormalEquations:
        """The normal equations with weights (k,), start states eliminated."""
        r, to_all, to_own = linear.residuals, linear.by_unknowns, linear.by_start
        weighted = to_own * weight[:, None, None]
        own = self._by_segment(np.einsum("kri,krj->kij", weighted, to_own))
        own = own + WEAK_INFORMATION * np.eye(SEGMENT_STATE_COUNT)
        mixed = self._by_segment(np.einsum("kri,krj->kij", weighted, to_all))
        own_gradient = -self._by_segment(np.einsum("kri,kr->ki", weighted, r))
        weighted_all = to_all * weight[:, None, None]
        information = np.einsum("kri,krj->ij", weighted_all, to_all, optimize=True)
        gradient = -self._by_segment(np.einsum("kri,kr->ki", weighted_all, r))
        back = np.linalg.solve(own, mixed)  # (s, 9, 35)
        return ReducedNormalEquations(
            information=information - np.einsum("sai,saj->ij", mixed, back),
            scores=gradient - np.einsum("sai,sa->si", back, own_gradient),
            own=own,
            mixed=mixed,
            own_gradient=own_gradient,
        )

    def _by_segment(self, values: FloatArray) -> FloatArray:
        """Sums (s, ...) over each segment's sightings."""
        return np.asarray(np.add.reduceat(values, self._first, axis=0))
