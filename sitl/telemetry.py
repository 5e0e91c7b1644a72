"""What the simulated autopilot tells of itself: one function a message, and how often each goes out.

What its sensors measure is in `sensor_telemetry`.
Built from the autopilot's own estimate, in the units that MAVLink asks for (degrees times 1e7, mm, cm/s).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from companion.geometry import Vector3, euler_from_quat
from companion.messages import LandedState
from sitl import mission_protocol
from sitl.autopilot import Autopilot

Message = Any  # pymavlink's classes are generated without types

_SENSORS: Final = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_ESTIMATES: Final = mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_AHRS
_LANDED: Final = {
    LandedState.UNDEFINED: mavlink.MAV_LANDED_STATE_UNDEFINED,
    LandedState.ON_GROUND: mavlink.MAV_LANDED_STATE_ON_GROUND,
    LandedState.IN_AIR: mavlink.MAV_LANDED_STATE_IN_AIR,
    LandedState.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    LandedState.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}
_CELL_MV: Final = (4100, 4100, 4100, *(65535,) * 7)
_LOWEST_RATE_HZ: Final = 0.01
_HIGHEST_RATE_HZ: Final = 200.0


def milliseconds(autopilot: Autopilot, now_s: float) -> int:
    """Time since boot (ms), 0 before it."""
    return 0 if autopilot.booted_s is None else max(0, round((now_s - autopilot.booted_s) * 1e3))


def heartbeat(autopilot: Autopilot, now_s: float) -> Message:
    """HEARTBEAT: mode, armed, state."""
    base_mode, custom_mode = autopilot.mode_numbers
    if autopilot.in_failsafe:
        state = mavlink.MAV_STATE_CRITICAL
    elif autopilot.armed:
        state = mavlink.MAV_STATE_ACTIVE
    else:
        state = mavlink.MAV_STATE_STANDBY if autopilot.aligned else mavlink.MAV_STATE_CALIBRATING
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, autopilot.manner.autopilot_id, base_mode, custom_mode, state, 3
    )


def sys_status(autopilot: Autopilot, now_s: float) -> Message:
    """SYS_STATUS: which sensors are well, and whether it would arm."""
    present = _SENSORS | _ESTIMATES | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    health = _SENSORS | (_ESTIMATES if autopilot.aligned else 0)
    if autopilot.ready_to_arm:
        health |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return mavlink.MAVLink_sys_status_message(
        present, present, health, 300, 12300, 1500, 90, 0, 0, 0, 0, 0, 0
    )


def attitude(autopilot: Autopilot, now_s: float) -> Message:
    """ATTITUDE in Euler angles."""
    estimate = autopilot.estimate
    return mavlink.MAVLink_attitude_message(
        milliseconds(autopilot, now_s), *euler_from_quat(estimate.attitude), *estimate.rate_body_rad_s
    )


def attitude_quaternion(autopilot: Autopilot, now_s: float) -> Message:
    """ATTITUDE_QUATERNION."""
    estimate = autopilot.estimate
    return mavlink.MAVLink_attitude_quaternion_message(
        milliseconds(autopilot, now_s), *estimate.attitude, *estimate.rate_body_rad_s
    )


def attitude_target(autopilot: Autopilot, now_s: float) -> Message:
    """ATTITUDE_TARGET: what the inner loop follows."""
    return mavlink.MAVLink_attitude_target_message(
        milliseconds(autopilot, now_s), 7, autopilot.attitude_setpoint, 0.0, 0.0, 0.0, autopilot.thrust
    )


def local_position(autopilot: Autopilot, now_s: float) -> Message | None:
    """LOCAL_POSITION_NED, once there is a position."""
    if not autopilot.aligned:
        return None
    estimate = autopilot.estimate
    return mavlink.MAVLink_local_position_ned_message(
        milliseconds(autopilot, now_s), *estimate.position_ned_m, *estimate.velocity_ned_m_s
    )


def global_position(autopilot: Autopilot, now_s: float) -> Message | None:
    """GLOBAL_POSITION_INT, once there is a position."""
    if not autopilot.aligned:
        return None
    estimate = autopilot.estimate
    latitude, longitude, altitude = _scaled(autopilot, estimate.position_ned_m)
    over_home = autopilot.home_ned_m[2] - estimate.position_ned_m[2]
    north, east, down = (_bounded(100.0 * speed, 32767) for speed in estimate.velocity_ned_m_s)
    heading = round(math.degrees(euler_from_quat(estimate.attitude)[2]) * 100.0) % 36000
    return mavlink.MAVLink_global_position_int_message(
        milliseconds(autopilot, now_s), latitude, longitude, altitude, round(1e3 * over_home),
        north, east, down, heading,
    )  # fmt: skip


def home_position(autopilot: Autopilot, now_s: float) -> Message | None:
    """HOME_POSITION: where it was armed, in both kinds of coordinates."""
    if not autopilot.aligned:
        return None
    home = autopilot.home_ned_m
    return mavlink.MAVLink_home_position_message(
        *_scaled(autopilot, home), *home, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
    )


def gps_global_origin(autopilot: Autopilot, now_s: float) -> Message | None:
    """GPS_GLOBAL_ORIGIN of its local frame."""
    if not autopilot.aligned:
        return None
    return mavlink.MAVLink_gps_global_origin_message(*_scaled(autopilot, (0.0, 0.0, 0.0)))


def extended_sys_state(autopilot: Autopilot, now_s: float) -> Message:
    """EXTENDED_SYS_STATE: on the ground or not."""
    return mavlink.MAVLink_extended_sys_state_message(0, _LANDED[autopilot.landed_state])


def rc_channels(autopilot: Autopilot, now_s: float) -> Message | None:
    """RC_CHANNELS: the sticks and switches (microseconds), once there is somebody at them."""
    channels = autopilot.radio.channels
    if channels is None:
        return None
    return mavlink.MAVLink_rc_channels_message(milliseconds(autopilot, now_s), len(channels), *channels, 255)


def mission_current(autopilot: Autopilot, now_s: float) -> Message:
    """MISSION_CURRENT."""
    return mission_protocol.mission_current(autopilot.mission)


def battery_status(autopilot: Autopilot, now_s: float) -> Message:
    """BATTERY_STATUS of a battery that never drains."""
    return mavlink.MAVLink_battery_status_message(0, 1, 1, 32767, _CELL_MV, 1500, -1, -1, 90)


def system_time(autopilot: Autopilot, now_s: float) -> Message:
    """SYSTEM_TIME since boot; the world's time is not known here."""
    return mavlink.MAVLink_system_time_message(0, milliseconds(autopilot, now_s))


