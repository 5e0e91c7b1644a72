"""Interacting multiple models (IMM) on filterpy: Kalman filters of one state that share their uncertainty.

Every model has the same state and sees the same measurement, but moves it by its own F and Q. Before a step
each model starts from the blend of all that the chance of a change to it gives; after a measurement the
models' probabilities follow from how well each expected it (Bar-Shalom, Li and Kirubarajan 2001, 11.6.6).

filterpy's cost is in its calls, not in its sums, and its own `IMMEstimator` blends in Python loops. So the
models are combined here in one `KalmanFilter` whose matrices are block-diagonal, and are blended by
array operations: the same numbers (a test compares them with `IMMEstimator`'s) at a fraction of the time.

Arrays: m models of an n-state, means (m, n), covariances (m, n, n), probabilities (m,). Nothing that a
`BankState` holds is ever written to again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.lib.stride_tricks import as_strided

from companion.base.geometry import FloatArray


class BankState(NamedTuple):
    """All of a bank: means (m, n), covariances (m, n, n), probabilities (m,)."""

    means: FloatArray
    covariances: FloatArray
    probabilities: FloatArray


class ModelTransition(NamedTuple):
    """How the models move: F and Q (m, n, n), and what is added to every mean (n,)."""

    F: FloatArray
    Q: FloatArray
    moved: FloatArray


class Blend(NamedTuple):
    """One mean (n,) and covariance (n, n) for all models."""

    mean: FloatArray
    covariance: FloatArray


def blend(state: BankState) -> Blend:
    """The mixture's first two moments."""
    mean = state.probabilities @ state.means
    away = state.means - mean
    m, n = state.means.shape
    own = (state.probabilities @ state.covariances.reshape(m, n * n)).reshape(n, n)
    return Blend(mean, own + (away.T * state.probabilities) @ away)


def change_chances(prior: FloatArray, dwell_s: float, dt_s: float) -> FloatArray:
    """Chance (m, m) that the model of a row has become that of a column after dt_s.

    A motion keeps its model for `dwell_s` in the mean, then draws one from the prior. Two steps give what one
    of their sum gives, so irregular frames need no care.
    """
    stay = math.exp(-dt_s / dwell_s)
    chances: FloatArray = (1.0 - stay) * prior + stay * np.eye(len(prior))
    return chances


def mix(state: BankState, chances: FloatArray) -> BankState:
    """What each model starts from, given the chances of a change."""
    joint = state.probabilities[:, None] * chances
    probabilities = joint.sum(axis=0)
    weights = (joint / probabilities).T
    means = weights @ state.means
    away = state.means[None, :, :] - means[:, None, :]
    m, n = state.means.shape
    covariances = (weights @ state.covariances.reshape(m, n * n)).reshape(m, n, n)
    covariances += (away * weights[:, :, None]).transpose(0, 2, 1) @ away
    return BankState(means, covariances, probabilities)


def advance(state: BankState, step: ModelTransition) -> BankState:
    """Every model moved by itself, without a change of models: for predictions."""
    means = (step.F @ state.means[:, :, None])[:, :, 0] + step.moved
    return BankState(
        means, step.F @ state.covariances @ step.F.transpose(0, 2, 1) + step.Q, state.probabilities
    )


class ModelBank:
    """m models of n states that measure k of them: one block-diagonal filterpy filter."""

    def __init__(self, prior: FloatArray, dwell_s: float, state_size: int, seen: int) -> None:
        """`seen`: the first so many states are what a measurement says; 1 or 2."""
        m, n, k = len(prior), state_size, seen
        self._prior, self._dwell_s = prior, dwell_s
        self._m, self._n, self._k = m, n, k
        self._filter = KalmanFilter(dim_x=m * n, dim_z=m * k)
        # what moves one state moves all models' states, and one measurement is everyone's
        self._filter.B = np.tile(np.eye(n), (m, 1))
        self._filter.H = np.kron(np.eye(m), np.eye(k, n))
        self._P, self._F, self._Q = (_Blocks(m, n) for _ in range(3))
        self._R, self._z = _Blocks(m, k), np.zeros((m, k, 1))
        self._state = BankState(np.zeros((m, n)), np.zeros((m, n, n)), prior)
        self._loaded: BankState | None = None

    def start(self, mean: FloatArray, covariances: FloatArray) -> None:
        """One mean (n,) for all models, and each one's covariance (m, n, n)."""
        self._state = BankState(np.tile(mean, (self._m, 1)), covariances, self._prior)

    @property
    def state(self) -> BankState:
        """All of it."""
        return self._state

    def restore(self, state: BankState) -> None:
        """Go on from a state."""
        self._state = state

    def predict(self, dt_s: float, step: ModelTransition) -> None:
        """Blend, then move every model."""
        mixed = mix(self._state, change_chances(self._prior, self._dwell_s, dt_s))
        self._load(mixed)
        self._F.view[...], self._Q.view[...] = step.F, step.Q
        self._filter.predict(u=step.moved[:, None], F=self._F.matrix, Q=self._Q.matrix)
        self._take(mixed.probabilities)

    def update(self, z: FloatArray, R: FloatArray) -> None:
        """Take a measurement (k,) with noise (k, k); the models that expected it gain."""
        self._load(self._state)
        self._z[...], self._R.view[...] = z[:, None], R
        self._filter.update(self._z.reshape(-1, 1), R=self._R.matrix)
        weights = self._state.probabilities * self._likelihoods()
        self._take(weights / weights.sum())

    def _load(self, state: BankState) -> None:
        if state is not self._loaded:
            self._P.view[...] = state.covariances
            self._filter.x, self._filter.P = state.means.reshape(-1, 1), self._P.matrix

    def _take(self, probabilities: FloatArray) -> None:
        means = self._filter.x.reshape(self._m, self._n)
        self._state = BankState(means, self._P.of(self._filter.P), probabilities)
        self._loaded = self._state

    def _likelihoods(self) -> FloatArray:
        """Of the last measurement by each model (m,), the greatest 1, so that no surprise underflows."""
        # plain floats: arrays of two cost more than their sums
        misses = self._filter.y.reshape(self._m, self._k).tolist()
        spreads = self._R.of(self._filter.S).tolist()
        logarithms = [_log_likelihood(y, S) for y, S in zip(misses, spreads, strict=True)]
        best = max(logarithms)
        return np.array([math.exp(value - best) for value in logarithms])


def _log_likelihood(y: list[float], S: list[list[float]]) -> float:
    """Of a miss of one or two numbers, but for a constant."""
    if len(y) == 1:
        return -0.5 * (y[0] * y[0] / S[0][0] + math.log(S[0][0]))
    (a, b), (_, c) = S
    volume = a * c - b * b
    return -0.5 * ((c * y[0] * y[0] - 2.0 * b * y[0] * y[1] + a * y[1] * y[1]) / volume + math.log(volume))


class _Blocks:
    """A block-diagonal matrix, its m blocks as a view (m, n, n), and the same blocks of other matrices."""

    def __init__(self, m: int, n: int) -> None:
        self.matrix = np.zeros((m * n, m * n))
        down, along = self.matrix.strides
        self.view = as_strided(self.matrix, (m, n, n), (n * (down + along), down, along))
        rows = np.arange(m * n).reshape(m, n)
        self._places = rows[:, :, None] * (m * n) + rows[:, None, :]

    def of(self, matrix: FloatArray) -> FloatArray:
        """A copy of a matrix's blocks."""
        return matrix.take(self._places)
