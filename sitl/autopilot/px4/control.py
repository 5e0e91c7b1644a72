"""PX4's position control law: position P, velocity PID, acceleration, each fed directly (PositionControl).

In OFFBOARD nothing is shaped: a step in the setpoint is a step in the tilt. A setpoint without position or
velocity on an axis skips the velocity loop there, integral included. In autonomous modes, where PX4 has a
trajectory generator, the velocity changes at a bounded acceleration. After PX4 1.16; gains by its names.

Streamed setpoints as PX4 1.16 reads them: mavlink_receiver, and its position controller's input checks.

LOCAL_NED is taken field by field, BODY_NED for velocity and acceleration, all three axes or none; any other
frame is rejected with a text, so that OFFBOARD ends without setpoints. An axis without any value, or a north
without its east, stops the vehicle. NED, SI units.
"""

import math
from dataclasses import dataclass
from math import isfinite, isnan, nan
from typing import Final

from companion.base.geometry import GRAVITY_M_S2, Quaternion, Vector3, quat_rotate, rotate_yaw
from sitl.autopilot.control.position_control import Motion, OutputLimits, PositionControl
from sitl.autopilot.control.setpoints import (
    NOT_GIVEN,
    STOP,
    AttitudeSetpoint,
    GlobalFrame,
    Ignore,
    IgnoreAttitude,
    LocalFrame,
    MotionSetpoint,
    SetpointRefusal,
    StreamedAttitude,
    StreamedMotion,
    unit_attitude,
)
from sitl.autopilot.control.shaping import FirstOrderLowPass, Two, approach, root_law

# MPC_TILTMAX_AIR, MPC_THR_MIN and MPC_THR_MAX
_OUTPUT: Final = OutputLimits(math.radians(45.0), (0.12, 1.0))
_ANTI_WINDUP: Final = 2.0  # over the velocity's gain


@dataclass(frozen=True, slots=True)
class Px4Gains:
    """Defaults of PX4 1.16, named beside each; SI units."""

    position_p: float = 0.95  # MPC_XY_P
    height_p: float = 1.0  # MPC_Z_P
    velocity_p: float = 1.8  # MPC_XY_VEL_P_ACC
    velocity_i: float = 0.4  # MPC_XY_VEL_I_ACC
    velocity_d: float = 0.2  # MPC_XY_VEL_D_ACC
    climb_p: float = 4.0  # MPC_Z_VEL_P_ACC
    climb_i: float = 2.0  # MPC_Z_VEL_I_ACC
    derivative_hz: float = 5.0  # MPC_VELD_LP
    acceleration: float = 3.0  # MPC_ACC_HOR, in autonomous modes
    climb_acceleration: float = 4.0  # MPC_ACC_UP_MAX
    limits: OutputLimits = _OUTPUT


