"""Converts commanded acceleration and heading to attitude and thrust, and back.

A multirotor's thrust acts along its up axis. So the required specific force f = u - g (NED, g down)
determines this axis, and the heading determines the rest (eq. 6, inverted). Frames: NED and FRD;
quaternions body to NED; the heading is the yaw of the aerospace angles.
"""

import math

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    Vector3,
    norm,
    quat_from_euler,
    rotate_yaw,
)

# below this share of g upwards the force's direction no longer says where up is
MINIMUM_UPWARD_FORCE_M_S2 = 0.2 * GRAVITY_M_S2


def force_from_acceleration(acceleration_ned_m_s2: Vector3) -> Vector3:
    """Specific force (m/s2, NED) that makes an acceleration; at hover (0, 0, -9.8). Never points down."""
    x, y, z = acceleration_ned_m_s2
    return (x, y, min(z - GRAVITY_M_S2, -MINIMUM_UPWARD_FORCE_M_S2))


def attitude_from_acceleration(acceleration_ned_m_s2: Vector3, heading_rad: float) -> Quaternion:
    """Attitude whose up axis lies along the needed force and whose yaw is the heading."""
    force = force_from_acceleration(acceleration_ned_m_s2)
    length = norm(force)
    down = rotate_yaw((-force[0] / length, -force[1] / length, -force[2] / length), -heading_rad)
    # the body's down axis is (sin p cos r, -sin r, cos p cos r) in axes turned by the yaw
    roll = -math.asin(max(-1.0, min(1.0, down[1])))
    return quat_from_euler(roll, math.atan2(down[0], down[2]), heading_rad)


def thrust_from_acceleration(acceleration_ned_m_s2: Vector3, hover_thrust: float) -> float:
    """Collective thrust (0..1 of the autopilot's scale) for an acceleration, thrust taken as linear."""
    return hover_thrust * norm(force_from_acceleration(acceleration_ned_m_s2)) / GRAVITY_M_S2
