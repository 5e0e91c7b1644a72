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
    spread = state.covariances + away[:, :, None] * away[:, None, :]
    return Blend(mean, np.tensordot(state.probabilities, spread, 1))


def change_chances(prior: FloatArray, dwell_s: float, dt_s: float) -> FloatArray:
    """Chance (m, m) that the model of a row has become that of a column after dt_s.

    A motion keeps its model for `dwell_s` in the mean, then draws one from the prior. Two steps give what one
    of their sum gives, so irregular frames need no care.
    """
    stay = math.exp(-dt_s / dwell_s)
    chances: FloatArray = (1.0 - stay) * np.broadcast_to(prior, (len(prior), len(prior)))
    return chances + stay * np.eye(len(prior))


def mix(state: BankState, chances: FloatArray) -> BankState:
    """What each model starts from, given the chances of a change."""
    joint = state.probabilities[:, None] * chances
    probabilities = joint.sum(axis=0)
    weights = (joint / probabilities).T
    means = weights @ state.means
    away = state.means[None, :, :] - means[:, None, :]
    n = state.means.shape[1]
    own = (weights @ state.covariances.reshape(-1, n * n)).reshape(-1, n, n)
    # sqrt(w) on both factors makes the sum of outer products one symmetric product
    scaled = away * np.sqrt(weights)[:, :, None]
    return BankState(means, own + scaled.transpose(0, 2, 1) @ scaled, probabilities)


def advance(state: BankState, step: Step) -> BankState:
    """Every model moved by itself, without a change of models: for predictions."""
    means = (step.F @ state.means[:, :, None])[:, :, 0] + step.moved
    return BankState(means, step.F @ state.covariances @ step.F.transpose(0, 2, 1) + step.Q, state.probabilities)


class ModelBank:
    """m models of n states that measure k of them: one block-diagonal filterpy filter."""

    def __init__(self, prior: FloatArray, dwell_s: float, state_size: int, seen: int) -> None:
        """`seen`: the first so many states are what a measurement says."""
        m, n, k = len(prior), state_size, seen
        self._prior, self._dwell_s = prior, dwell_s
        self._m, self._n, self._k = m, n, k
        self._filter = KalmanFilter(dim_x=m * n, dim_z=m * k)
        self._filter.B = np.eye(m * n)
        self._filter.H = np.kron(np.eye(m), np.eye(k, n))
        self._blocks = np.arange(m)
        self._probabilities = prior

    def start(self, mean: FloatArray, covariances: FloatArray) -> None:
        """One mean (n,) for all models, and each one's covariance (m, n, n)."""
        self.restore(BankState(np.tile(mean, (self._m, 1)), covariances, self._prior))

    @property
    def state(self) -> BankState:
        """All of it."""
        m, n = self._m, self._n
        i = self._blocks
        covariances = self._filter.P.reshape(m, n, m, n)[i, :, i, :]
        return BankState(self._filter.x.reshape(m, n), covariances, self._probabilities)

    def restore(self, state: BankState) -> None:
        """Go on from a state."""
        self._filter.x = state.means.reshape(-1, 1)
        self._filter.P = self._diagonal(state.covariances)
        self._probabilities = state.probabilities

    def predict(self, dt_s: float, step: Step) -> None:
        """Blend, then move every model."""
        mixed = mix(self.state, change_chances(self._prior, self._dwell_s, dt_s))
        self.restore(mixed)
        u = np.tile(step.moved, self._m)[:, None]
        self._filter.predict(u=u, F=self._diagonal(step.F), Q=self._diagonal(step.Q))

    def update(self, z: FloatArray, R: FloatArray) -> None:
        """Take a measurement (k,) with noise (k, k); the models that expected it gain."""
        m, k = self._m, self._k
        noise = self._diagonal(np.broadcast_to(R, (m, k, k)))
        self._filter.update(np.tile(z, m)[:, None], R=noise)
        i = self._blocks
        y = self._filter.y.reshape(m, k)
        S = self._filter.S.reshape(m, k, m, k)[i, :, i, :]
        SI = self._filter.SI.reshape(m, k, m, k)[i, :, i, :]
        distance = (y[:, None, :] @ SI @ y[:, :, None])[:, 0, 0]
        log_likelihood = -0.5 * (distance + np.log(np.linalg.det(S)))
        weights = self._probabilities * np.exp(log_likelihood - log_likelihood.max())
        self._probabilities = weights / weights.sum()

    def _diagonal(self, blocks: FloatArray) -> FloatArray:
        m, rows, columns = blocks.shape
        matrix = np.zeros((m, rows, m, columns))
        matrix[self._blocks, :, self._blocks, :] = blocks
        return matrix.reshape(m * rows, m * columns)
