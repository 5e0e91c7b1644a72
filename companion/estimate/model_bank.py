"""Interacting multiple models (IMM) on filterpy: several Kalman filters of one state that share their doubts.

Every model has the same state and sees the same measurement, but moves it by its own F and Q. Before a step
each model starts from the blend of all that the chance of a change to it gives; after a measurement the
models' probabilities follow from how well each expected it (Bar-Shalom, Li and Kirubarajan 2001, 11.6.6).

filterpy's cost is in its calls, not in its sums, and its own `IMMEstimator` blends in Python loops. So the
models stand here side by side in one `KalmanFilter` whose matrices are block-diagonal, and are blended by
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

from companion.geometry import FloatArray


class BankState(NamedTuple):
    """All of a bank: means (m, n), covariances (m, n, n), probabilities (m,)."""

    means: FloatArray
    covariances: FloatArray
    probabilities: FloatArray


class Step(NamedTuple):
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
    chances: FloatArray = np.tile((1.0 - stay) * prior, (len(prior), 1))
    chances.flat[:: len(prior) + 1] += stay
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


def advance(state: BankState, step: Step) -> BankState:
    """Every model moved by itself, without a change of models: for predictions."""
    means = (step.F @ state.means[:, :, None])[:, :, 0] + step.moved
    return BankState(means, step.F @ state.covariances @ step.F.transpose(0, 2, 1) + step.Q, state.probabilities)


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
        self._F, self._Q = np.zeros((m * n, m * n)), np.zeros((m * n, m * n))
        self._R, self._z = np.zeros((m * k, m * k)), np.zeros((m * k, 1))
        empty = np.zeros((m, n, n))
        self._state = BankState(np.zeros((m, n)), empty, prior)

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

    def expected(self) -> Blend:
        """What a measurement should say, and how far the bank doubts it: (k,), (k, k)."""
        means, covariances, probabilities = self._state
        k = self._k
        return blend(BankState(means[:, :k], covariances[:, :k, :k], probabilities))

    def predict(self, dt_s: float, step: Step) -> None:
        """Blend, then move every model."""
        m, n = self._m, self._n
        mixed = mix(self._state, change_chances(self._prior, self._dwell_s, dt_s))
        self._load(mixed)
        _blocks(self._F, m)[...], _blocks(self._Q, m)[...] = step.F, step.Q
        self._filter.predict(u=step.moved[:, None], F=self._F, Q=self._Q)
        self._state = BankState(
            self._filter.x.reshape(m, n), _blocks(self._filter.P, m).copy(), mixed.probabilities
        )

    def update(self, z: FloatArray, R: FloatArray) -> None:
        """Take a measurement (k,) with noise (k, k); the models that expected it gain."""
        m, n, k = self._m, self._n, self._k
        self._load(self._state)
        self._z.reshape(m, k)[...] = z
        _blocks(self._R, m)[...] = R
        self._filter.update(self._z, R=self._R)
        weights = self._state.probabilities * self._likelihoods()
        self._state = BankState(
            self._filter.x.reshape(m, n), _blocks(self._filter.P, m).copy(), weights / weights.sum()
        )

    def _load(self, state: BankState) -> None:
        P = np.zeros((self._m * self._n, self._m * self._n))
        _blocks(P, self._m)[...] = state.covariances
        self._filter.x, self._filter.P = state.means.reshape(-1, 1), P

    def _likelihoods(self) -> FloatArray:
        """Of the last measurement by each model (m,), the greatest 1, so that no surprise underflows."""
        m, k = self._m, self._k
        y = self._filter.y.reshape(m, k)
        S, SI = _blocks(self._filter.S, m), _blocks(self._filter.SI, m)
        distance = (y[:, None, :] @ SI @ y[:, :, None])[:, 0, 0]
        volume = S[:, 0, 0] if k == 1 else S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] * S[:, 1, 0]
        logarithm = -0.5 * (distance + np.log(volume))
        likelihoods: FloatArray = np.exp(logarithm - logarithm.max())
        return likelihoods


def _blocks(matrix: FloatArray, m: int) -> FloatArray:
    """The m blocks on the diagonal of a square matrix, as a view (m, size / m, size / m)."""
    size = len(matrix) // m
    down, along = matrix.strides
    return as_strided(matrix, (m, size, size), (size * (down + along), down, along))
