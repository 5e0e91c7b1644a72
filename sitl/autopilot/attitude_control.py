"""Attitude and body rates: quaternion proportional control around a PID on the rates.

The attitude error is turned into rates, the rates' errors into torques. Gains are per unit of inertia, so
that one set fits most airframes. ArduPilot puts a shaped reference before it (`AttitudeReference`), whose
rates are fed forward; PX4 takes the setpoint as it is. FRD, rad, N m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from companion.config import StrictModel
from companion.geometry import IDENTITY, ZERO3, Quaternion, Vector3, quat_integrate
from sitl.autopilot.shaping import clamp, signed_root_law

Gain = Annotated[float, Field(ge=0.0, le=200.0)]
Three = tuple[Gain, Gain, Gain]


@dataclass(frozen=True, slots=True)
class ReferenceLimits:
    """How a reference goes to the attitude asked for: time constant, accelerations (rad/s²), yaw rate."""

    time_constant_s: float
    tilt_acceleration: float
    yaw_acceleration: float
    yaw_rate_rad_s: float


class RateGains(StrictModel):
    """The innermost loop's tuning about roll, pitch and yaw, per unit of inertia: it goes with a frame.

    `proportional` 1/s, `integral` 1/s², `derivative` unitless.
    """

    proportional: Three = (20.0, 20.0, 8.0)
    integral: Three = (12.0, 12.0, 3.0)
    derivative: Three = (0.25, 0.25, 0.0)


@dataclass(frozen=True, slots=True)
class AttitudeGains:
    """Gains from angle to rate (1/s), limits rad/s and rad/s².

    `damps_error`: the rate loop's derivative is the error's (ArduPilot), so that a changing setpoint is fed
    forward, not the measured rate's (PX4).
    """

    tilt_p: float = 6.5
    yaw_p: float = 2.8
    rate_limit_rad_s: tuple[float, float, float] = (3.8, 3.8, 3.5)
    integral_limit_rad_s2: float = 6.0
    derivative_filter_s: float = 0.008
    damps_error: bool = False
    reference: ReferenceLimits | None = None


class AttitudeReference:
    """An attitude that turns towards what is asked for within limits, and the body rate at which it does."""

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

    def __init__(self, inertia_kg_m2: Vector3, gains: AttitudeGains, rates: RateGains | None = None) -> None:
        self._inertia = inertia_kg_m2
        self._gains = gains
        rates = rates or RateGains()
        self._p, self._i, self._d = rates.proportional, rates.integral, rates.derivative
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the filtered rate."""
        self._integral = ZERO3
        self._slow_rate: Vector3 | None = None

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
        wanted = self._rate_setpoint(attitude, setpoint, feed_rate)
        gains = self._gains
        ex, ey, ez = wanted[0] - rate[0], wanted[1] - rate[1], wanted[2] - rate[2]
        damped = (-ex, -ey, -ez) if gains.damps_error else rate
        slow = self._slow_rate or damped
        share = dt_s / (dt_s + gains.derivative_filter_s)
        slow = (
            slow[0] + share * (damped[0] - slow[0]),
            slow[1] + share * (damped[1] - slow[1]),
            slow[2] + share * (damped[2] - slow[2]),
        )
        before = self._slow_rate or slow
        self._slow_rate = slow
        ix, iy, iz = self._integral
        (px, py, pz), (dx, dy, dz) = self._p, self._d
        jx, jy, jz = self._inertia
        lx, ly, lz = jx * rate[0], jy * rate[1], jz * rate[2]
        torque = (
            jx * (px * ex + ix - dx * (slow[0] - before[0]) / dt_s) + rate[1] * lz - rate[2] * ly,
            jy * (py * ey + iy - dy * (slow[1] - before[1]) / dt_s) + rate[2] * lx - rate[0] * lz,
            jz * (pz * ez + iz - dz * (slow[2] - before[2]) / dt_s) + rate[0] * ly - rate[1] * lx,
        )
        if not frozen:
            kx, ky, kz = self._i
            limit = gains.integral_limit_rad_s2
            self._integral = (
                clamp(ix + kx * ex * dt_s, limit),
                clamp(iy + ky * ey * dt_s, limit),
                clamp(iz + kz * ez * dt_s, limit),
            )
        return torque

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
