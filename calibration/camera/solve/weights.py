"""Weights of the views by the variance of their reprojection errors. Pure.

A view that is near, in focus and at rest has more precise corners, and determines most of the camera. With
equal weights the result is less precise than it could be, and its stated uncertainty is too large. So the
weight of a view is the inverse variance of its own errors. Few corners estimate a variance poorly, so it is
shrunk towards the common variance: more if there are fewer corners or the views are more alike (Smyth's
empirical Bayes variances, 2004).

Outliers are removed before. Weights have a lower bound, because a wrong model shows in some views more than
in others, and those must keep their say.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import digamma, polygamma

from calibration.camera.solve.adjustment import CameraSolution, normal_equations, refine, solve_scaled
from companion.base.geometry import FloatArray

ROUNDS: Final = 4
SMALLEST_CHANGE: Final = 0.01  # of a weight
# a view that is farther off than this is not less sharp: the model does not fit it, which is to be seen
SMALLEST_WEIGHT: Final = 0.25
# views as like as if their common variance were known from so many errors are taken as alike
MOST_FREEDOM: Final = 1e4
FEWEST_FREEDOM: Final = 1.0
HALVINGS: Final = 60


def weighted(solution: CameraSolution) -> CameraSolution:
    """Refit with each view weighted by its own error variance.

    Raises:
        UnsolvableError: the views leave some of the parameters undetermined.
    """
    for _ in range(ROUNDS):
        weights = view_weights(solution)
        before = np.array([seen.weight for seen in solution.seen])
        pairs = zip(solution.seen, weights.tolist(), strict=True)
        seen = tuple(replace(view, weight=weight) for view, weight in pairs)
        solution = refine(replace(solution, seen=seen))
        if float(np.abs(weights / before - 1.0).max()) < SMALLEST_CHANGE:
            break
    return solution


def view_weights(solution: CameraSolution) -> FloatArray:
    """The weight of each view; 1 at the common variance.

    Raises:
        UnsolvableError: as `weighted`.
    """
    information = [normal_equations(solution.camera, solution.surface, s).information for s in solution.seen]
    total = np.sum(information, axis=0)
    inverse = solve_scaled(total, np.eye(len(total)))
    # numbers that a view has fitted to its own errors: its pose, and its share of those that are common
    fitted = 6.0 + np.array([np.sum(inverse * share) for share in information])
    freedom = np.maximum(np.array([s.errors_px.size for s in solution.seen]) - fitted, FEWEST_FREEDOM)
    squares = np.array([np.sum(s.errors_px**2) for s in solution.seen])
    # corners without any error at all are no reason to divide by nought
    variances = np.maximum(squares / freedom, 1e-6 * np.sum(squares) / np.sum(freedom) + 1e-18)
    usual, of_usual = empirical_bayes_variance(variances, freedom)
    weights = usual * (freedom + of_usual) / (freedom * variances + of_usual * usual)
    return np.asarray(np.maximum(weights, SMALLEST_WEIGHT))


def empirical_bayes_variance(variances: FloatArray, freedom: FloatArray) -> tuple[float, float]:
    """The usual one of variances, each with so many degrees of freedom, and how many it is worth itself.

    If true variances are usual · n / χ²(n), then logarithms of those found scatter by ψ'(n/2) more than by
    the ψ'(freedom/2) of chance.
    """
    logs = np.log(variances) - digamma(0.5 * freedom) + np.log(0.5 * freedom)
    excess = float(np.var(logs, ddof=1) - np.mean(polygamma(1, 0.5 * freedom)))
    worth = MOST_FREEDOM
    if excess > float(polygamma(1, 0.5 * MOST_FREEDOM)):
        low, high = 1e-3, MOST_FREEDOM
        for _ in range(HALVINGS):
            worth = float(np.sqrt(low * high))
            low, high = (worth, high) if float(polygamma(1, 0.5 * worth)) > excess else (low, worth)
    return float(np.exp(np.mean(logs) + digamma(0.5 * worth) - np.log(0.5 * worth))), worth