def autopilot_version(autopilot: Autopilot, now_s: float) -> Message:
    """AUTOPILOT_VERSION: capabilities and version."""
    manner = autopilot.manner
    return mavlink.MAVLink_autopilot_version_message(
        manner.capabilities, manner.flight_version, 0, 0, 1, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1
    )


def _scaled(autopilot: Autopilot, position_ned_m: Vector3) -> tuple[int, int, int]:
    latitude, longitude, altitude = autopilot.geodetic(position_ned_m)
    return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)


def _bounded(value: float, limit: int) -> int:
    return max(-limit, min(limit, round(value)))


Builder = Callable[[Autopilot, float], Message | None]
BUILDERS: Final[dict[int, Builder]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: attitude_target,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: rc_channels,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
}
DEFAULT_RATES_HZ: Final[dict[int, float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 2.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
}


class Streams:
    """Which telemetry is due; rates can be changed at any time."""

    def __init__(self) -> None:
        self._default_s = {message_id: 1.0 / rate for message_id, rate in DEFAULT_RATES_HZ.items()}
        self._period_s = dict(self._default_s)
        self._due_s = dict.fromkeys(self._period_s, -math.inf)
        self._next_s = -math.inf

    def period_s(self, message_id: int) -> float | None:
        """Seconds between two of a message, None when it is not streamed."""
        return self._period_s.get(message_id)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: -1 stops, 0 is the default; False when that is no interval."""
        if not math.isfinite(interval_us):
            return False
        default = self._default_s.get(message_id)
        period = interval_us * 1e-6 if interval_us > 0.0 else default if interval_us == 0.0 else None
        if period is None:
            self._period_s.pop(message_id, None)
        else:
            self._period_s[message_id] = min(max(period, 1.0 / _HIGHEST_RATE_HZ), 1.0 / _LOWEST_RATE_HZ)
            self._due_s[message_id] = -math.inf
            self._next_s = -math.inf
        return True

    def due(self, now_s: float) -> list[int]:
        """Message ids to send now; most calls find nothing and cost next to nothing."""
        if now_s < self._next_s:
            return []
        soonest, found = math.inf, []
        for message_id, period in self._period_s.items():
            due = self._due_s[message_id]
            if now_s >= due:
                found.append(message_id)
                # keep the rate when called a little late, but never catch up by a burst
                due = due + period if now_s - due < period else now_s + period
                self._due_s[message_id] = due
            soonest = min(soonest, due)
        self._next_s = soonest - 1e-6
        return found
