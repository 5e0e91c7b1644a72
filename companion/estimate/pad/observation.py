"""What a kind of measurement of the pad says of itself; the filter takes every kind by this alone.

A new kind is one file, which turns its message to NED, and a line in `observation_kinds`. Its errors are said
here, for they decide what it is worth: noise from one to the next is averaged out, an error that all of a
source have in common never is. NED, SI units. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from companion.base.geometry import FloatArray, Quaternion, Vector3
from companion.estimate.motion import VehiclePlace


class CommonError(NamedTuple):
    """What all positions of a source are off by alike: it wanders with this standard deviation (m, an axis).

    It has forgotten itself after `lasts_s`. The filter estimates it beside the pad.
    """

    source: str
    std_ned_m: Vector3
    lasts_s: float


class RelativeVelocity(NamedTuple):
    """The pad's velocity minus the vehicle's (m/s, NED), and its standard deviations."""

    velocity_ned_m_s: Vector3
    std_ned_m_s: Vector3


class Observation(Protocol):
    """A measurement as the filter takes it: pad minus vehicle at the exposure, NED."""

    @property
    def gate(self) -> str:
        """The name of its innovation test."""
        ...

    @property
    def position_ned_m(self) -> Vector3:
        """The relative position (m)."""
        ...

    @property
    def covariance_ned_m2(self) -> FloatArray:
        """Of the noise from one to the next alone (3, 3), m²."""
        ...

    @property
    def vehicle_velocity_ned_m_s(self) -> Vector3:
        """The vehicle's velocity at the exposure (m/s)."""
        ...

    @property
    def relative_velocity(self) -> RelativeVelocity | None:
        """The relative velocity, where the source measures that, too."""
        ...

    @property
    def common(self) -> CommonError | None:
        """What its positions are off by alike; None: nothing."""
        ...


class VehicleAtExposure(NamedTuple):
    """The vehicle at an exposure.

    `jitter_rad2` is the variance of an angle on an axis by the exposure's jitter and the gyroscope's noise,
    `place()` the vehicle's on Earth, None without GPS.
    """

    time_s: float
    attitude: Quaternion
    jitter_rad2: float
    velocity_ned_m_s: Vector3
    place: Callable[[], VehiclePlace | None]


class Timed(Protocol):
    """A message with the time of its exposure."""

    @property
    def time_s(self) -> float:
        """When it was measured (s)."""
        ...


M = TypeVar("M", bound=Timed)
Z = TypeVar("Z", bound=Observation)


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
