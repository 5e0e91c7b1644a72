"""The autopilot's own IMU, compass, GPS receiver and rangefinder, for the sensor messages.

They are independent of the companion's sensors: other biases and noise, from generators of
their own. IMU, compass and rangefinder cost time at every step, so they are off until a client requests
one of their messages. Axes FRD (the autopilot has turned the mounting out), SI units, µT; pure.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from companion.base.geometry import ZERO3, Vector3, add, norm, quat_rotate_inverse, tilt_from_quat
from sitl.sensors.inertial import ImuSensor, SensorErrors, felt_at, moved_at
from sitl.sensors.sensors import BoardTruth, GpsReading, GpsSensor, MagSensor, RangeSensor
from sitl.vehicle.quadrotor import QuadrotorState, RotorValues

MAG_PERIOD_S: Final = 0.02
GPS_PERIOD_S: Final = 0.2
RANGE_PERIOD_S: Final = 0.05
_EARLY_S: Final = 1e-6
_FIX_LASTS_S: Final = 1.0
_STRAY_SHARE: Final = 0.35


class ImuReading(NamedTuple):
    """One IMU sample: specific force (m/s²) and rate (rad/s)."""

    time_s: float
    specific_force_m_s2: Vector3
    rate_rad_s: Vector3


class Field(NamedTuple):
    """One compass sample (µT)."""

    time_s: float
    field_ut: Vector3


class Fix(NamedTuple):
    """A receiver's epoch, and its arrival time at the autopilot."""

    time_s: float
    reading: GpsReading


class Echo(NamedTuple):
    """One ping: a distance (m), None without an echo."""

    time_s: float
    distance_m: float | None


class Pace:
    """When the next sample of a period is due: a late one is made up for, a long gap is not."""

    def __init__(self, period_s: float) -> None:
        self._period_s, self._due_s = period_s, -math.inf

    def due(self, now_s: float) -> bool:
        """Whether it is now; then the next one is a period later."""
        if now_s < self._due_s - _EARLY_S:
            return False
        self._due_s = max(self._due_s, now_s - self._period_s) + self._period_s
        return True


class SimulatedAutopilotSensors:
    """Step it with the physics; the newest of each sensor is in its attribute, None before the first."""

    def __init__(
        self,
        rng: np.random.Generator,
        dt_s: float,
        *,
        home: Vector3,
        field_ned_ut: Vector3,
        imu_filter: int,
        gps_latency_s: float = 0.12,
        antenna_body_m: Vector3 = (0.0, 0.0, -0.05),
        imu_position_body_m: Vector3 = ZERO3,
        errors: SensorErrors | None = None,
    ) -> None:
        """Make them; each draws from a generator of its own."""
        imu_rng, mag_rng, gps_rng, range_rng = rng.spawn(4)
        errors, body_axes = errors or SensorErrors(), np.eye(3)
        self.inertial = ImuSensor(errors.imu, imu_rng, dt_s, body_axes, imu_filter)
        self._mag = MagSensor(errors.magnetometer, mag_rng, body_axes)
        self._gps = GpsSensor(errors.gps, gps_rng, home)
        self.range_bounds = errors.range
        self._range = RangeSensor(errors.range, range_rng)
        self._field_ned_ut = field_ned_ut
        self.deck_field_ned_ut = ZERO3  # of what is beneath, in addition
        self._imu_position_body_m = imu_position_body_m
        self._gps_latency_s = gps_latency_s
        self._antenna_body_m = antenna_body_m
        self._enabled = False
        self._mag_pace, self._range_pace = Pace(MAG_PERIOD_S), Pace(RANGE_PERIOD_S)
        self._gps_pace = Pace(GPS_PERIOD_S)
        self._pending: deque[Fix] = deque()  # epochs on their way, oldest first
        # for faults that the world around does, and so to these sensors too: no sky, another field
        self.has_sky = True
        self.stray_field_ut = ZERO3
        self.throttle = 0.0
        self.motors: RotorValues = (0.0, 0.0, 0.0, 0.0)
        self.imu: ImuReading | None = None
        self.mag: Field | None = None
        self.gps: Fix | None = None
        self.range: Echo | None = None

    @property
    def truth(self) -> BoardTruth:
        return BoardTruth(
            self.inertial.accel_calibration_errors,
            self.inertial.gyro_calibration_errors,
            self._mag.calibration_errors,
            np.eye(3),
        )

    def enable(self) -> None:
        self._enabled = True

    @property
    def field_is_plausible(self) -> bool:
        """Whether the measured field strength is close to the earth's, as both autopilots check."""
        return norm(self.stray_field_ut) < _STRAY_SHARE * norm(self._field_ned_ut)

    def has_fix(self, now_s: float) -> bool:
        """Whether the receiver has had a fix recently."""
        return self.gps is not None and now_s - self.gps.time_s < _FIX_LASTS_S

    def step(
        self, now_s: float, state: QuadrotorState, throttle: float, range_height_m: Callable[[], float]
    ) -> None:
        """One physics step; `range_height_m` gives the rangefinder's over what answers it."""
        self.throttle = throttle
        self._receive(now_s, state)
        if not self._enabled:
            return
        felt = felt_at(self._imu_position_body_m, state)
        force, rate = self.inertial.sample(felt, state.rate_body_rad_s, throttle)
        self.imu = ImuReading(now_s, force, rate)
        if self._mag_pace.due(now_s):
            field_ned = add(self._field_ned_ut, self.deck_field_ned_ut)
            field_body = add(quat_rotate_inverse(state.attitude, field_ned), self.stray_field_ut)
            self.mag = Field(now_s, self._mag.sample(field_body, throttle))
        if self._range_pace.due(now_s):
            distance_m = self._range.sample(range_height_m(), tilt_from_quat(state.attitude))
            self.range = Echo(now_s, distance_m)

    def _receive(self, now_s: float, state: QuadrotorState) -> None:
        """An epoch of the receiver reaches the autopilot with a delay, and is stamped on arrival."""
        while self._pending and now_s >= self._pending[0].time_s - _EARLY_S:
            self.gps = self._pending.popleft()
        if not self._gps_pace.due(now_s) or not self.has_sky:
            return
        reading = self._gps.sample(now_s, *moved_at(self._antenna_body_m, state))
        self._pending.append(Fix(now_s + self._gps_latency_s, reading))
