"""Attitude control: quaternion proportional control around the rate loop of `rate_control`.

The attitude error becomes a rate setpoint. ArduPilot puts a shaped reference before it (`AttitudeReference`)
and feeds its rates forward; PX4 uses the setpoint directly. FRD, rad, N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.base.geometry import IDENTITY, ZERO3, Quaternion, Vector3, quat_integrate
from sitl.autopilot.control.rate_control import RateControl, RateFilters, RateGains, ShareGains
from sitl.autopilot.control.shaping import clamp, signed_root_law


@dataclass(frozen=True, slots=True)
class ReferenceLimits:
    """Limits of the shaped reference: time constant, accelerations (rad/s²), yaw rate."""

    time_constant_s: float
    tilt_acceleration: float
    yaw_acceleration: float
    yaw_rate_rad_s: float


@dataclass(frozen=True, slots=True)
class AttitudeGains:
    """Gains from angle to rate (1/s), limits rad/s; `shares` and `filters` are the rate loop's."""

    shares: ShareGains
    filters: RateFilters
    tilt_p: float = 6.5
    yaw_p: float = 2.8
    rate_limit_rad_s: tuple[float, float, float] = (3.8, 3.8, 3.5)
    reference: ReferenceLimits | None = None


class AttitudeReference:
    """A rate- and acceleration-limited attitude that follows the setpoint, and its body rate."""

    def __init__(self, limits: ReferenceLimits) -> None:
        self._limits = limits
        self.reset(IDENTITY)

    def reset(self, attitude: Quaternion) -> None:
        """Start from rest at an attitude."""
        self.attitude, self.rate = attitude, ZERO3

    def step(self, setpoint: Quaternion, feed_rate: Vector3, dt_s: float) -> None:
        """One outer step towards a setpoint that itself turns at `feed_rate` (body)."""
        limits, error = self._limits, _turn_to(self.attitude, setpoint)
        gain, tilt, yaw = 1.0 / limits.time_constant_s, limits.tilt_acceleration, limits.yaw_acceleration
        x = signed_root_law(error[0], gain, tilt, dt_s) + feed_rate[0]
        y = signed_root_law(error[1], gain, tilt, dt_s) + feed_rate[1]
        z = clamp(signed_root_law(error[2], gain, yaw, dt_s) + feed_rate[2], limits.yaw_rate_rad_s)
        p, q, r = self.rate
        self.rate = (
            p + clamp(x - p, tilt * dt_s),
            q + clamp(y - q, tilt * dt_s),
            r + clamp(z - r, yaw * dt_s),
        )
        self.attitude = quat_integrate(self.attitude, self.rate, dt_s)


class AttitudeControl:
    """One step a gyroscope sample; `reset` on the ground, so that nothing winds up against it."""

    def __init__(self, inertia_kg_m2: Vector3, gains: AttitudeGains, rates: RateGains) -> None:
        self._gains = gains
        self._rates = RateControl(inertia_kg_m2, rates, gains.filters)

    def reset(self) -> None:
        """Reset the rate loop."""
        self._rates.reset()

    def step(
        self,
        attitude: Quaternion,
        rate: Vector3,
        setpoint: Quaternion | None,
        feed_rate: Vector3,
        dt_s: float,
        *,
        frozen: bool,
    ) -> Vector3:
        """Body torque (N m) towards `setpoint`, or towards the rate alone when it is None.

        `feed_rate` (body, rad/s) is what the setpoint itself turns at; `frozen` stops the integral.
        """
        return self._rates.step(rate, self._rate_setpoint(attitude, setpoint, feed_rate), dt_s, frozen=frozen)

    def _rate_setpoint(self, q: Quaternion, setpoint: Quaternion | None, feed: Vector3) -> Vector3:
        """Body rates (rad/s): twice the vector part of the error, shorter way round, plus the feed."""
        x, y, z = feed
        if setpoint is not None:
            ex, ey, ez = _error(q, setpoint)
            tilt, yaw = self._gains.tilt_p, self._gains.yaw_p
            x, y, z = x + tilt * ex, y + tilt * ey, z + yaw * ez
        lx, ly, lz = self._gains.rate_limit_rad_s
        return (clamp(x, lx), clamp(y, ly), clamp(z, lz))


def turn_about_down(attitude: Quaternion, rate_rad_s: float) -> Vector3:
    """A turn about the world's down axis as a body rate."""
    w, x, y, z = attitude
    return (
        rate_rad_s * 2.0 * (x * z - w * y),
        rate_rad_s * 2.0 * (y * z + w * x),
        rate_rad_s * (1.0 - 2.0 * (x * x + y * y)),
    )


def _error(q: Quaternion, to: Quaternion) -> Vector3:
    """Twice the vector part of the turn from one attitude to another, in the body, by the shorter way."""
    aw, ax, ay, az = q
    bw, bx, by, bz = to
    sign = 2.0 if aw * bw + ax * bx + ay * by + az * bz >= 0.0 else -2.0
    return (
        sign * (aw * bx - ax * bw - ay * bz + az * by),
        sign * (aw * by + ax * bz - ay * bw - az * bx),
        sign * (aw * bz - ax * by + ay * bx - az * bw),
    )


def _turn_to(q: Quaternion, to: Quaternion) -> Vector3:
    """The same as a rotation vector: exact for large turns."""
    x, y, z = _error(q, to)
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    if sine < 1e-9:
        return (x, y, z)
    k = 2.0 * math.asin(min(1.0, sine)) / (2.0 * sine)
    return (k * x, k * y, k * z)
