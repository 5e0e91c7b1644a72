"""What the estimate stage gives: the vehicle's state, and the pad's relative to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from companion.base.geometry import ZERO3, Quaternion, Vector3, scale
from companion.base.motion import Motion


@dataclass(frozen=True, slots=True)
class InputUse:
    """How many measurements of an input the estimator has used and refused since its start.

    `refused_in_a_row` counts since the last one used; `reason` is why the last one was refused, "" for none.
    """

    name: str
    used: int
    refused: int
    refused_in_a_row: int
    reason: str


@dataclass(frozen=True, slots=True)
class EstimatorInputs:
    """What became of the estimator's inputs until time_s."""

    time_s: float
    inputs: tuple[InputUse, ...]


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The vehicle at time_s by the 31-state EKF.

    `position_ned_m` counts from `origin` (latitude deg, longitude deg, altitude m), which is the first GPS
    fix and None before it. Over the time since the newest IMU sample, `imu_age_s`, it is predicted, and over
    what the link is known to be late by besides.
    `side_force_ned_m_s2` is the part of the acceleration that no thrust makes (see `geometry.side_force`),
    `acceleration_density_m2_s3` the density of the accelerometer's noise on an axis, lately.
    """

    time_s: float
    attitude: Quaternion
    rate_body_rad_s: Vector3
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    gyro_bias_rad_s: Vector3
    accel_bias_m_s2: Vector3
    attitude_std_rad: float
    velocity_std_m_s: float
    position_std_m: float
    aligned: bool
    has_gps: bool
    origin: Vector3 | None = None
    imu_age_s: float = 0.0
    side_force_ned_m_s2: Vector3 = ZERO3
    acceleration_density_m2_s3: float = 0.0

    @property
    def sensed_time_s(self) -> float:
        """When the newest IMU sample was, by which the estimate goes."""
        return self.time_s - self.imu_age_s


@dataclass(frozen=True, slots=True)
class PadState:
    """The pad at time_s by the relative-motion filter; plan and control use this form, and no other.

    Relative means pad minus vehicle (reference point), NED axes: straight above the pad the relative
    position is (0, 0, +height). `covariance`, six rows of six, is that of relative position and velocity,
    the horizon's and the calibration's errors included. `turn_rate_rad_s` is that of the pad's course,
    `jerk_ned_m_s3` what its acceleration changes by beyond turning, `models` the probability of each model
    of its motion. `delay_s` is how long after its exposure the last sighting came, as the planner notes it.

    `seen_velocity_ned_m_s` is the relative velocity without what the vehicle has accelerated since the last
    sighting: where something else than the air pushed it, as at a contact, the pad may have been pushed too.

    The tilt is the horizontal part (north, east) of the pad's normal, which points down: rad while it is
    small. It swings about its mean by `tilt_swing_rad` (root mean square, both axes together) at
    `tilt_frequency_rad_s`; 0: it does not.
    """

    time_s: float
    relative_position_ned_m: Vector3
    relative_velocity_ned_m_s: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3
    heading_rad: float
    heading_rate_rad_s: float
    position_std_m: float
    velocity_std_m_s: float
    seen_time_s: float
    covariance: tuple[tuple[float, ...], ...] = field(default=(), metadata={"columns": 6})
    turn_rate_rad_s: float = 0.0
    jerk_ned_m_s3: Vector3 = ZERO3
    models: dict[str, float] = field(default_factory=dict)
    delay_s: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    tilt_rate_rad_s: tuple[float, float] = (0.0, 0.0)
    tilt_mean_rad: tuple[float, float] = (0.0, 0.0)
    tilt_swing_rad: float = 0.0
    tilt_frequency_rad_s: float = 0.0
    seen_velocity_ned_m_s: Vector3 = ZERO3

    @property
    def height_m(self) -> float:
        """Height (m) of the vehicle's reference point over the pad."""
        return self.relative_position_ned_m[2]

    @property
    def clearance_m(self) -> float:
        """Distance (m) of the vehicle's reference point from the pad's plane, along its normal.

        Of a vehicle that stands on a deck that rocks it stays the same, wherever the vehicle stands.
        """
        (north, east, down), (tilt_n, tilt_e) = self.relative_position_ned_m, self.tilt_rad
        upright = math.sqrt(max(0.0, 1.0 - tilt_n * tilt_n - tilt_e * tilt_e))
        return tilt_n * north + tilt_e * east + upright * down

    @property
    def sink_m_s(self) -> float:
        """Speed (m/s) at which that height decreases."""
        return -self.relative_velocity_ned_m_s[2]

    @property
    def lateral_m(self) -> float:
        """Horizontal distance (m) between the vehicle's reference point and the pad's centre."""
        return math.hypot(self.relative_position_ned_m[0], self.relative_position_ned_m[1])

    @property
    def lateral_speed_m_s(self) -> float:
        """Horizontal speed (m/s) between the two."""
        return math.hypot(self.relative_velocity_ned_m_s[0], self.relative_velocity_ned_m_s[1])

    @property
    def height_std_m(self) -> float:
        """Standard deviation (m) of `height_m`; without a covariance it is not known at all."""
        return math.sqrt(max(0.0, self.covariance[2][2])) if self.covariance else math.inf

    def lateral_std_m(self, ahead_s: float = 0.0) -> float:
        """Standard deviation (m) of the horizontal relative position on an axis, `ahead_s` from `time_s`.

        At constant relative velocity; the mean of both axes' variances. 0 without a covariance.
        """
        if not self.covariance:
            return 0.0
        P = self.covariance
        variances = (P[k][k] + 2.0 * ahead_s * P[k][k + 3] + ahead_s**2 * P[k + 3][k + 3] for k in (0, 1))
        return math.sqrt(max(0.0, 0.5 * sum(variances)))

    @property
    def age_s(self) -> float:
        """Time (s) since the exposure in which the pad was last seen."""
        return max(0.0, self.time_s - self.seen_time_s)

    @property
    def unseen_s(self) -> float:
        """Time (s) since the last sighting came: its age without the camera's and the vision's delay."""
        return max(0.0, self.age_s - self.delay_s)

    @property
    def vehicle_from_pad(self) -> Motion:
        """The vehicle, without acceleration, in the frame of a `Reference` with origin "pad".

        A place in that frame counts from the pad, so it is minus the relative position.
        """
        return Motion(scale(self.relative_position_ned_m, -1.0), scale(self.relative_velocity_ned_m_s, -1.0))
