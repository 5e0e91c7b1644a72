"""What a kind of measurement of the pad says of itself; the filter takes all but sightings by this alone.

A new kind is one file, which turns its message to NED, and a line in `observation_kinds`. Its errors are said
here, for they decide what it is worth: noise from one to the next is averaged out, an error that all of a
source have in common never is. NED, SI units. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import ZERO3, FloatArray, Quaternion, Vector3
from companion.estimate.motion import VehiclePlace
from companion.estimate.pad.model_bank import ModelTransition

FIRST: Final = 8  # the states before those of common errors are the pad's
NO_AXIS_M2: Final = 1.0  # the vertical has no second axis, on which all models expect the same


class CommonError(NamedTuple):
    """What all positions of a source are off by alike: a Gauss-Markov process of this standard deviation (m).

    It has forgotten itself after `lasts_s`. A receiver's metres change over a minute. Taken for noise, many
    fixes would average them away and outweigh sightings. So the filter has them as states beside the pad's:
    with the covariance that they gather with these they are found by the first sighting, and what a fix then
    says is worth as little as its error has wandered since.
    """

    source: str
    std_ned_m: Vector3
    lasts_s: float

    @property
    def variances_m2(self) -> FloatArray:
        """Of the plane's and the vertical's pair of states (2, 2)."""
        north, east, down = self.std_ned_m
        return np.array([[north**2, east**2], [down**2, NO_AXIS_M2]])


class RelativeVelocity(NamedTuple):
    """The pad's velocity minus the vehicle's (m/s, NED), and its standard deviations."""

    velocity_ned_m_s: Vector3
    std_ned_m_s: Vector3


@dataclass(frozen=True, slots=True)
class RelativeFix:
    """A measurement that no camera made: it starts the filter and carries it while the pad is unseen.

    Args:
        gate: the name of its innovation test.
        position_ned_m: pad minus vehicle at the exposure.
        covariance_ned_m2: of the noise from one to the next alone (3, 3).
        vehicle_velocity_ned_m_s: at the exposure.
        vehicle_velocity_std_m_s: of that, axis by axis.
        relative_velocity: where the source measures that, too.
        common: what its positions are off by alike; None: nothing.
    """

    gate: str
    position_ned_m: Vector3
    covariance_ned_m2: FloatArray
    vehicle_velocity_ned_m_s: Vector3
    vehicle_velocity_std_m_s: Vector3 = ZERO3
    relative_velocity: RelativeVelocity | None = None
    common: CommonError | None = None


class VehicleAtExposure(NamedTuple):
    """The vehicle at an exposure.

    `jitter_rad2` is the variance of an angle on an axis by the exposure's jitter and the gyroscope's noise,
    `velocity_std_m_s` is axis by axis, `place()` the vehicle's on Earth, None without GPS.
    """

    time_s: float
    attitude: Quaternion
    jitter_rad2: float
    velocity_ned_m_s: Vector3
    velocity_std_m_s: Vector3
    place: Callable[[], VehiclePlace | None]


M = TypeVar("M")
Z = TypeVar("Z")


@dataclass(frozen=True)
class ObservationKind(Generic[M, Z]):
    """One kind.

    Args:
        name: of its innovation test, its tally and its log topic.
        message: the class in which it comes.
        numbers: all of a message that has to be finite.
        in_ned: a message and its exposure as the filter takes it; None: there it says nothing of the pad.
        by_camera: whether its stamps are late by what the camera's are.
    """

    name: str
    message: type[M]
    numbers: Callable[[M], Iterable[float]]
    in_ned: Callable[[M, VehicleAtExposure], Z | None]
    by_camera: bool = False


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
        Q[:, pair, pair] = (1.0 - keep * keep) * error.variances_m2.take(group_of, axis=0)
    return ModelTransition(F, Q, moved)
