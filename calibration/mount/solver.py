"""Camera-IMU extrinsics and time offset from a recording, with their uncertainty.

The coarse alignment gives rotation and offset. Gauss-Newton then fits all unknowns: first with Student's t
weights, which are robust against false and flipped poses, then without the outliers found. Sightings are
weighted by their scatter about the fit and the correlation of residuals within a segment (the variance of the
scores between segments over white noise's; Liang and Zeger 1986): a lens error repeats in every frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from calibration.mount.model import (
    ACCEL_BIAS,
    COUNT,
    FIRST_OF_PATH,
    GYRO_BIAS,
    MARGIN_S,
    OFFSET,
    POSITION,
    ROTATION,
    SEGMENT_S,
    SEGMENT_STATE_COUNT,
    SHUTTER,
    ImuSegments,
    IntegratedAttitude,
    IntegratedMotion,
    MountPrior,
    SegmentStarts,
    Unknowns,
    at_times,
    integrate_forces,
    integrate_rates,
    log,
    nearest_rotation,
    split_into_segments,
)
from calibration.mount.recording import ImuSamples, Indices, Mask, PadObservations
from companion.base.geometry import FloatArray

FEWEST_PER_SEGMENT: Final = 8
STUDENT_FREEDOM: Final = 5.0
ROBUST_ITERATIONS: Final = 12

ITERATIONS: Final = 12
CONVERGED: Final = 0.03  # of a standard deviation
NEARLY_CONVERGED: Final = 1.0
ROUNDS: Final = 2
OUTLIER: Final = float(chi2.ppf(0.9995, 6))
MIDDLE: Final = float(chi2.ppf(0.5, 6))
# sightings whose attitude is within this of the segment's median one give its start state
START_RAD: Final = 0.12
NO_FIT: Final = "no mount fits what was recorded"


class NoSolutionError(Exception):
    """The recording has no solution; the text says why."""


@dataclass(frozen=True, slots=True)
class MountSolution:
    """A fit. `covariance` (35, 35) is that of the unknowns (see `unknowns`), without lens and stamps.

    `kept` (k,) says which sightings were used, and `odd_segments` in how many segments most were not;
    `residuals` (k, 6) are all sightings' residuals in their own standard deviations; `scatter` is how large
    those are against what was expected (1 for noise as stated). `halves` (4,) is by how much the recording's
    first half would have it otherwise than the second: rotation about the body's axes (rad)
    and time offset (s).
    """

    unknowns: Unknowns
    covariance: FloatArray
    coarse: CoarseAlignment
    sightings: PadObservations
    kept: Mask
    residuals: FloatArray
    scatter: float
    halves: FloatArray
    segments: int
    odd_segments: int
    converged: bool
    prior: MountPrior

    @property
    def time_offset_s(self) -> float:
        """To be added to frames' stamps."""
        return float(self.unknowns.values[OFFSET][0])

    @property
    def position_m(self) -> FloatArray:
        """The camera (3,) from the inertial sensor, body axes."""
        return self.unknowns.values[POSITION]

    @property
    def rotation_covariance(self) -> FloatArray:
        """Of the rotation about the body's axes (3, 3), rad²; what the lens's centre may be off included."""
        across = self.unknowns.body_from_camera @ np.diag((1.0, 1.0, 0.0)) @ self.unknowns.body_from_camera.T
        return np.asarray(self.covariance[ROTATION, ROTATION] + self.prior.lens_rad**2 * across)

    @property
    def time_offset_std_s(self) -> float:
        """Of the offset; what the inertial samples' own stamps may be off included."""
        return float(np.hypot(self.std(OFFSET)[0], self.prior.stamp_s))

    def std(self, which: slice) -> FloatArray:
        """Standard deviations of some unknowns, by the fit alone."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[which]))


def solve(
    inertial: ImuSamples,
    sightings: PadObservations,
    position_m: FloatArray,
    shutter_s: float = 0.0,
    prior: MountPrior | None = None,
) -> MountSolution:
    """Find the mount.

    Args:
        inertial: samples in body axes.
        sightings: the pad in camera axes.
        shutter_s: the time in which a rolling shutter passes one focal length of the image, by its file.
        position_m: the camera (3,) by the vehicle's file: where the search for it begins, and what it is
            held to by `prior.position_m`.

    Raises:
        NoSolutionError: too little was seen, or it contradicts itself.
    """
    prior = prior or MountPrior()
    try:
        coarse = correlate(inertial, sightings)
    except ValueError as error:
        raise NoSolutionError(str(error)) from error
    prior_mean = np.zeros(COUNT)
    prior_mean[POSITION], prior_mean[SHUTTER] = position_m, (shutter_s, 0.5 * shutter_s)
    unknowns = Unknowns(coarse.body_from_camera, prior_mean.copy())
    unknowns.values[OFFSET], unknowns.values[GYRO_BIAS] = coarse.time_offset_s, coarse.gyro_bias
    std = prior.standard_deviations(shutter_s)
    try:
        problem = _problem(inertial, sightings, coarse.time_offset_s)
        fit = _Fit(problem, unknowns, _initial_starts(problem, unknowns), prior_mean, std)
        fit.run_robust()
        for _ in range(ROUNDS):
            fit.drop_outliers()
            fit.run()
            fit.weigh()
        fit.run()
        return fit.solution(coarse, prior)
    except np.linalg.LinAlgError as error:
        raise NoSolutionError(NO_FIT) from error


def _problem(inertial: ImuSamples, sightings: PadObservations, offset_s: float) -> MountLeastSquares:
    """Segments with enough sightings in them, and within reach of the inertial samples."""
    inside = (sightings.time_s + offset_s > inertial.time_s[0]) & (
        sightings.time_s + offset_s < inertial.time_s[-1]
    )
    sightings = sightings.taken(inside)
    if not len(sightings):
        raise NoSolutionError("no sighting while inertial samples came")
    segments = split_into_segments(inertial, float(sightings.time_s[0]), float(sightings.time_s[-1]))
    which = np.searchsorted(segments.start_s, sightings.time_s - MARGIN_S, side="right") - 1
    which = np.maximum(which, 0)
    since = sightings.time_s - MARGIN_S - segments.start_s[which] if len(segments.start_s) else which
    counts = np.bincount(which, minlength=len(segments.start_s))
    used = (since >= 0.0) & (since < SEGMENT_S) & (counts[which] >= FEWEST_PER_SEGMENT)
    full = np.unique(which[used])
    if len(full) < 2:
        raise NoSolutionError(f"fewer than two segments of {SEGMENT_S:g} s in which the pad was seen")
    kept = ImuSegments(segments.start_s[full], segments.step_s, segments.rate[full], segments.force[full])
    return MountLeastSquares(kept, sightings.taken(used), np.searchsorted(full, which[used]))


def _initial_starts(problem: MountLeastSquares, unknowns: Unknowns) -> SegmentStarts:
    """Each segment's beginning, from those of its sightings that agree with most of the others."""
    count = len(problem.segments.start_s)
    attitude, motion = problem.path(unknowns)
    since = problem.since_s(unknowns)
    moment = at_times(problem.segments, attitude, motion, problem.which, since)
    seen = problem.sightings
    pad_from_body = seen.camera_from_pad.mT @ unknowns.body_from_camera.T
    first = pad_from_body @ moment.rotation.mT
    lever = unknowns.values[POSITION]
    in_body = seen.position_m @ unknowns.body_from_camera.T + lever
    place = -(pad_from_body @ in_body[..., None])[..., 0]
    starts = SegmentStarts(np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3)))
    for k in range(count):
        own = problem.which == k
        apart = np.linalg.norm(log(first[own].mT[:, None] @ first[own][None]), axis=-1)
        middle = int(np.argmin(np.minimum(apart, 0.5).sum(axis=1)))
        agree = apart[middle] < START_RAD
        start = first[own][middle]
        starts.pad_from_body[k] = start
        t = since[own][agree][:, None]
        known = 0.5 * unknowns.gravity_pad * t**2 + moment.position[own][agree] @ start.T
        line = np.column_stack((np.ones(len(t)), t[:, 0]))
        found = np.linalg.lstsq(line, place[own][agree] - known, rcond=None)[0]
        starts.position_m[k], starts.velocity_m_s[k] = found
    return starts


