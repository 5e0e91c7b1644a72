"""Attitude and body rates: quaternion proportional control around a PID on the rates.

The attitude error is turned into rates (time constant 1/6.5 s in roll and pitch, slower in yaw), the rates'
errors into torques. Gains are per unit of inertia, so that one set fits every airframe. FRD, rad, N m.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.geometry import ZERO3, Quaternion, Vector3


@dataclass(frozen=True, slots=True)
class AttitudeGains:
    """Gains 1/s (and 1/s² for the integral, unitless for the derivative), limits rad/s and rad/s²."""

    tilt_p: float = 6.5
    yaw_p: float = 2.8
    rate_p: tuple[float, float, float] = (20.0, 20.0, 8.0)
    rate_i: tuple[float, float, float] = (12.0, 12.0, 3.0)
    rate_d: tuple[float, float, float] = (0.25, 0.25, 0.0)
    rate_limit_rad_s: tuple[float, float, float] = (3.8, 3.8, 1.5)
    integral_limit_rad_s2: float = 6.0
    derivative_filter_s: float = 0.008


class AttitudeControl:
    """One step a gyroscope sample; `reset` on the ground, so that nothing winds up against it."""

    def __init__(self, inertia_kg_m2: Vector3, gains: AttitudeGains) -> None:
        self._inertia = inertia_kg_m2
        self._gains = gains
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the filtered rate."""
        self._integral = ZERO3
        self._slow_rate: Vector3 | None = None

    def step(
        self,
        attitude: Quaternion,
        rate: Vector3,
        setpoint: Quaternion,
        yaw_rate_rad_s: float,
        dt_s: float,
        *,
        frozen: bool,
    ) -> Vector3:
        """Body torque (N m) towards `setpoint`.

        `yaw_rate_rad_s` is fed forward; `frozen` stops the integral.
        """
        wanted = self._rate_setpoint(attitude, setpoint, yaw_rate_rad_s)
        gains = self._gains
        slow = self._slow_rate or rate
        share = dt_s / (dt_s + gains.derivative_filter_s)
        slow = (
            slow[0] + share * (rate[0] - slow[0]),
            slow[1] + share * (rate[1] - slow[1]),
            slow[2] + share * (rate[2] - slow[2]),
        )
        before = self._slow_rate or slow
        self._slow_rate = slow
        ex, ey, ez = wanted[0] - rate[0], wanted[1] - rate[1], wanted[2] - rate[2]
        ix, iy, iz = self._integral
        (px, py, pz), (dx, dy, dz) = gains.rate_p, gains.rate_d
        jx, jy, jz = self._inertia
        lx, ly, lz = jx * rate[0], jy * rate[1], jz * rate[2]
        torque = (
            jx * (px * ex + ix - dx * (slow[0] - before[0]) / dt_s) + rate[1] * lz - rate[2] * ly,
            jy * (py * ey + iy - dy * (slow[1] - before[1]) / dt_s) + rate[2] * lx - rate[0] * lz,
            jz * (pz * ez + iz - dz * (slow[2] - before[2]) / dt_s) + rate[0] * ly - rate[1] * lx,
        )
        if not frozen:
            kx, ky, kz = gains.rate_i
            self._integral = (
                self._bounded(ix + kx * ex * dt_s),
                self._bounded(iy + ky * ey * dt_s),
                self._bounded(iz + kz * ez * dt_s),
            )
        return torque

    def _bounded(self, value: float) -> float:
        limit = self._gains.integral_limit_rad_s2
        return limit if value > limit else -limit if value < -limit else value

    def _rate_setpoint(self, q: Quaternion, setpoint: Quaternion, yaw_rate: float) -> Vector3:
        """Body rates (rad/s): twice the vector part of the error, shorter way round, plus the turn wanted."""
        aw, ax, ay, az = q
        bw, bx, by, bz = setpoint
        gains = self._gains
        w = aw * bw + ax * bx + ay * by + az * bz
        sign = 2.0 if w >= 0.0 else -2.0
        tilt, yaw = sign * gains.tilt_p, sign * gains.yaw_p
        x = tilt * (aw * bx - ax * bw - ay * bz + az * by)
        y = tilt * (aw * by + ax * bz - ay * bw - az * bx)
        z = yaw * (aw * bz - ax * by + ay * bx - az * bw)
        if yaw_rate:  # about the world's down axis, seen from the body
            x += yaw_rate * 2.0 * (ax * az - aw * ay)
            y += yaw_rate * 2.0 * (ay * az + aw * ax)
            z += yaw_rate * (1.0 - 2.0 * (ax * ax + ay * ay))
        lx, ly, lz = gains.rate_limit_rad_s
        return (min(max(x, -lx), lx), min(max(y, -ly), ly), min(max(z, -lz), lz))
