"""The least-squares problem of a mount calibration: residuals of sightings, and the normal equations.

A sighting is predicted from its stretch's beginning, the path since then and how the camera sits; what it
differs by, in its own standard deviations, are six residuals. The beginnings (nine unknowns a stretch) are
eliminated stretch by stretch (Schur's complement), so what is solved is 35 x 35 however long the recording.
Derivatives are differences: a few milliseconds each, and no sign to get wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.mount.record.samples import Indices, PadObservations
from calibration.mount.solve.path import (
    ImuSegments,
    IntegratedAttitude,
    IntegratedMotion,
    at_times,
    move,
    turn,
)
from calibration.mount.solve.rotations import log, transposed
from calibration.mount.solve.unknowns import (
    ACCEL_BIAS,
    COUNT,
    FIRST_OF_PATH,
    OFFSET,
    POSITION,
    STRETCH_COUNT,
    SegmentStarts,
    Unknowns,
)
from companion.base.geometry import FloatArray

DIFFERENCE: Final = 1e-6
# of a beginning, so that a stretch with few sightings has a solution all the same: metres, rad, m/s
WEAK_INFORMATION: Final = 1e-4


@dataclass(frozen=True, slots=True)
class Linearization:
    """The problem about a point: residuals (k, 6), and changes by all (k, 6, 35), by a beginning."""

    residuals: FloatArray
    by_unknowns: FloatArray
    by_beginning: FloatArray


@dataclass(frozen=True, slots=True)
class ReducedNormalEquations:
    """The normal equations of the unknowns alone, and what gives the beginnings back.

    `scores` (s, 35) are the gradient's parts by stretch.
    """

    information: FloatArray
    scores: FloatArray
    own: FloatArray  # (s, 9, 9)
    mixed: FloatArray  # (s, 9, 35)
    own_gradient: FloatArray  # (s, 9)

    def beginnings(self, step: FloatArray) -> FloatArray:
        """The beginnings' steps (s, 9) that go with a step of the unknowns."""
        rest = self.own_gradient - self.mixed @ step
        return np.asarray(np.linalg.solve(self.own, rest[..., None])[..., 0])


class MountLeastSquares:
    """Sightings in stretches. `which` (k,) is each sighting's stretch, in rising order."""

    def __init__(self, stretches: ImuSegments, sightings: PadObservations, which: Indices) -> None:
        self.stretches, self.sightings, self.which = stretches, sightings, which
        self._first = np.searchsorted(which, np.arange(len(stretches.start_s)))
        self._whiten = np.linalg.inv(np.linalg.cholesky(sightings.covariance))

    def path(
        self, unknowns: Unknowns, turning: IntegratedAttitude | None = None
    ) -> tuple[IntegratedAttitude, IntegratedMotion]:
        """The motion within the stretches; with a `turning` that is known already, if only forces changed."""
        if turning is None:
            turning = turn(self.stretches, unknowns.true_rate(self.stretches.rate))
        return turning, move(self.stretches, turning, unknowns.true_force(self.stretches.force))

    def since_s(self, unknowns: Unknowns) -> FloatArray:
        """Each sighting's time (k,) from its stretch's beginning, by the offset as it is believed."""
        stamps: FloatArray = self.sightings.time_s + unknowns.values[OFFSET]
        return np.asarray(stamps - self.stretches.start_s[self.which])

    def residuals(
        self, unknowns: Unknowns, begin: SegmentStarts, turning: IntegratedAttitude, moving: IntegratedMotion
    ) -> FloatArray:
        """What sightings differ by from the prediction (k, 6): position, rotation; whitened."""
        since = self.since_s(unknowns)
        moment = at_times(self.stretches, turning, moving, self.which, since)
        start, t = begin.pad_from_body[self.which], since[:, None]
        place = (
            begin.position_m[self.which]
            + begin.velocity_m_s[self.which] * t
            + 0.5 * unknowns.gravity_pad * t**2
            + (start @ moment.position[..., None])[..., 0]
        )
        speed = begin.velocity_m_s[self.which] + unknowns.gravity_pad * t
        speed = speed + (start @ moment.velocity[..., None])[..., 0]
        pad_from_camera = start @ moment.rotation @ unknowns.body_from_camera
        lever = unknowns.body_from_camera.T @ unknowns.values[POSITION]
        predicted = -(transposed(pad_from_camera) @ place[..., None])[..., 0] - lever
        closing = np.einsum("ki,ki->k", pad_from_camera[..., 2], speed) / self.sightings.position_m[:, 2]
        roll = moment.rate @ unknowns.body_from_camera[:, 2]
        turned = log(self.sightings.camera_from_pad @ pad_from_camera) - unknowns.shutter_turn(closing, roll)
        misses = np.concatenate((self.sightings.position_m - predicted, turned), axis=1)
        return np.asarray((self._whiten @ misses[..., None])[..., 0])

    def linear(self, unknowns: Unknowns, begin: SegmentStarts) -> Linearization:
        """Residuals and derivatives about a point."""
        path = self.path(unknowns)
        here = self.residuals(unknowns, begin, *path)
        by_unknowns = np.empty((*here.shape, COUNT))
        for k, step in enumerate(np.eye(COUNT) * DIFFERENCE):
            there = unknowns.moved(step)
            own_path = path
            if k >= FIRST_OF_PATH:
                own_path = self.path(there, path[0] if k >= ACCEL_BIAS.start else None)
            by_unknowns[..., k] = (self.residuals(there, begin, *own_path) - here) / DIFFERENCE
        by_beginning = np.empty((*here.shape, STRETCH_COUNT))
        everywhere = np.ones((len(self.stretches.start_s), 1))
        for k, step in enumerate(np.eye(STRETCH_COUNT) * DIFFERENCE):
            moved = begin.moved(everywhere * step)
            by_beginning[..., k] = (self.residuals(unknowns, moved, *path) - here) / DIFFERENCE
        return Linearization(here, by_unknowns, by_beginning)

    def reduced(self, linear: Linearization, weight: FloatArray) -> ReducedNormalEquations:
        """The normal equations with weights (k,), without the beginnings."""
        r, to_all, to_own = linear.residuals, linear.by_unknowns, linear.by_beginning
        weighted = to_own * weight[:, None, None]
        own = self._by_stretch(np.einsum("kri,krj->kij", weighted, to_own))
        own = own + WEAK_INFORMATION * np.eye(STRETCH_COUNT)
        mixed = self._by_stretch(np.einsum("kri,krj->kij", weighted, to_all))
        own_gradient = -self._by_stretch(np.einsum("kri,kr->ki", weighted, r))
        weighted_all = to_all * weight[:, None, None]
        information = np.einsum("kri,krj->ij", weighted_all, to_all, optimize=True)
        gradient = -self._by_stretch(np.einsum("kri,kr->ki", weighted_all, r))
        back = np.linalg.solve(own, mixed)  # (s, 9, 35)
        return ReducedNormalEquations(
            information=information - np.einsum("sai,saj->ij", mixed, back),
            scores=gradient - np.einsum("sai,sa->si", back, own_gradient),
            own=own,
            mixed=mixed,
            own_gradient=own_gradient,
        )

    def _by_stretch(self, values: FloatArray) -> FloatArray:
        """Sums (s, ...) over each stretch's sightings."""
        return np.asarray(np.add.reduceat(values, self._first, axis=0))
