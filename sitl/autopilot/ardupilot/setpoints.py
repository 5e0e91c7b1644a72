"""Streamed setpoints as ArduCopter 4.6 reads them in GUIDED (GCS_MAVLink_Copter), and their time-out.

Position, velocity and acceleration are each taken whole: one ignored axis ignores all three. Position alone,
position with velocity, velocity, and acceleration (each with what stands after it) are flown; everything else
stops the vehicle without a text: an unknown frame, a force, a position with an acceleration alone,
numbers that are not finite. NED, SI units.
"""

import dataclasses
from math import cos, isfinite, isnan, nan, sin
from typing import Final

from companion.base.geometry import ZERO3, Quaternion, Vector3, add, rotate_yaw, scale
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
