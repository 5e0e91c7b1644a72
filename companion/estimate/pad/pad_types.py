"""What goes into the pad filter, its state, and its output: plain data.

NED, SI units. A snapshot is never written to again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import EYE3, ZERO3, FloatArray, Vector3, vector3
from companion.estimate.gating import Gate
from companion.estimate.motion import rotation_lever
from companion.estimate.pad.model_bank import BankState
from companion.estimate.pad.observation import CommonError, RelativeFix
from companion.estimate.pad.pad_models import Turn
from companion.estimate.pad.tilt_filter import AngleState, TiltState
from companion.estimate.pad.velocity_step import RefusedSighting

# where (position, velocity, acceleration) of the three axes are in both groups' means (2, 8), and their
# covariances in those (2, 8, 8); between the groups there is none, as on the vertical's second axis
STATES_AT: Final = np.array([8 * (axis // 2) + 2 * kind + axis % 2 for kind in range(3) for axis in range(3)])
_NONE: Final = 64 + 9  # an element that is zero: the vertical's first with its second axis
# see above
PAIRS_AT: Final = np.array(
    [
        [64 * (i // 8) + 8 * (i % 8) + j % 8 if i // 8 == j // 8 else _NONE for j in STATES_AT]
        for i in STATES_AT
    ]
)


@dataclass(frozen=True, slots=True)
class PadMeasurement:
    """A sighting turned to NED: pad minus vehicle at the exposure. Covariance (3, 3) in m², the attitude's
    fast share included.

    `slow_variance_m2` (each axis) is what all sightings of a while have in common, the calibration's error
    say: it is no noise to be averaged, and is not part of the covariance.
    """

    position_ned_m: Vector3
    covariance_ned_m2: FloatArray
    heading_rad: float
    heading_std_rad: float
    vehicle_velocity_ned_m_s: Vector3 = ZERO3
    vehicle_velocity_std_m_s: Vector3 = ZERO3  # axis by axis
    slow_variance_m2: float = 0.0
    tilt_rad: tuple[float, float] | None = None  # as of `TiltState`
    tilt_std_rad: float = 0.0

    @property
    def slow_share(self) -> float:
        """The slow error's standard deviation as a share of the distance."""
        x, y, z = self.position_ned_m
        return math.sqrt(self.slow_variance_m2 / max(x * x + y * y + z * z, 1e-6))


HIGHEST_ECHO_M: Final = 2.5  # an ultrasonic's cone of 30° is then 1.3 m wide, as a pad is


@dataclass(frozen=True, slots=True)
class HeightMeasurement:
    """Height (m) of the range sensor over what lies under it, and the sensor's offset in NED axes (m)."""

    height_m: float
    sensor_offset_ned_m: Vector3
    noise_m: float


PadInput = PadMeasurement | HeightMeasurement | RelativeFix


class PadSnapshot(NamedTuple):
    """All of the filter; the arrays are never written to again."""

    time_s: float
    models: BankState | None
    turn: Turn
    heading: AngleState
    gates: dict[str, Gate]
    seen_time_s: float
    slow_share: float
    tilt: TiltState
    refused: tuple[RefusedSighting, ...]
    before_step: PadSnapshot | None
    observed_time_s: float
    common: tuple[CommonError, ...]


@dataclass(frozen=True, slots=True)
class CombinedEstimate:
    """The models' estimates combined at a time: x (9,) and P (9, 9), heading (rad), its rate (rad/s).

    x is relative position and relative velocity (pad minus vehicle) and the pad's acceleration, NED.

    P is the filter's own; `covariance` adds what all of its measurements have in common. `slow_share` is the
    calibration's error as a share of the distance, `models` the probability of each model of motion by name.
    `jerk_m_s3` (north, east) is what the acceleration changes by beyond turning.
    """

    x: FloatArray
    P: FloatArray
    heading_rad: float
    heading_rate_rad_s: float
    seen_time_s: float
    turn_rate_rad_s: float
    slow_share: float
    models: dict[str, float]
    tilt: TiltState
    jerk_m_s3: tuple[float, float]
    observed_time_s: float

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the relative position, all axes together."""
        return math.sqrt(self.position_variance_m2)

    @property
    def position_variance_m2(self) -> float:
        """Of the relative position, all axes together; of a filter that has diverged it may be any number."""
        return float(self.P[0, 0] + self.P[1, 1] + self.P[2, 2])

    def covariance(self, rotation_covariance: FloatArray, wander_rad_s: float) -> FloatArray:
        """Of relative position and velocity (6, 6), with the errors that no averaging takes away.

        A horizon that is off (rotation_covariance (3, 3), about NED axes, rad²) turns position and velocity
        alike. One that wanders, and a calibration that is off, give a vehicle at rest a velocity.
        """
        position, velocity = self.x[0:3], self.x[3:6]
        swings = np.concatenate((rotation_lever(vector3(position)), rotation_lever(vector3(velocity))))
        total = self.P[:6, :6] + swings @ rotation_covariance @ swings.T
        total[3:, 3:] += wander_rad_s**2 * (swings[:3] @ rotation_covariance @ swings[:3].T)
        share = self.slow_share**2
        total[:3, :3] += share * float(position @ position) * EYE3
        total[3:, 3:] += share * float(velocity @ velocity) * EYE3
        return total
