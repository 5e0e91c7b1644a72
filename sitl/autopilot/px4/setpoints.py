"""Streamed setpoints as PX4 1.16 reads them: mavlink_receiver, and its position controller's input checks.

LOCAL_NED is taken field by field, BODY_NED for velocity and acceleration, all three axes or none; any other
frame is rejected with a text, so that OFFBOARD ends without setpoints. An axis without any value, or a north
without its east, stops the vehicle. NED, SI units.
"""

from math import isfinite, isnan, nan
from typing import Final

from companion.base.geometry import Quaternion, Vector3, quat_rotate, rotate_yaw
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