class _Fit:
    """A fit on its way."""

    def __init__(
        self,
        problem: MountLeastSquares,
        unknowns: Unknowns,
        starts: SegmentStarts,
        prior_mean: FloatArray,
        std: FloatArray,
    ) -> None:
        """`prior_mean` (35,) to `std` (35,) is what is known beforehand."""
        self._problem, self._unknowns, self._initial_starts = problem, unknowns, starts
        self._believed = prior_mean
        self._prior = np.diag(std**-2)
        self._kept = np.ones(len(problem.sightings), dtype=bool)
        self._scatter2 = self._correlated = 1.0
        self._converged = False

    def _squares(self) -> FloatArray:
        """Each sighting's squared distance (k,) from the fit, in its own standard deviations."""
        path = self._problem.path(self._unknowns)
        residuals = self._problem.residuals(self._unknowns, self._initial_starts, *path)
        return np.asarray(np.sum(residuals**2, axis=1))

    def _step(self, weight: FloatArray, share: float = 1.0) -> float:
        """A share of one step of Gauss-Newton; returns the whole step's length in standard deviations."""
        reduced = self._problem.reduced(self._problem.linear(self._unknowns, self._initial_starts), weight)
        full = reduced.information + self._prior
        gradient = reduced.scores.sum(axis=0) - self._prior @ (self._unknowns.values - self._believed)
        step = np.linalg.solve(full, gradient)
        if not np.isfinite(step).all():
            raise NoSolutionError(NO_FIT)
        self._unknowns = self._unknowns.moved(share * step)
        self._initial_starts = self._initial_starts.moved(share * reduced.start_steps(step))
        return float(np.sqrt(step @ full @ step))

    def run_robust(self) -> None:
        """Student's weights about a scale by the median."""
        for _ in range(ROBUST_ITERATIONS):
            squares = self._squares()
            self._scatter2 = float(np.median(squares)) / MIDDLE
            weight = (STUDENT_FREEDOM + 6.0) / (STUDENT_FREEDOM + squares / self._scatter2)
            if self._step(weight / self._scatter2) < NEARLY_CONVERGED:
                break

    def drop_outliers(self) -> None:
        """Use what lies within the scatter of most."""
        squares = self._squares()
        self._scatter2 = float(np.median(squares[self._kept])) / MIDDLE
        self._kept = squares < OUTLIER * self._scatter2

    def run(self) -> None:
        """Least squares over what is kept.

        Rates are constant between samples, so the misfit has small kinks over the offset; a step that only
        goes to and fro about one is shortened.
        """
        self._converged, share, last = False, 1.0, np.inf
        for _ in range(ITERATIONS):
            length = self._step(self._weight(), share)
            if share * length < CONVERGED:
                self._converged = True
                return
            if 0.5 * last < length < 1.0:
                share *= 0.5
            last = length

    def _weight(self) -> FloatArray:
        return np.asarray(self._kept / (self._scatter2 * self._correlated))

    def weigh(self) -> None:
        """How far the sightings scatter, and how much the misses of a segment hang together."""
        count = int(self._kept.sum())
        freedom = 6 * count - 9 * len(self._initial_starts.position_m) - 10
        self._scatter2 = float(self._squares()[self._kept].sum()) / max(freedom, 1)
        self._correlated = 1.0
        reduced = self._problem.reduced(
            self._problem.linear(self._unknowns, self._initial_starts), self._weight()
        )
        self._correlated = max(1.0, self._inflation(reduced))

    def _inflation(self, reduced: ReducedNormalEquations) -> float:
        """The estimate's variance by the scores' scatter over that by white noise: rotation and offset."""
        scores = reduced.scores - reduced.scores.mean(axis=0)
        segments = len(scores)
        between = scores.T @ scores * (segments / (segments - 1.0))
        gain = np.linalg.inv(reduced.information + self._prior)
        found, expected = (np.diag(gain @ m @ gain)[[0, 1, 2, 6]] for m in (between, reduced.information))
        return float(np.mean(found / expected))

    def solution(self, coarse: CoarseAlignment, prior: MountPrior) -> MountSolution:
        """What has come of it.

        Raises:
            NoSolutionError: a time offset that the search did not reach.
        """
        if abs(offset_s := float(self._unknowns.values[OFFSET][0])) > MARGIN_S:
            raise NoSolutionError(f"{NO_FIT}: the time offset ran off to {offset_s:+.2f} s")
        linear = self._problem.linear(self._unknowns, self._initial_starts)
        reduced = self._problem.reduced(linear, self._weight())
        which = self._problem.which
        covariance = np.asarray(np.linalg.inv(reduced.information + self._prior), dtype=float)
        return MountSolution(
            unknowns=self._unknowns,
            covariance=covariance,
            coarse=coarse,
            sightings=self._problem.sightings,
            kept=self._kept,
            residuals=linear.residuals,
            scatter=float(np.sqrt(self._scatter2)),
            halves=_halves(reduced, covariance)[[0, 1, 2, OFFSET.start]],
            segments=len(self._initial_starts.position_m),
            odd_segments=int(np.sum(np.bincount(which, self._kept) < 0.5 * np.bincount(which))),
            converged=self._converged,
            prior=prior,
        )


