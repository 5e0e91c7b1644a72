"""What the autopilot is told to fly, and how a streamed setpoint's frame and mask become one.

NED in the autopilot's own heading frame, SI units; what is not given is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from math import isfinite, nan

from companion.geometry import Quaternion, Vector3, add, rotate_yaw

NOT_GIVEN: Vector3 = (nan, nan, nan)


@dataclass(frozen=True, slots=True)
class MotionSetpoint:
    """Position, velocity, acceleration and heading. North and east are given together or not at all."""

    position_ned_m: Vector3 = NOT_GIVEN
    velocity_ned_m_s: Vector3 = NOT_GIVEN
    acceleration_ned_m_s2: Vector3 = NOT_GIVEN
    yaw_rad: float = nan
    yaw_rate_rad_s: float = nan
    horizontal_speed_m_s: float = 12.0
    climb_speed_m_s: float = 3.0
    descent_speed_m_s: float = 1.5


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """Attitude (body to NED) and the field `thrust` (0..1), whose meaning is the autopilot's manner."""

    attitude: Quaternion
    thrust: float
    yaw_rate_rad_s: float = 0.0


class Frame(IntEnum):
    """MAV_FRAME of SET_POSITION_TARGET_LOCAL_NED."""

    LOCAL_NED = 1
    LOCAL_OFFSET_NED = 7
    BODY_NED = 8
    BODY_OFFSET_NED = 9


class Ignore(IntFlag):
    """POSITION_TARGET_TYPEMASK: a set bit means that the field is not to be used."""

    X, Y, Z = 1, 2, 4
    VX, VY, VZ = 8, 16, 32
    AX, AY, AZ = 64, 128, 256
    FORCE = 512
    YAW = 1024
    YAW_RATE = 2048


@dataclass(frozen=True, slots=True)
class StreamedMotion:
    """The fields of SET_POSITION_TARGET_LOCAL_NED in SI units; `frame` may be one that nobody knows."""

    frame: int
    mask: int
    position_m: Vector3
    velocity_m_s: Vector3
    acceleration_m_s2: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float


def motion_from_fields(
    fields: StreamedMotion, here_ned_m: Vector3, heading_rad: float, top_speed_m_s: float = 12.0
) -> MotionSetpoint:
    """The setpoint that a message's fields, mask and frame stand for, seen from here and this heading.

    The body frames are level: forward and right along the heading at the time of reception.

    Raises:
        ValueError: the frame is not one of `Frame`.
    """
    frame, mask = Frame(fields.frame), fields.mask
    position, velocity, acceleration = fields.position_m, fields.velocity_m_s, fields.acceleration_m_s2
    yaw = fields.yaw_rad
    if frame in (Frame.BODY_NED, Frame.BODY_OFFSET_NED):
        position, velocity = rotate_yaw(position, heading_rad), rotate_yaw(velocity, heading_rad)
        acceleration = rotate_yaw(acceleration, heading_rad)
        yaw += heading_rad
    if frame is not Frame.LOCAL_NED:
        position = add(position, here_ned_m)
    return MotionSetpoint(
        _masked(position, mask, Ignore.X | Ignore.Y, Ignore.Z),
        _masked(velocity, mask, Ignore.VX | Ignore.VY, Ignore.VZ),
        _masked(acceleration, mask, Ignore.AX | Ignore.AY, Ignore.AZ),
        nan if mask & Ignore.YAW or not isfinite(yaw) else yaw,
        nan if mask & Ignore.YAW_RATE or not isfinite(fields.yaw_rate_rad_s) else fields.yaw_rate_rad_s,
        horizontal_speed_m_s=top_speed_m_s,
    )


def _masked(vector: Vector3, mask: int, horizontal: int, vertical: int) -> Vector3:
    x, y, z = vector
    if mask & horizontal or not (isfinite(x) and isfinite(y)):
        x = y = nan
    if mask & vertical or not isfinite(z):
        z = nan
    return (x, y, z)
