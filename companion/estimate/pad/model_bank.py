"""Interacting multiple models (IMM): Kalman filters of one state that share their uncertainty.

Every model has the same state and sees the same measurement, but moves it by its own F and Q. Before a step
each model starts from the blend of all that the chance of a change to it gives; after a measurement the
models' probabilities follow from how well each expected it (Bar-Shalom, Li and Kirubarajan 2001, 11.6.6).

A bank holds several groups of models, each of a motion of its own: models change within their group only,
and a group's probabilities sum to 1. All are carried through one array operation, whatever their number: the
cost of small arrays is in the calls, not in the sums. A test compares the numbers with those of filterpy's
`IMMEstimator`, which does the same one model at a time.

Arrays: m models of an n-state in g groups, means (m, n), covariances (m, n, n), probabilities (m,). Nothing
that a `BankState` holds is ever written to again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import FloatArray

_SEEN: Final = 2  # a measurement says so much: a pair of states
PLACE, SPEED = 0, 2  # the first of the pair that a position says, and a velocity
_ADJUGATE: Final = np.array([[1.0, -1.0], [-1.0, 1.0]])  # signs of a 2 x 2 matrix's adjugate


class BankState(NamedTuple):
    """All of a bank: means (m, n), covariances (m, n, n), probabilities (m,)."""

    means: FloatArray
    covariances: FloatArray
    probabilities: FloatArray


class ModelTransition(NamedTuple):
    """How the models move: F and Q (m, n, n), and what is added to the means (m, n)."""

    F: FloatArray
    Q: FloatArray
    moved: FloatArray


class Innovation(NamedTuple):
    """A measurement minus what each model expected (m, 2), with its covariance (m, 2, 2).

    `shared` (m, n, 2) is the states' covariance with what was measured.
    """

    y: FloatArray
    S: FloatArray
    shared: FloatArray


class Blend(NamedTuple):
    """One mean (g, n) and covariance (g, n, n) for all models of each group."""

    mean: FloatArray
    covariance: FloatArray


def mix(state: BankState, chances: FloatArray) -> BankState:
    """What each model starts from, given the chances of a change."""
    probabilities = state.probabilities @ chances
    weights = (state.probabilities[:, None] * chances / probabilities).T
    means = weights @ state.means
    away = state.means - means[:, None, :]
    m, n = state.means.shape
    covariances = (weights @ state.covariances.reshape(m, n * n)).reshape(m, n, n)
    covariances += (away * weights[:, :, None]).transpose(0, 2, 1) @ away
    return BankState(means, covariances, probabilities)


def advance(state: BankState, step: ModelTransition) -> BankState:
    """Every model moved by itself, without a change of models."""
    means = (step.F @ state.means[:, :, None])[:, :, 0] + step.moved
    covariances = step.F @ state.covariances @ step.F.transpose(0, 2, 1)
    covariances += step.Q
    return BankState(means, covariances, state.probabilities)


def innovation(state: BankState, z: FloatArray, R: FloatArray, pairs: Sequence[int] = (PLACE,)) -> Innovation:
    """Of a measurement z (m, 2) with noise R (m, 2, 2) for each model.

    It is of a sum of pairs of states; `pairs` are the first of each.
    """
    first, *more = (slice(pair, pair + _SEEN) for pair in pairs)
    expected, shared = state.means[:, first], state.covariances[:, :, first]
    for pair in more:
        expected, shared = expected + state.means[:, pair], shared + state.covariances[:, :, pair]
    S = shared[:, first]
    for pair in more:
        S = S + shared[:, pair]
    return Innovation(z - expected, S + R, shared)


class ModelBank:
    """m models in g groups, of each of which nothing is known at first."""

    def __init__(self, groups: Sequence[slice], dwell_s: float) -> None:
        """`groups`: each one's models, in order."""
        self._groups, self._dwell_s = groups, dwell_s
        sizes = np.array([group.stop - group.start for group in groups])
        self.group_of = np.repeat(np.arange(len(groups)), sizes)
        self._members = np.equal.outer(np.arange(len(groups)), self.group_of).astype(np.float64)
        self._prior = 1.0 / sizes[self.group_of]
        self._change = self._members[self.group_of] * self._prior
        self._state: BankState | None = None

    def start(self, means: FloatArray, covariances: FloatArray) -> None:
        """From the means (g, n) of each group and the covariances (m, n, n) of each model."""
        self._state = BankState(means[self.group_of], covariances, self._prior)

    @property
    def state(self) -> BankState:
        """All of it, once started."""
        assert self._state is not None
        return self._state

    @property
    def started(self) -> bool:
        """Whether anything is known."""
        return self._state is not None

    def restore(self, state: BankState | None) -> None:
        """Go on from a state; None: of nothing."""
        self._state = state

    def widen(self, variances: FloatArray) -> None:
        """Add a pair of states that is correlated with none so far: mean 0, variances (m, 2)."""
        m, n = self.state.means.shape
        means, covariances = np.zeros((m, n + _SEEN)), np.zeros((m, n + _SEEN, n + _SEEN))
        means[:, :n], covariances[:, :n, :n] = self.state.means, self.state.covariances
        covariances[:, range(n, n + _SEEN), range(n, n + _SEEN)] = variances
        self._state = BankState(means, covariances, self.state.probabilities)

    def predict(self, dt_s: float, step: ModelTransition) -> None:
        """Mix within each group, then move every model."""
        self._state = advance(mix(self.state, self.change_chances(dt_s)), step)

    def change_chances(self, dt_s: float) -> FloatArray:
        """Chance (m, m) that the model of a row has become that of a column after dt_s.

        A motion keeps its model for `dwell_s` in the mean, then draws one of its group, each as likely. Two
        steps give what one of their sum gives, so irregular frames need no care.
        """
        stay = math.exp(-dt_s / self._dwell_s)
        chances: FloatArray = (1.0 - stay) * self._change
        chances.reshape(-1)[:: len(chances) + 1] += stay
        return chances

    def blend(self, state: BankState) -> Blend:
        """The first two moments of each group's mixture, of a state or of a part of it."""
        m, n = state.means.shape
        weights = self._members * state.probabilities
        mean = weights @ state.means
        away = state.means - mean.take(self.group_of, axis=0)
        spread = state.covariances + away[:, :, None] * away[:, None, :]
        return Blend(mean, (weights @ spread.reshape(m, n * n)).reshape(-1, n, n))

    def update(self, seen: Innovation, group: int | None = None) -> None:
        """Take a measurement; the models that expected it gain. `group`: of that group alone."""
        if group is None:
            self._state = self._corrected(self.state, seen, self._groups)
            return
        models = self._groups[group]
        part = BankState(*(array[models] for array in self.state))
        part = self._corrected(part, Innovation(*(array[models] for array in seen)), [slice(None)])
        whole = BankState(*(array.copy() for array in self.state))
        for array, changed in zip(whole, part, strict=True):
            array[models] = changed
        self._state = whole

    @staticmethod
    def _corrected(state: BankState, seen: Innovation, groups: Sequence[slice]) -> BankState:
        """x + K y, P - K S K' with K = P H' S^-1; S^-1 by Cramer's rule."""
        y, S = seen.y[:, :, None], seen.S
        a, b, c, d = S.reshape(-1, _SEEN * _SEEN).T
        volume = a * d - b * c
        inverse = S[:, ::-1, ::-1] * _ADJUGATE / volume[:, None, None]
        weighed = inverse @ y
        means = state.means + (seen.shared @ weighed)[:, :, 0]
        covariances = state.covariances - seen.shared @ inverse @ seen.shared.transpose(0, 2, 1)
        # this form, unlike Joseph's, makes more of what rounding has left unsymmetric
        covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
        north, east = (seen.y * weighed[:, :, 0]).T
        unlikely = north + east + np.log(volume)
        return BankState(means, covariances, _gained(state.probabilities, unlikely, groups))


def _gained(probabilities: FloatArray, unlikely: FloatArray, groups: Sequence[slice]) -> FloatArray:
    """The probabilities after a measurement; `unlikely`: -2 ln(likelihood) + constant.

    In plain floats: arrays so small cost more than their sums.
    """
    before, misfits, after = probabilities.tolist(), unlikely.tolist(), []
    for models in groups:
        # of each group's likeliest model 1, so that no surprise underflows
        least = min(misfits[models])
        weights = [
            p * math.exp(0.5 * (least - u)) for p, u in zip(before[models], misfits[models], strict=True)
        ]
        total = sum(weights)
        after += [weight / total for weight in weights]
    return np.array(after)
