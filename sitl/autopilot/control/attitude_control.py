"""The rate controller: a PID on the body rates with the filters of a real autopilot.

The gains belong to the airframe, per unit of inertia. An airframe without gains uses the autopilot's
defaults, which are in shares of what the motors can do (`ShareGains`). Each filter of the gyroscope costs the
loop a few milliseconds, that of the yaw a tenth of a second. FRD, rad, N m.

Attitude control: quaternion proportional control around that rate loop.

The attitude error becomes a rate setpoint. ArduPilot puts a shaped reference before it (`AttitudeReference`)
and feeds its rates forward; PX4 uses the setpoint directly. FRD, rad, N m.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from companion.base.geometry import IDENTITY, ZERO3, Quaternion, Vector3, quat_integrate
from companion.config import StrictModel
from sitl.autopilot.control.shaping import clamp, low_pass_share, signed_root_law
from sitl.vehicle.quadrotor import QuadrotorParameters

Gain = Annotated[float, Field(ge=0.0, le=200.0)]
Three = tuple[Gain, Gain, Gain]
_ROOT_2: Final = math.sqrt(2.0)


class RateGains(StrictModel):
    """Gains about roll, pitch and yaw, per unit of inertia, of one airframe.

    `proportional` 1/s, `integral` 1/s², `derivative` unitless, `integral_limit` rad/s².
    """

    proportional: Three = (20.0, 20.0, 8.0)
    integral: Three = (12.0, 12.0, 3.0)
    derivative: Three = (0.25, 0.25, 0.0)
    integral_limit: Three = (6.0, 6.0, 6.0)


@dataclass(frozen=True, slots=True)
class ShareGains:
    """An autopilot's own gains (tilt, yaw), in shares of the torque that its mixer makes of a whole 1.

    `tilt_torque` is that torque over the arm times one motor's full thrust, `yaw_torque` over the reaction
    torque of one motor; for a "+" frame.
    """

    proportional: tuple[float, float]
    integral: tuple[float, float]
    derivative: tuple[float, float]
    integral_limit: tuple[float, float]
    tilt_torque: float
    yaw_torque: float

    def rates(self, airframe: QuadrotorParameters) -> RateGains:
        """The gains per unit of inertia on an airframe."""
        thrust, (ix, iy, iz) = airframe.max_thrust_n, airframe.inertia_kg_m2
        layout = airframe.layout
        tilt = self.tilt_torque * airframe.arm_length_m * thrust * (0.5 * layout.tilting)
        yaw = self.yaw_torque * airframe.torque_to_thrust_m * thrust * (0.25 * layout.count)

        def of(gain: tuple[float, float]) -> Vector3:
            return (gain[0] * tilt / ix, gain[0] * tilt / iy, gain[1] * yaw / iz)

        return RateGains(
            proportional=of(self.proportional),
            integral=of(self.integral),
            derivative=of(self.derivative),
            integral_limit=of(self.integral_limit),
        )


@dataclass(frozen=True, slots=True)
class RateFilters:
    """Cut-offs (Hz) of the low-passes about the loop; None: there is none.

    `gyro_hz` has two poles, all others one. `damps_error`: the derivative is the error's (ArduPilot), so that
    a changing setpoint is fed forward, not the measured rate's (PX4).
    """

    gyro_hz: float
    derivative_hz: float
    target_hz: float | None = None
    yaw_error_hz: float | None = None
    yaw_torque_hz: float | None = None
    damps_error: bool = False


class RateControl:
    """One step a gyroscope sample; `reset` on the ground, so that nothing winds up against it."""

    def __init__(self, inertia_kg_m2: Vector3, gains: RateGains, filters: RateFilters) -> None:
        self._inertia, self._gains, self._filters = inertia_kg_m2, gains, filters
        self._gyro = SecondOrderLowPass(filters.gyro_hz)
        self._dt_s = 0.0
        self.reset()

    def reset(self) -> None:
        self._integral = ZERO3
        self._gyro.reset()
        self._target: Vector3 | None = None
        self._yaw_error: float | None = None
        self._yaw_torque = 0.0
        self._damped: Vector3 | None = None
        self._slope = ZERO3

    def step(self, rate: Vector3, wanted: Vector3, dt_s: float, *, frozen: bool) -> Vector3:
        """Body torque (N m) towards a rate (rad/s); `frozen` stops the integral."""
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._set_shares(dt_s)
        rate = self._gyro.step(rate, dt_s)
        wanted = self._target = _towards(self._target or wanted, wanted, self._target_share)
        ex, ey, ez = wanted[0] - rate[0], wanted[1] - rate[1], wanted[2] - rate[2]
        if self._yaw_error is not None:
            ez = self._yaw_error + self._yaw_error_share * (ez - self._yaw_error)
        self._yaw_error = ez
        sx, sy, sz = self._damping(rate, (ex, ey, ez), dt_s)
        gains, (ix, iy, iz) = self._gains, self._integral
        (px, py, pz), (dx, dy, dz), (jx, jy, jz) = gains.proportional, gains.derivative, self._inertia
        yaw = pz * ez + iz - dz * sz
        self._yaw_torque += self._yaw_torque_share * (yaw - self._yaw_torque)
        if not frozen:
            (kx, ky, kz), (lx, ly, lz) = gains.integral, gains.integral_limit
            self._integral = (
                clamp(ix + kx * ex * dt_s, lx),
                clamp(iy + ky * ey * dt_s, ly),
                clamp(iz + kz * ez * dt_s, lz),
            )
        return (jx * (px * ex + ix - dx * sx), jy * (py * ey + iy - dy * sy), jz * self._yaw_torque)

    def _damping(self, rate: Vector3, error: Vector3, dt_s: float) -> Vector3:
        """The filtered slope (rad/s²) of the measured rate, or of the error turned round."""
        damped = (-error[0], -error[1], -error[2]) if self._filters.damps_error else rate
        x, y, z = self._damped or damped
        self._damped = damped
        slope = ((damped[0] - x) / dt_s, (damped[1] - y) / dt_s, (damped[2] - z) / dt_s)
        self._slope = _towards(self._slope, slope, self._slope_share)
        return self._slope

    def _set_shares(self, dt_s: float) -> None:
        filters = self._filters
        self._target_share = _filter_share(filters.target_hz, dt_s)
        self._slope_share = _filter_share(filters.derivative_hz, dt_s)
        self._yaw_error_share = _filter_share(filters.yaw_error_hz, dt_s)
        self._yaw_torque_share = _filter_share(filters.yaw_torque_hz, dt_s)


class SecondOrderLowPass:
    """Butterworth's low-pass of second order on a vector, by the bilinear transform; starts at rest."""

    def __init__(self, cutoff_hz: float) -> None:
        self._cutoff_hz = cutoff_hz
        self._dt_s = 0.0
        self.reset()

    def reset(self) -> None:
        self._one: Vector3 | None = None
        self._two = ZERO3

    def step(self, value: Vector3, dt_s: float) -> Vector3:
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            omega = math.tan(math.pi * min(self._cutoff_hz * dt_s, 0.45))
            self._a1 = 2.0 * (omega * omega - 1.0)
            self._a2 = 1.0 - _ROOT_2 * omega + omega * omega
            self._scale = 1.0 / (1.0 + _ROOT_2 * omega + omega * omega)
            self._b = omega * omega * self._scale
        a1, a2, b = self._a1 * self._scale, self._a2 * self._scale, self._b
        rest = 1.0 / (1.0 + a1 + a2)
        ux, uy, uz = self._one or (value[0] * rest, value[1] * rest, value[2] * rest)
        vx, vy, vz = (ux, uy, uz) if self._one is None else self._two
        x = value[0] - a1 * ux - a2 * vx
        y = value[1] - a1 * uy - a2 * vy
        z = value[2] - a1 * uz - a2 * vz
        self._one, self._two = (x, y, z), (ux, uy, uz)
        return (b * (x + 2.0 * ux + vx), b * (y + 2.0 * uy + vy), b * (z + 2.0 * uz + vz))


def _filter_share(cutoff_hz: float | None, dt_s: float) -> float:
    return 1.0 if cutoff_hz is None else low_pass_share(cutoff_hz, dt_s)


def _towards(x: Vector3, to: Vector3, share: float) -> Vector3:
    return (x[0] + share * (to[0] - x[0]), x[1] + share * (to[1] - x[1]), x[2] + share * (to[2] - x[2]))


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
