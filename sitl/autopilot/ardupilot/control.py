"""ArduPilot's position control law: each setpoint becomes a jerk-limited path that is tracked
(AC_PosControl).

Position, velocity and acceleration setpoints each shape the path in their own way. A P controller on the
position and a PID on the velocity track it, with the acceleration fed forward, so that a commanded
acceleration is flown whatever the wind. Height likewise; a PI on the acceleration makes the throttle. When
the kind of setpoint changes, the path restarts from the vehicle. Where tilt or throttle is at its limit, the
path waits for the vehicle. After ArduCopter 4.6; gains by its names.

Streamed setpoints as ArduCopter 4.6 reads them in GUIDED (GCS_MAVLink_Copter), and their time-out.

Position, velocity and acceleration are each taken whole: one ignored axis ignores all three. Position alone,
position with velocity, velocity, and acceleration (each with what stands after it) are flown; everything else
stops the vehicle without a text: an unknown frame, a force, a position with an acceleration alone,
numbers that are not finite. NED, SI units.
"""

import dataclasses
import math
from dataclasses import dataclass
from enum import Enum
from math import cos, isfinite, isnan, nan, sin
from typing import Final

from companion.base.geometry import (
    GRAVITY_M_S2,
    ZERO3,
    Quaternion,
    Vector3,
    add,
    rotate_yaw,
    scale,
    wrap_angle,
)
from sitl.autopilot.control.attitude_control import SecondOrderLowPass
from sitl.autopilot.control.position_control import Motion, OutputLimits, PositionControl
from sitl.autopilot.control.setpoints import (
    NOT_GIVEN,
    OVER_TERRAIN,
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
    is_finite,
    unit_attitude,
)
from sitl.autopilot.control.shaping import (
    FirstOrderLowPass,
    Path1,
    Path2,
    ShapingLimits,
    Two,
    bounded,
    clamp,
    root_law,
    signed_root_law,
)

_SIDEWAYS: Final = ShapingLimits(2.5, 5.0)  # WPNAV_ACCEL, PSC_JERK_XY
_VERTICAL: Final = ShapingLimits(1.0, 5.0)  # WPNAV_ACCEL_Z, PSC_JERK_Z
_OUTPUT: Final = OutputLimits(math.radians(30.0), (0.04, 1.0))  # ANGLE_MAX, MOT_SPIN_MIN
# the nose follows the track above this share of the top speed (AC_PosControl)
_TRACK_SHARE: Final = 0.05


@dataclass(frozen=True, slots=True)
class ArdupilotGains:
    """Defaults of ArduCopter 4.6, named beside each; SI units.

    The acceleration's gains are of the throttle: what that is worth depends on where the vehicle hovers.
    """

    sideways: ShapingLimits = _SIDEWAYS
    vertical: ShapingLimits = _VERTICAL
    position_p: float = 1.0  # PSC_POSXY_P
    velocity_p: float = 2.0  # PSC_VELXY_P
    velocity_i: float = 1.0  # PSC_VELXY_I
    velocity_d: float = 0.5  # PSC_VELXY_D
    velocity_hz: float = 5.0  # PSC_VELXY_FLTE, PSC_VELXY_FLTD
    integral_limit: float = 10.0  # PSC_VELXY_IMAX
    height_p: float = 1.0  # PSC_POSZ_P
    climb_p: float = 5.0  # PSC_VELZ_P
    climb_hz: float = 5.0  # PSC_VELZ_FLTE
    throttle_p: float = 0.05  # PSC_ACCZ_P 0.5: a thousandth of a throttle for each cm/s²
    throttle_i: float = 0.10  # PSC_ACCZ_I 1.0
    throttle_hz: float = 20.0  # PSC_ACCZ_FLTE
    accelerometer_hz: float = 20.0  # INS_ACCEL_FILTER
    limits: OutputLimits = _OUTPUT


class _Kind(Enum):
    """The part of a setpoint that shapes the path."""

    PLACE = "place"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"


