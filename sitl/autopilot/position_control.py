"""Position, velocity and acceleration setpoints to an attitude and a thrust.

position P -> velocity PID -> acceleration -> tilt and thrust. What a setpoint does not give is NaN. With
velocity and acceleration given, a = a_ff + Kp (v_sp - v) + integral; the integral carries wind and trim.
A velocity given alone is approached at a bounded acceleration, as the autopilots shape it.
NED in the autopilot's own heading frame, SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import isnan, nan

from companion.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Quaternion,
    Vector3,
    quat_from_euler,
    tilt_from_quat,
    wrap_angle,
)
from sitl.autopilot.setpoints import MotionSetpoint


@dataclass(frozen=True, slots=True)
class PositionGains:
    """Gains and limits; `integrates_acceleration`: an acceleration alone moves a velocity reference along."""

    horizontal_p: float = 0.95
    vertical_p: float = 1.0
    velocity_p: float = 1.8
    velocity_i: float = 0.5
    velocity_d: float = 0.1
    climb_p: float = 4.0
    climb_i: float = 2.0
    shaping_m_s2: float = 3.0
    climb_shaping_m_s2: float = 5.0
    integral_limit_m_s2: float = 4.0
    tilt_limit_rad: float = math.radians(35.0)
    thrust_range: tuple[float, float] = (0.08, 0.95)
    yaw_slew_rad_s: float = math.radians(60.0)
    derivative_filter_s: float = 0.05
    integrates_acceleration: bool = False


class PositionControl:
    """Keeps the integrals, the shaped velocity and the heading; results are in its public fields."""

    def __init__(self, hover_thrust: float, gains: PositionGains) -> None:
        self._gains = gains
        self._hover = hover_thrust
        self.reset(0.0, ZERO3)

    def reset(self, yaw_rad: float, velocity_ned_m_s: Vector3) -> None:
        """Start afresh from the present heading and velocity with empty integrals."""
        self.yaw_rad = yaw_rad
        self.yaw_rate_rad_s = 0.0
        self.attitude: Quaternion = quat_from_euler(0.0, 0.0, yaw_rad)
        self.thrust = self._hover
        self.velocity_reference = velocity_ned_m_s
        self._integral = ZERO3
        self._last_velocity = velocity_ned_m_s
        self._measured = (0.0, 0.0)
        self._saturated = False

    def step(
        self,
        position: Vector3,
        velocity: Vector3,
        setpoint: MotionSetpoint,
        dt_s: float,
        frozen: bool = False,
    ) -> None:
        """One outer step; `frozen` holds the integrals (before lift-off)."""
        self._differentiate(velocity, dt_s)
        ax, ay = self._horizontal(position, velocity, setpoint, dt_s, frozen)
        az = self._vertical(position[2], velocity[2], setpoint, dt_s, frozen)
        self._turn(setpoint, dt_s)
        self._point_thrust(ax, ay, az)

    def step_climb(self, velocity: Vector3, attitude: Quaternion, climb_m_s: float, dt_s: float) -> None:
        """Only the height: thrust for a climb rate at an attitude that someone else commands."""
        self._differentiate(velocity, dt_s)
        setpoint = MotionSetpoint(velocity_ned_m_s=(nan, nan, -climb_m_s))
        az = self._vertical(0.0, velocity[2], setpoint, dt_s, False)
        lean = max(0.5, math.cos(tilt_from_quat(attitude)))
        self.thrust = self._bounded_thrust(self._hover * (GRAVITY_M_S2 - az) / (GRAVITY_M_S2 * lean))

    def follow(self, yaw_rad: float, velocity_ned_m_s: Vector3) -> None:
        """Somebody else commands the attitude: keep heading and shaped velocity where they are by now."""
        self.yaw_rad, self.yaw_rate_rad_s = yaw_rad, 0.0
        vx, vy, _ = velocity_ned_m_s
        self.velocity_reference = (vx, vy, self.velocity_reference[2])

    def _differentiate(self, velocity: Vector3, dt_s: float) -> None:
        share = dt_s / (dt_s + self._gains.derivative_filter_s)
        mx, my = self._measured
        last = self._last_velocity
        mx += share * ((velocity[0] - last[0]) / dt_s - mx)
        my += share * ((velocity[1] - last[1]) / dt_s - my)
        self._measured, self._last_velocity = (mx, my), velocity

    def _horizontal(
        self, position: Vector3, velocity: Vector3, sp: MotionSetpoint, dt_s: float, frozen: bool
    ) -> tuple[float, float]:
        gains = self._gains
        ffx, ffy, _ = sp.acceleration_ned_m_s2
        fed_forward = not isnan(ffx)
        if not fed_forward:
            ffx = ffy = 0.0
        ix, iy, iz = self._integral
        wanted = self._horizontal_velocity(position, sp)
        if wanted is None and not fed_forward:
            wanted = (0.0, 0.0)  # nothing given at all: stop
        rx, ry, rz = self.velocity_reference
        if wanted is None:
            if not gains.integrates_acceleration:
                self.velocity_reference = (velocity[0], velocity[1], rz)
                return ffx + ix, ffy + iy
            rx, ry = rx + ffx * dt_s, ry + ffy * dt_s
        elif fed_forward:
            rx, ry = wanted
        else:
            rx, ry = _approach(rx, ry, *wanted, gains.shaping_m_s2 * dt_s)
        self.velocity_reference = (rx, ry, rz)
        ex, ey = rx - velocity[0], ry - velocity[1]
        if not frozen:
            limit = gains.integral_limit_m_s2
            jx = min(max(ix + gains.velocity_i * ex * dt_s, -limit), limit)
            jy = min(max(iy + gains.velocity_i * ey * dt_s, -limit), limit)
            if not self._saturated or jx * jx + jy * jy < ix * ix + iy * iy:
                self._integral = (jx, jy, iz)
        mx, my = self._measured
        return (
            ffx + gains.velocity_p * ex + ix - gains.velocity_d * (mx - ffx),
            ffy + gains.velocity_p * ey + iy - gains.velocity_d * (my - ffy),
        )

    def _horizontal_velocity(self, position: Vector3, sp: MotionSetpoint) -> tuple[float, float] | None:
        """Velocity (north, east) from position error and feed-forward; None when neither is given."""
        vx, vy, _ = sp.velocity_ned_m_s
        px, py, _ = sp.position_ned_m
        if isnan(px):
            if isnan(vx):
                return None
        else:
            # beyond where braking takes longer than the linear law allows, come in along sqrt(2 a d)
            ex, ey = px - position[0], py - position[1]
            distance = math.hypot(ex, ey)
            gain = _position_gain(distance, self._gains.horizontal_p, self._gains.shaping_m_s2)
            vx = gain * ex + (0.0 if isnan(vx) else vx)
            vy = gain * ey + (0.0 if isnan(vy) else vy)
        speed = math.hypot(vx, vy)
        if speed > sp.horizontal_speed_m_s:
            vx, vy = vx * sp.horizontal_speed_m_s / speed, vy * sp.horizontal_speed_m_s / speed
        return vx, vy

    def _vertical(self, height: float, speed: float, sp: MotionSetpoint, dt_s: float, frozen: bool) -> float:
        gains = self._gains
        ix, iy, iz = self._integral
        v, p, ff = sp.velocity_ned_m_s[2], sp.position_ned_m[2], sp.acceleration_ned_m_s2[2]
        fed_forward = not isnan(ff)
        if not fed_forward:
            ff = 0.0
        rx, ry, rz = self.velocity_reference
        if isnan(v) and isnan(p) and fed_forward:
            if not gains.integrates_acceleration:
                self.velocity_reference = (rx, ry, speed)
                return ff + iz
            rz += ff * dt_s
        else:
            v = 0.0 if isnan(v) else v
            if not isnan(p):
                error = p - height
                v += error * _position_gain(abs(error), gains.vertical_p, gains.climb_shaping_m_s2)
            v = min(max(v, -sp.climb_speed_m_s), sp.descent_speed_m_s)
            step = gains.climb_shaping_m_s2 * dt_s
            rz = v if fed_forward else min(max(v, rz - step), rz + step)
        self.velocity_reference = (rx, ry, rz)
        error = rz - speed
        if not frozen:
            limit = gains.integral_limit_m_s2
            self._integral = (ix, iy, min(max(iz + gains.climb_i * error * dt_s, -limit), limit))
        return ff + gains.climb_p * error + iz

    def _turn(self, sp: MotionSetpoint, dt_s: float) -> None:
        rate = 0.0 if isnan(sp.yaw_rate_rad_s) else sp.yaw_rate_rad_s
        limit = self._gains.yaw_slew_rad_s
        rate = min(max(rate, -limit), limit)
        self.yaw_rate_rad_s = rate
        step = rate * dt_s
        if not isnan(sp.yaw_rad):
            step = min(max(wrap_angle(sp.yaw_rad - self.yaw_rad), -limit * dt_s), limit * dt_s)
        self.yaw_rad = wrap_angle(self.yaw_rad + step)

    def _point_thrust(self, ax: float, ay: float, az: float) -> None:
        """Tilt and thrust whose force gives the acceleration; height goes before sideways."""
        low, high = self._gains.thrust_range
        per_thrust = GRAVITY_M_S2 / self._hover
        up = min(max(GRAVITY_M_S2 - az, low * per_thrust), high * per_thrust)
        sideways = math.hypot(ax, ay)
        room = math.sqrt(max(0.0, (high * per_thrust) ** 2 - up * up))
        limit = min(math.tan(self._gains.tilt_limit_rad) * up, max(room, 0.3 * up))
        self._saturated = sideways > limit
        if self._saturated:
            ax, ay, sideways = ax * limit / sideways, ay * limit / sideways, limit
        force = math.hypot(sideways, up)
        self.thrust = self._bounded_thrust(force / per_thrust)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        forward, right = c * ax + s * ay, c * ay - s * ax
        self.attitude = quat_from_euler(math.asin(right / force), math.atan2(-forward, up), self.yaw_rad)

    def _bounded_thrust(self, thrust: float) -> float:
        low, high = self._gains.thrust_range
        return min(max(thrust, low), high)


def _position_gain(distance_m: float, gain: float, braking_m_s2: float) -> float:
    """Speed per metre of error: `gain` near by, the square-root law's far off."""
    linear_m = braking_m_s2 / (gain * gain)
    if distance_m <= linear_m:
        return gain
    return math.sqrt(2.0 * braking_m_s2 * (distance_m - 0.5 * linear_m)) / distance_m


def _approach(x: float, y: float, to_x: float, to_y: float, step: float) -> tuple[float, float]:
    """Move a point towards another by at most `step`."""
    dx, dy = to_x - x, to_y - y
    distance = math.hypot(dx, dy)
    if distance <= step:
        return to_x, to_y
    return x + dx * step / distance, y + dy * step / distance
