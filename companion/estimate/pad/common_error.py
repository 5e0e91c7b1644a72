"""What all positions of a source are off by alike, as states beside the pad's: a Gauss-Markov process each.

A receiver's metres change over a minute. Taken for noise, many fixes would average them away and outweigh
sightings; as a state, with the covariance that it gathers with the pad's, they are found by the first
sighting, and what a fix then says is worth as little as its error has wandered since. NED, SI units. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import FloatArray
from companion.estimate.pad.model_bank import ModelTransition
from companion.estimate.pad.observation import CommonError

FIRST: Final = 8  # the states before are the pad's
_NO_AXIS_M2: Final = 1e-12  # the vertical has no second axis


def variances_m2(error: CommonError) -> FloatArray:
    """Of the plane's and the vertical's pair of states (2, 2)."""
    north, east, down = error.std_ned_m
    return np.array([[north**2, east**2], [down**2, _NO_AXIS_M2]])


def with_common(
    step: ModelTransition, errors: Sequence[CommonError], dt_s: float, group_of: NDArray[np.intp]
) -> ModelTransition:
    """How the models move with these errors beside the pad, of whose states `step` is.

    An error fades to what it is on average, 0, and noise keeps its variance.
    """
    if not errors:
        return step
    m, n = step.moved.shape[0], FIRST + 2 * len(errors)
    F, Q, moved = np.zeros((m, n, n)), np.zeros((m, n, n)), np.zeros((m, n))
    F[:, :FIRST, :FIRST], Q[:, :FIRST, :FIRST], moved[:, :FIRST] = step
    for number, error in enumerate(errors):
        pair = range(FIRST + 2 * number, FIRST + 2 * number + 2)
        keep = math.exp(-dt_s / error.lasts_s)
        F[:, pair, pair] = keep
        Q[:, pair, pair] = (1.0 - keep * keep) * variances_m2(error).take(group_of, axis=0)
    return ModelTransition(F, Q, moved)