class ArdupilotControl(PositionControl):
    """ArduCopter's position controller behind GUIDED and the modes of its own."""

    def __init__(self, hover_thrust: float, gains: ArdupilotGains | None = None) -> None:
        self._gains = gains or ArdupilotGains()
        super().__init__(hover_thrust, self._gains.limits)

    def _forget(self, velocity: Vector3) -> None:
        gains = self._gains
        self._across, self._along_down = Path2(), Path1()
        self._kinds: tuple[_Kind, _Kind] | None = None
        self._down_kind: _Kind | None = None
        self._integral: Two = (0.0, 0.0)
        self._commanded: Two = (0.0, 0.0)
        self._error_x, self._error_y = (FirstOrderLowPass(gains.velocity_hz) for _ in range(2))
        self._rate_x, self._rate_y = (FirstOrderLowPass(gains.velocity_hz) for _ in range(2))
        self._climb_error = FirstOrderLowPass(gains.climb_hz)
        self._throttle_error = FirstOrderLowPass(gains.throttle_hz)
        self._felt = SecondOrderLowPass(gains.accelerometer_hz)
        self._throttle_integral = 0.0

    def start_height(self, position: Vector3, velocity: Vector3, upward: float) -> None:
        """From the motion and the throttle that there are (AC_PosControl::init_z_controller).

        What stands on the ground without thrust so stays there without: nothing is off its height.
        """
        super().start_height(position, velocity, upward)
        self._down_kind = None
        self._climb_error.reset()
        self._throttle_error.reset()
        self._throttle_integral = clamp(-self._hover_share(upward), 2.0 * GRAVITY_M_S2)

    def _let_go_sideways(self) -> None:
        self._kinds = None
        self._commanded = (0.0, 0.0)

    def _wanted(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> Vector3:
        position, velocity, _ = motion
        kinds = (_kind(setpoint, 0), _kind(setpoint, 2))
        if kinds != self._kinds:
            self._kinds = kinds
            self._start_sideways(position, velocity)
        self._move_sideways(setpoint, kinds[0], dt_s)
        if frozen:  # on the ground: the path waits
            self._start_sideways(position, velocity)
        self._follow_track(setpoint, dt_s)
        ax, ay = self._hold_sideways(position, velocity, dt_s, frozen)
        return (ax, ay, self._wanted_down(motion, setpoint, dt_s, frozen))

    def _wanted_down(self, motion: Motion, setpoint: MotionSetpoint, dt_s: float, frozen: bool) -> float:
        position, velocity, acceleration = motion
        kind = _kind(setpoint, 2)
        self._start_down(position, velocity, kind)
        self._move_down(setpoint, kind, dt_s)
        if frozen:
            self._along_down.position = position[2]
        return self._hold_down(position, velocity, acceleration, dt_s, frozen)

    # ------------------------------------------------------------ the path

    def _start_sideways(self, position: Vector3, velocity: Vector3) -> None:
        self._across = Path2((position[0], position[1]), (velocity[0], velocity[1]))
        self._integral = self._commanded  # so that the tilt is continuous
        for error in (self._error_x, self._error_y, self._rate_x, self._rate_y):
            error.reset()

    def _start_down(self, position: Vector3, velocity: Vector3, kind: _Kind) -> None:
        if kind is not self._down_kind:
            self._down_kind = kind
            self._along_down = Path1(position[2], velocity[2])
            self._climb_error.reset()

    def _move_sideways(self, sp: MotionSetpoint, kind: _Kind, dt: float) -> None:
        by, path = self._gains.sideways, self._across
        acceleration = _given2(sp.acceleration_ned_m_s2)
        if kind is _Kind.PLACE:
            x, y, _ = sp.position_ned_m
            path.to_place((x, y), _given2(sp.velocity_ned_m_s), acceleration, sp.horizontal_speed_m_s, by, dt)
        elif kind is _Kind.VELOCITY:
            path.to_velocity(_given2(sp.velocity_ned_m_s), acceleration, by, dt)
        else:
            path.to_acceleration(acceleration, by, dt)

    def _move_down(self, sp: MotionSetpoint, kind: _Kind, dt: float) -> None:
        by, path = self._gains.vertical, self._along_down
        velocity, acceleration = _given(sp.velocity_ned_m_s[2]), _given(sp.acceleration_ned_m_s2[2])
        if kind is _Kind.PLACE:
            top = (sp.climb_speed_m_s, sp.descent_speed_m_s)
            path.to_place(sp.position_ned_m[2], velocity, acceleration, top, by, dt)
        elif kind is _Kind.VELOCITY:
            path.to_velocity(velocity, acceleration, by, dt)
        else:
            path.to_acceleration(acceleration, by, dt)

    def _follow_track(self, sp: MotionSetpoint, dt_s: float) -> None:
        """WP_YAW_BEHAVIOR 2: with no heading given, a setpoint's nose follows its track."""
        vx, vy = self._across.velocity
        slow = math.hypot(vx, vy) <= _TRACK_SHARE * sp.horizontal_speed_m_s
        if not sp.streamed or slow or not (isnan(sp.yaw_rad) and isnan(sp.yaw_rate_rad_s)):
            return
        self.yaw_rad = wrap_angle(math.atan2(vy, vx))

    # ------------------------------------------------------------ tracking it

    def _hold_sideways(self, position: Vector3, velocity: Vector3, dt: float, frozen: bool) -> Two:
        gains, path = self._gains, self._across
        ex, ey = path.behind_m = path.position[0] - position[0], path.position[1] - position[1]
        if (distance := math.hypot(ex, ey)) > 0.0:
            gain = root_law(distance, gains.position_p, gains.sideways.acceleration, dt) / distance
            ex, ey = gain * ex, gain * ey
        rx, ry = path.velocity[0] + ex, path.velocity[1] + ey
        path.slower_m_s = rx - velocity[0], ry - velocity[1]
        (ax, ay), (ix, iy) = self._pid(*path.slower_m_s, dt)
        self.velocity_reference = (rx, ry, self.velocity_reference[2])
        wanted = ax + path.acceleration[0], ay + path.acceleration[1]
        most = math.tan(gains.limits.tilt_rad) * GRAVITY_M_S2
        self._commanded = bounded(*wanted, most)
        # `saturated` is of the step before: then the tilt was limited further in favour of the height
        limited = wanted != self._commanded or self.saturated
        path.limit = wanted if limited else (0.0, 0.0)
        if not frozen:  # at the limit the integral may shrink, but grows no more
            longest = math.hypot(*self._integral) if limited else gains.integral_limit
            self._integral = bounded(ix, iy, min(longest, gains.integral_limit))
        return wanted  # unbounded, so that the caller sees the saturation

    def _pid(self, ex: float, ey: float, dt: float) -> tuple[Two, Two]:
        """Acceleration for a velocity error, and the integral after it."""
        gains = self._gains
        before_x, before_y = self._error_x.value, self._error_y.value
        x, y = self._error_x.step(ex, dt), self._error_y.step(ey, dt)
        dx = self._rate_x.step((x - (x if before_x is None else before_x)) / dt, dt)
        dy = self._rate_y.step((y - (y if before_y is None else before_y)) / dt, dt)
        ix, iy = self._integral[0] + gains.velocity_i * x * dt, self._integral[1] + gains.velocity_i * y * dt
        ax = gains.velocity_p * x + ix + gains.velocity_d * dx
        ay = gains.velocity_p * y + iy + gains.velocity_d * dy
        return (ax, ay), (ix, iy)

    def _hold_down(
        self, position: Vector3, velocity: Vector3, acceleration: Vector3, dt: float, frozen: bool
    ) -> float:
        gains, path = self._gains, self._along_down
        path.behind_m = path.position - position[2]
        wish = signed_root_law(path.behind_m, gains.height_p, gains.vertical.acceleration, dt)
        reference = path.velocity + wish
        path.slower_m_s = reference - velocity[2]
        self.velocity_reference = (*self.velocity_reference[:2], reference)
        wanted = gains.climb_p * self._climb_error.step(path.slower_m_s, dt) + path.acceleration
        felt = self._felt.step(acceleration, dt)[2]
        error = self._throttle_error.step(wanted - felt, dt)
        worth = GRAVITY_M_S2 / self.hover  # of full throttle
        made = worth * gains.throttle_p * error + self._throttle_integral
        low, high = (self._hover_share(share) for share in gains.limits.thrust_range)
        path.limit = 1.0 if made >= -low else -1.0 if made <= -high else 0.0
        if not frozen and not error * path.limit > 0.0:
            change = worth * gains.throttle_i * error * dt
            self._throttle_integral = clamp(self._throttle_integral + change, 2.0 * GRAVITY_M_S2)
        return made

    def _hover_share(self, thrust: float) -> float:
        """Upward acceleration (m/s²) that a thrust makes of a level vehicle."""
        return GRAVITY_M_S2 * (thrust / self.hover - 1.0)


def _kind(sp: MotionSetpoint, axis: int) -> _Kind:
    if not isnan(sp.position_ned_m[axis]):
        return _Kind.PLACE
    if isnan(sp.velocity_ned_m_s[axis]) and not isnan(sp.acceleration_ned_m_s2[axis]):
        return _Kind.ACCELERATION
    return _Kind.VELOCITY


def _given(value: float) -> float:
    return 0.0 if isnan(value) else value


def _given2(vector: Vector3) -> Two:
    return (_given(vector[0]), _given(vector[1]))


_BODY: Final = (LocalFrame.BODY_NED, LocalFrame.BODY_OFFSET_NED)
_RATES: Final = IgnoreAttitude.ROLL_RATE | IgnoreAttitude.PITCH_RATE | IgnoreAttitude.YAW_RATE
_CLIMB_M_S: Final = 2.5  # WPNAV_SPEED_UP
_HOLDS_HEIGHT: Final = 0.5  # the thrust field as a climb rate


def read_motion(
    fields: StreamedMotion, here_ned_m: Vector3, attitude: Quaternion, heading_rad: float
) -> MotionSetpoint | SetpointRefusal:
    """The setpoint of a message; STOP where ArduCopter stops."""
    mask = fields.mask
    position = None if mask & (Ignore.X | Ignore.Y | Ignore.Z) else fields.position_m
    velocity = None if mask & (Ignore.VX | Ignore.VY | Ignore.VZ) else fields.velocity_m_s
    acceleration = None if mask & (Ignore.AX | Ignore.AY | Ignore.AZ) else fields.acceleration_m_s2
    given = [vector for vector in (position, velocity, acceleration) if vector is not None]
    incomplete = position is not None and velocity is None and acceleration is not None
    force = bool(mask & Ignore.FORCE) and acceleration is not None
    if not given or incomplete or force or not all(map(is_finite, given)) or not _known(fields, position):
        return STOP
    if position is not None and fields.is_global and fields.frame in OVER_TERRAIN:
        return STOP if velocity is not None else SetpointRefusal()  # no terrain data
    body = not fields.is_global and fields.frame in _BODY
    turn = heading_rad if body else 0.0
    if position is not None and not fields.is_global and fields.frame != LocalFrame.LOCAL_NED:
        position = add(rotate_yaw(position, turn), here_ned_m)
    yaw = nan if mask & Ignore.YAW or not isfinite(fields.yaw_rad) else fields.yaw_rad + turn
    rate = fields.yaw_rate_rad_s
    rate = nan if mask & Ignore.YAW_RATE or not isfinite(rate) or (body and not isnan(yaw)) else rate
    return MotionSetpoint(
        NOT_GIVEN if position is None else position,
        NOT_GIVEN if velocity is None else rotate_yaw(velocity, turn),
        NOT_GIVEN if acceleration is None else rotate_yaw(acceleration, turn),
        yaw,
        rate,
        climb_speed_m_s=_CLIMB_M_S,
    )


def _known(fields: StreamedMotion, position: Vector3 | None) -> bool:
    """Whether the frame is known. A global one matters only with a position."""
    if fields.is_global:
        return position is None or fields.frame in set(GlobalFrame)
    return fields.frame in set(LocalFrame)


def read_attitude(fields: StreamedAttitude) -> AttitudeSetpoint | MotionSetpoint | SetpointRefusal:
    """Attitude, body rates or both; STOP without thrust, with some of the rates only, or a non-unit
    attitude."""
    mask, rates = fields.mask, fields.rate_body_rad_s
    if mask & IgnoreAttitude.THROTTLE or not isfinite(fields.thrust):
        return STOP
    attitude = None if mask & IgnoreAttitude.ATTITUDE else unit_attitude(fields.attitude)
    if attitude is None and not mask & IgnoreAttitude.ATTITUDE:
        return STOP
    if mask & _RATES == _RATES:
        rates = ZERO3
    elif mask & _RATES or not is_finite(rates):
        return STOP
    return AttitudeSetpoint(attitude, fields.thrust, rate_body_rad_s=rates)


def as_aged(
    setpoint: MotionSetpoint | AttitudeSetpoint, age_s: float, timeout_s: float, heading_rad: float
) -> MotionSetpoint | AttitudeSetpoint:
    """The setpoint at some age: GUID_TIMEOUT ends all but positions.

    A position with a velocity moves with it until then; afterwards attitudes level out and hold the height,
    velocities and accelerations become a stop, turning ends.
    """
    if isinstance(setpoint, AttitudeSetpoint):
        return setpoint if age_s <= timeout_s else _level(heading_rad)
    placed, moving = not isnan(setpoint.position_ned_m[0]), not isnan(setpoint.velocity_ned_m_s[0])
    if placed and moving:
        way = scale(setpoint.velocity_ned_m_s, min(age_s, timeout_s))
        setpoint = dataclasses.replace(setpoint, position_ned_m=add(setpoint.position_ned_m, way))
    if age_s <= timeout_s:
        return setpoint
    if placed:
        return MotionSetpoint(setpoint.position_ned_m, yaw_rad=setpoint.yaw_rad, streamed=True)
    return dataclasses.replace(STOP, yaw_rad=setpoint.yaw_rad)


def _level(heading_rad: float) -> AttitudeSetpoint:
    half = 0.5 * heading_rad
    return AttitudeSetpoint((cos(half), 0.0, 0.0, sin(half)), _HOLDS_HEIGHT, holds_height=True)