class Px4Control(PositionControl):
    """The cascade of PX4's multicopter position controller."""

    def __init__(self, hover_thrust: float) -> None:
        self._gains = Px4Gains()
        super().__init__(hover_thrust, self._gains.limits)

    def _forget(self, velocity: Vector3) -> None:
        self._integral: Two = (0.0, 0.0)
        self._climb_integral = 0.0
        self._rate_x, self._rate_y = (FirstOrderLowPass(self._gains.derivative_hz) for _ in range(2))
        self._last = velocity

    def _let_go_sideways(self) -> None:
        self._integral = (0.0, 0.0)

    def _wanted(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> Vector3:
        ax, ay = self._sideways(motion[0], motion[1], setpoint, dt_s, frozen)
        return (ax, ay, self._wanted_down(motion, setpoint, dt_s, frozen))

    def _sideways(
        self, position: Vector3, velocity: Vector3, sp: MotionSetpoint, dt_s: float, frozen: bool
    ) -> Two:
        gains, (vx, vy, _) = self._gains, velocity
        dx = self._rate_x.step((vx - self._last[0]) / dt_s, dt_s)
        dy = self._rate_y.step((vy - self._last[1]) / dt_s, dt_s)
        self._last = velocity
        ffx, ffy, _ = sp.acceleration_ned_m_s2
        fed_forward = not isnan(ffx)
        if not fed_forward:
            ffx = ffy = 0.0
        wanted = self._velocity(position, sp)
        if wanted is None and fed_forward:
            self.velocity_reference = (vx, vy, self.velocity_reference[2])
            return ffx, ffy
        rx, ry = wanted or (0.0, 0.0)
        if not sp.streamed and not fed_forward:
            rx, ry = approach(*self.velocity_reference[:2], (rx, ry), gains.acceleration * dt_s)
        self.velocity_reference = (rx, ry, self.velocity_reference[2])
        ex, ey = rx - vx, ry - vy
        ix, iy = self._integral
        ax = ffx + gains.velocity_p * ex + ix - gains.velocity_d * dx
        ay = ffy + gains.velocity_p * ey + iy - gains.velocity_d * dy
        if not frozen:
            self._integrate(ex, ey, ax, ay, dt_s)
        return ax, ay

    def _integrate(self, ex: float, ey: float, ax: float, ay: float, dt_s: float) -> None:
        """Integrate the errors, less what the tilt limit prevents (anti-windup)."""
        gains, (ix, iy) = self._gains, self._integral
        size, most = math.hypot(ax, ay), math.tan(gains.limits.tilt_rad) * GRAVITY_M_S2
        if size > most:
            excess = (1.0 - most / size) * _ANTI_WINDUP / gains.velocity_p
            ex, ey = ex - excess * ax, ey - excess * ay
        self._integral = (ix + gains.velocity_i * ex * dt_s, iy + gains.velocity_i * ey * dt_s)

    def _velocity(self, position: Vector3, sp: MotionSetpoint) -> Two | None:
        """Velocity (north, east) from position error and feed-forward; None when neither is given."""
        vx, vy, _ = sp.velocity_ned_m_s
        px, py, _ = sp.position_ned_m
        if isnan(px) and isnan(vx):
            return None
        vx, vy = (0.0, 0.0) if isnan(vx) else (vx, vy)
        if not isnan(px):
            ex, ey = px - position[0], py - position[1]
            gain = self._gains.position_p
            if not sp.streamed and (distance := math.hypot(ex, ey)) > 0.0:
                gain = root_law(distance, gain, self._gains.acceleration, 1e-3) / distance
            vx, vy = vx + gain * ex, vy + gain * ey
        speed = math.hypot(vx, vy)
        if speed > sp.horizontal_speed_m_s:
            vx, vy = vx * sp.horizontal_speed_m_s / speed, vy * sp.horizontal_speed_m_s / speed
        return vx, vy

    def _wanted_down(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> float:
        gains, sp, place, speed = self._gains, setpoint, motion[0][2], motion[1][2]
        v, p, ff = sp.velocity_ned_m_s[2], sp.position_ned_m[2], sp.acceleration_ned_m_s2[2]
        rx, ry, rz = self.velocity_reference
        if isnan(v) and isnan(p) and not isnan(ff):
            self.velocity_reference = (rx, ry, speed)
            return ff
        wish = (0.0 if isnan(v) else v) + (0.0 if isnan(p) else gains.height_p * (p - place))
        wish = min(max(wish, -sp.climb_speed_m_s), sp.descent_speed_m_s)
        if not sp.streamed and isnan(ff):
            step = gains.climb_acceleration * dt_s
            wish = min(max(wish, rz - step), rz + step)
        self.velocity_reference = (rx, ry, wish)
        error = wish - speed
        wanted = (0.0 if isnan(ff) else ff) + gains.climb_p * error + self._climb_integral
        if not frozen and not self._at_thrust_limit(wanted, error):
            change = gains.climb_i * error * dt_s
            self._climb_integral = min(max(self._climb_integral + change, -GRAVITY_M_S2), GRAVITY_M_S2)
        return wanted

    def _at_thrust_limit(self, wanted: float, error: float) -> bool:
        """Whether integrating would push further into the thrust limit."""
        low, high = self._gains.limits.thrust_range
        thrust = self.hover * (1.0 - wanted / GRAVITY_M_S2)
        return (thrust <= low and error > 0.0) or (thrust >= high and error < 0.0)


_LOCAL, _GLOBAL = "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"
_GLOBAL_FRAMES: Final = (GlobalFrame.GLOBAL_INT, GlobalFrame.RELATIVE_ALT_INT)
_POSITION: Final = Ignore.X | Ignore.Y | Ignore.Z
_VELOCITY: Final = Ignore.VX | Ignore.VY | Ignore.VZ
_ACCELERATION: Final = Ignore.AX | Ignore.AY | Ignore.AZ


def read_motion(
    fields: StreamedMotion, here_ned_m: Vector3, attitude: Quaternion, heading_rad: float
) -> MotionSetpoint | SetpointRefusal:
    """The setpoint of a message, or why it is rejected; PX4 does not use `here_ned_m`."""
    read = _global if fields.is_global else _local if fields.frame == LocalFrame.LOCAL_NED else _body
    vectors = read(fields, attitude, heading_rad)
    if isinstance(vectors, SetpointRefusal):
        return vectors
    position, velocity, acceleration = vectors
    name = _GLOBAL if fields.is_global else _LOCAL
    if fields.mask & Ignore.FORCE and not _missing(acceleration):
        return SetpointRefusal(f"{name} force not supported")
    if all(map(_missing, vectors)):
        return SetpointRefusal("" if fields.is_global else f"{name} invalid")
    if not _complete(*vectors):
        return STOP
    yaw = nan if fields.mask & Ignore.YAW or not isfinite(fields.yaw_rad) else fields.yaw_rad
    rate = fields.yaw_rate_rad_s
    rate = nan if fields.mask & Ignore.YAW_RATE or not isfinite(rate) else rate
    return MotionSetpoint(position, velocity, acceleration, yaw, rate)


def read_attitude(fields: StreamedAttitude) -> AttitudeSetpoint | SetpointRefusal:
    """The attitude or the body rates of a message; an ignored thrust is zero."""
    mask = fields.mask
    thrust = 0.0 if mask & IgnoreAttitude.THROTTLE else fields.thrust
    roll, pitch, yaw = fields.rate_body_rad_s
    yaw = 0.0 if mask & IgnoreAttitude.YAW_RATE or not isfinite(yaw) else yaw
    if mask & IgnoreAttitude.THRUST_BODY or not isfinite(thrust):
        return SetpointRefusal()
    if not mask & IgnoreAttitude.ATTITUDE:
        attitude = unit_attitude(fields.attitude)
        return SetpointRefusal() if attitude is None else AttitudeSetpoint(attitude, thrust, yaw)
    if mask & (IgnoreAttitude.ROLL_RATE | IgnoreAttitude.PITCH_RATE):
        return SetpointRefusal()
    if not (isfinite(roll) and isfinite(pitch)):
        return SetpointRefusal()
    return AttitudeSetpoint(None, thrust, rate_body_rad_s=(roll, pitch, yaw))


def as_aged(
    setpoint: MotionSetpoint | AttitudeSetpoint, age_s: float, timeout_s: float, heading_rad: float
) -> MotionSetpoint | AttitudeSetpoint:
    """The setpoint at some age: the same, until the failsafe leaves OFFBOARD."""
    return setpoint


Three = tuple[Vector3, Vector3, Vector3]


def _local(fields: StreamedMotion, attitude: Quaternion, heading_rad: float) -> Three | SetpointRefusal:
    return (
        _masked(fields.position_m, fields.mask),
        _masked(fields.velocity_m_s, fields.mask >> 3),
        _masked(fields.acceleration_m_s2, fields.mask >> 6),
    )


def _body(fields: StreamedMotion, attitude: Quaternion, heading_rad: float) -> Three | SetpointRefusal:
    """Velocity turns with the heading, acceleration with the whole attitude; positions are not taken."""
    if fields.frame != LocalFrame.BODY_NED:
        return SetpointRefusal(f"{_LOCAL} coordinate frame {fields.frame} unsupported")
    velocity, acceleration = fields.velocity_m_s, fields.acceleration_m_s2
    velocity = NOT_GIVEN if fields.mask & _VELOCITY else rotate_yaw(velocity, heading_rad)
    acceleration = NOT_GIVEN if fields.mask & _ACCELERATION else quat_rotate(attitude, acceleration)
    return NOT_GIVEN, _masked(velocity, 0), _masked(acceleration, 0)


def _global(fields: StreamedMotion, attitude: Quaternion, heading_rad: float) -> Three | SetpointRefusal:
    """A position is taken complete or not at all, and only relative to sea level or home."""
    velocity = _masked(fields.velocity_m_s, fields.mask >> 3)
    acceleration = _masked(fields.acceleration_m_s2, fields.mask >> 6)
    if fields.mask & _POSITION:
        return NOT_GIVEN, velocity, acceleration
    if fields.frame == GlobalFrame.TERRAIN_ALT_INT:
        return SetpointRefusal()  # no terrain data
    if fields.frame not in _GLOBAL_FRAMES:
        return SetpointRefusal(f"{_GLOBAL} invalid coordinate frame {fields.frame}")
    return _masked(fields.position_m, 0), velocity, acceleration


def _masked(vector: Vector3, mask: int) -> Vector3:
    x, y, z = vector
    return (
        nan if mask & 1 or not isfinite(x) else x,
        nan if mask & 2 or not isfinite(y) else y,
        nan if mask & 4 or not isfinite(z) else z,
    )


def _missing(vector: Vector3) -> bool:
    return isnan(vector[0]) and isnan(vector[1]) and isnan(vector[2])


def _complete(*vectors: Vector3) -> bool:
    """Something for every axis, and north and east in pairs (PositionControl's check of its input)."""
    paired = all(isnan(vector[0]) == isnan(vector[1]) for vector in vectors)
    return paired and all(any(not isnan(vector[axis]) for vector in vectors) for axis in range(3))