def _halves(reduced: ReducedNormalEquations, covariance: FloatArray) -> FloatArray:
    """The unknowns (35,) by the first half of the segments less those by the second, to first order.

    At the fit the scores of the halves cancel; each half alone, with half of the information, would step by
    twice the covariance times its own.
    """
    scores = reduced.scores - reduced.scores.mean(axis=0)
    return np.asarray(4.0 * covariance @ scores[: len(scores) // 2].sum(axis=0))


# ---------------------------------------------------------------- least squares
# The prediction of a sighting follows from its segment's start state, the integrated motion since then, and
# the extrinsics. The difference, in standard deviations of the sighting, gives six residuals. The start
# states (nine unknowns per segment) are eliminated with the Schur complement, so the system to solve is 35 x
# 35 for a recording of any length. Derivatives are numerical differences.

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
        predicted = -(pad_from_camera.mT @ place[..., None])[..., 0] - lever
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


# ---------------------------------------------------------------- correlation
# Between two sightings the camera rotates by c (camera axes). Over the same time, shifted by the offset, the
# gyroscope measures a rotation g (body axes). With the right offset g = R c + b dt, where b is the gyro bias.
# For every offset on a grid, Kabsch's method with outlier weights gives R; the offset with the best fit wins.
# This needs no initial guess, so it also finds a camera that is mounted the wrong way round.

PAIR_S: Final = 0.25  # long enough to rotate by more than a pose's noise, short enough to neglect coning
LONGEST_PAIR_S: Final = 0.5
WIDEST_OFFSET_S: Final = 0.3
OFFSET_STEP_S: Final = 0.005
CAUCHY_RAD: Final = 0.02
FIT_ITERATIONS: Final = 4


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
    turned = sightings.camera_from_pad.mT
    # camera axes at the first, from camera axes at the second
    camera = log(turned[first].mT @ turned[second])
    # the integral of the rate (rad, each axis by itself) up to each sample
    steps = np.diff(inertial.time_s)[:, None] * 0.5 * (inertial.rate[1:] + inertial.rate[:-1])
    angles = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))

    def angle(times_s: FloatArray) -> FloatArray:
        return np.stack([np.interp(times_s, inertial.time_s, a) for a in angles.T], axis=1)

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


def _fit(camera: FloatArray, gyro: FloatArray, spans_s: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Rotation, bias, and the misfit (rad): a Cauchy scale, which is robust against outliers."""
    weight = np.ones(len(camera))
    rotation, bias = np.eye(3), np.zeros(3)
    for _ in range(FIT_ITERATIONS):
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
