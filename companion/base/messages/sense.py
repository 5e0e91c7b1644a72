"""What the sense stage gives: samples, frames, and the pad as one frame shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from companion.base.geometry import ZERO3, FloatArray, Quaternion, Vector3

MarkerGroup = Literal["F", "M", "C"]


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One gyroscope and accelerometer sample; at rest and level the specific force is (0, 0, -9.8).

    `interval_s` is the time since the sample before by the sensor's own clock, None where the difference of
    the times is that. A time that was turned from another clock into ours has that mapping's jitter in it,
    an interval has not.
    """

    time_s: float
    rate_body_rad_s: Vector3
    specific_force_body_m_s2: Vector3
    temperature_c: float
    interval_s: float | None = None


@dataclass(frozen=True, slots=True)
class MagSample:
    """One magnetometer sample in body axes, after the factory's sensitivity adjustment."""

    time_s: float
    field_body_ut: Vector3


@dataclass(frozen=True, slots=True)
class GpsFix:
    """One three-dimensional fix (no fix is no message). Altitude (m) is above mean sea level.

    Of a receiver that sends NAV-SOL alone it is above the ellipsoid; its driver says so, and
    `vertical_accuracy_m` contains what the two may differ by.
    `vertical_speed_accuracy_m_s` is given when it differs from `speed_accuracy_m_s`: a source without a
    vertical speed gives 0 with an accuracy that says so.
    """

    time_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    velocity_ned_m_s: Vector3
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_m_s: float
    satellites: int
    vertical_speed_accuracy_m_s: float | None = None


@dataclass(frozen=True, slots=True)
class RangeSample:
    """One echo of the downward ultrasonic, along the sensor's axis."""

    time_s: float
    distance_m: float


@dataclass(frozen=True, slots=True)
class AutopilotAttitude:
    """The autopilot's own attitude (body to its NED), when it measured it on our clock.

    `same_imu`: our samples are its IMU's too, by telemetry. `round_trip_s` is the link's; 0: not known.
    """

    time_s: float
    attitude: Quaternion
    same_imu: bool = False
    round_trip_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """One grey image (height, width), 0 to 255; `time_s` is the middle of its exposure, at the middle row."""

    time_s: float
    received_s: float
    sequence: int
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PadPrior:
    """What the estimators expect of the pad at a frame's exposure; guides search and ambiguity, not pose.

    `pad_position_body_m`/`body_from_pad` are None when the pad's place is unknown; `down_body` is the
    gravity direction, a unit vector, and is known as soon as there is an attitude. `climb_m_s` is how fast
    the height over the pad is expected to change, `rate_body_rad_s` how the vehicle turns meanwhile.
    """

    time_s: float
    down_body: Vector3
    pad_position_body_m: Vector3 | None = None
    body_from_pad: Quaternion | None = None
    position_std_m: float = 1.0
    climb_m_s: float = 0.0
    rate_body_rad_s: Vector3 = ZERO3


@dataclass(frozen=True, slots=True)
class PadSighting:
    """The pad's pose by one frame, body axes: the pad's centre minus the vehicle's reference point, and turn.

    `covariance` is 6x6: position (m) then a small rotation about the body's axes (rad). Of each axis of the
    position's, `common_variance_m2` is no noise: the calibration's error, the same from frame to frame.
    """

    time_s: float
    sequence: int
    pad_position_body_m: Vector3
    body_from_pad: Quaternion
    covariance: FloatArray = field(metadata={"columns": 6})
    group: MarkerGroup
    marker_ids: tuple[int, ...]
    marker_count: dict[MarkerGroup, int]
    reprojection_error_px: float
    common_variance_m2: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameReport:
    """What became of a frame, seen or not: for the status line, the log and the score."""

    time_s: float
    received_s: float
    done_s: float
    sequence: int
    marker_count: dict[MarkerGroup, int]
    seen: bool
    searched_whole_frame: bool
