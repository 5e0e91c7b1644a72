"""The autopilot's state estimate: the truth with the errors of a real estimator.

Users of this autopilot must not rely on its origin, height or heading: the horizontal position is
off by a constant and wanders by 0.3 m, the height is off and wanders, the heading is off by 2 to 3 degrees,
the horizon by 0.3 degrees. The wander of the position is the integral of the velocity's error (with a leak),
so that position and velocity agree with each other as a filter's do. Sizes: recordings of PX4 1.16 and
ArduPilot 4.6 in flight. World NED relative to the SITL's home, FRD, SI units.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from companion.base.geometry import (
    IDENTITY,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    rotate_yaw,
)
from sitl.vehicle.quadrotor import QuadrotorState

_NOISE_BLOCK = 256


@dataclass(frozen=True, slots=True)
class EstimatorErrors:
    """Sizes of the errors: standard deviations, correlation times, and the bounds of the constant ones.

    `velocity_turns_with_heading`: the share of the heading's error by which velocities are turned. A filter
    that rests on inertial prediction shows the whole of it (1), one that trusts GPS velocities none (0).
    """

    horizontal_velocity_std_m_s: float = 0.04
    vertical_velocity_std_m_s: float = 0.03
    velocity_correlation_s: float = 3.0
    position_leak_s: float = 20.0
    position_offset_std_m: float = 0.8
    height_offset_std_m: float = 0.4
    heading_bias_deg: tuple[float, float] = (2.0, 3.0)
    tilt_error_deg: float = 0.3
    velocity_turns_with_heading: float = 1.0


NO_ERRORS = EstimatorErrors(0.0, 0.0, 3.0, 20.0, 0.0, 0.0, (0.0, 0.0), 0.0)
EstimatorName = Literal["typical", "exact", "sih", "arducopter_sitl"]
ESTIMATORS: Final[dict[EstimatorName, EstimatorErrors]] = {
    "typical": EstimatorErrors(),
    "exact": NO_ERRORS,
    # Measured on PX4 1.16 with SIH standing on the ground and hovering: its velocity wanders by decimetres a
    # second, and a position held fast by GPS does not follow it (so the leak is short).
    "sih": EstimatorErrors(
        horizontal_velocity_std_m_s=0.25,
        vertical_velocity_std_m_s=0.15,
        velocity_correlation_s=4.0,
        position_leak_s=1.0,
        position_offset_std_m=0.2,
        height_offset_std_m=0.2,
        heading_bias_deg=(0.0, 0.0),
        tilt_error_deg=0.1,
    ),
    # ArduCopter with its own simulator: a velocity that is off by a centimetre or two a second for half a
    # minute.
    "arducopter_sitl": EstimatorErrors(
        horizontal_velocity_std_m_s=0.017,
        vertical_velocity_std_m_s=0.002,
        velocity_correlation_s=30.0,
        position_leak_s=1.0,
        position_offset_std_m=0.0,
        height_offset_std_m=0.0,
        heading_bias_deg=(0.0, 0.0),
        tilt_error_deg=0.0,
    ),
}


class SimulatedEstimator:
    """Attitude at every step, position and velocity at the outer loop's rate."""

    def __init__(self, errors: EstimatorErrors, rng: np.random.Generator) -> None:
        self._rng = rng
        self._errors = errors
        heading_bias = math.radians(rng.uniform(*errors.heading_bias_deg)) * (1 if rng.random() < 0.5 else -1)
        tilt_direction = rng.uniform(-math.pi, math.pi)
        tilt = math.radians(errors.tilt_error_deg)
        self._heading_error = quat_from_euler(0.0, 0.0, heading_bias)
        self._tilt_error = quat_from_rotation_vector(
            (tilt * math.cos(tilt_direction), tilt * math.sin(tilt_direction), 0.0)
        )
        self._velocity_turn_rad = heading_bias * errors.velocity_turns_with_heading
        horizontal, vertical = errors.position_offset_std_m, errors.height_offset_std_m
        north, east, down = rng.standard_normal(3).tolist()
        self._offset: Vector3 = (horizontal * north, horizontal * east, vertical * down)
        self._wander = ZERO3
        self._velocity_error = ZERO3
        self._noise: list[float] = []
        self.heading_bias_rad = heading_bias
        self.attitude: Quaternion = IDENTITY
        self.rate_body_rad_s = ZERO3
        self.position_ned_m = ZERO3
        self.velocity_ned_m_s = ZERO3
        self.acceleration_ned_m_s2 = ZERO3
        self._true_velocity: Vector3 | None = None
        self._yaw_reset: tuple[float, float] | None = None

    @property
    def motion(self) -> tuple[Vector3, Vector3, Vector3]:
        return self.position_ned_m, self.velocity_ned_m_s, self.acceleration_ned_m_s2

    def reset_yaw_at(self, time_s: float, by_rad: float) -> None:
        """Reset the heading then: it leaps, and with it the frame of the velocities."""
        self._yaw_reset = (time_s, by_rad)

    def step_to(self, now_s: float) -> None:
        if self._yaw_reset is None or now_s < self._yaw_reset[0]:
            return
        by_rad, self._yaw_reset = self._yaw_reset[1], None
        self.heading_bias_rad += by_rad
        self._heading_error = quat_from_euler(0.0, 0.0, self.heading_bias_rad)
        self._velocity_turn_rad += by_rad * self._errors.velocity_turns_with_heading

    def update_attitude(self, truth: QuadrotorState) -> None:
        """Update attitude and rate: constant heading and horizon errors, a clean gyroscope."""
        self.attitude = quat_multiply(self._heading_error, quat_multiply(truth.attitude, self._tilt_error))
        self.rate_body_rad_s = truth.rate_body_rad_s

    def update_position(self, truth: QuadrotorState, dt_s: float) -> None:
        """Advance the errors by dt and update position and velocity; acceleration is the IMU's, clean."""
        errors = self._errors
        decay = math.exp(-dt_s / errors.velocity_correlation_s)
        kick = math.sqrt(1.0 - decay * decay)
        horizontal = kick * errors.horizontal_velocity_std_m_s
        vertical = kick * errors.vertical_velocity_std_m_s
        noise_n, noise_e, noise_d = self._draw3()
        en, ee, ed = self._velocity_error
        en = decay * en + horizontal * noise_n
        ee = decay * ee + horizontal * noise_e
        ed = decay * ed + vertical * noise_d
        keep = 1.0 - dt_s / errors.position_leak_s
        wn, we, wd = self._wander
        wn, we, wd = wn * keep + en * dt_s, we * keep + ee * dt_s, wd * keep + ed * dt_s
        self._velocity_error, self._wander = (en, ee, ed), (wn, we, wd)
        pn, pe, pd = truth.position_ned_m
        on, oe, od = self._offset
        self.position_ned_m = (pn + on + wn, pe + oe + we, pd + od + wd)
        vn, ve, vd = rotate_yaw(truth.velocity_ned_m_s, self._velocity_turn_rad)
        ln, le, ld = self._true_velocity or (vn, ve, vd)
        self._true_velocity = (vn, ve, vd)
        self.acceleration_ned_m_s2 = ((vn - ln) / dt_s, (ve - le) / dt_s, (vd - ld) / dt_s)
        self.velocity_ned_m_s = (vn + en, ve + ee, vd + ed)

    def _draw3(self) -> Vector3:
        """Three unit normals; drawn in blocks, because one draw costs as much as the rest of the step."""
        if len(self._noise) < 3:
            self._noise = self._rng.standard_normal(3 * _NOISE_BLOCK).tolist()
        take = self._noise.pop
        return (take(), take(), take())
