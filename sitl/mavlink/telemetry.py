"""Telemetry of the simulated autopilot: one function per message.

Sensor messages are in `sensor_telemetry`.
Built from the autopilot's estimate, in MAVLink's units (degrees times 1e7, mm, cm/s).
"""

import math
from collections.abc import Callable
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import Vector3, euler_from_quat, norm
from companion.link.codec import CURRENT_MODE, CurrentMode, Message, mavlink
from sitl.autopilot.control.position_control import tilt_cosine
from sitl.autopilot.control.setpoints import AttitudeSetpoint
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.mavlink.mission_protocol import mission_current
from sitl.vehicle.battery import CELLS

_SENSORS: Final = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_ESTIMATES: Final = mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_AHRS
_ESTIMATOR_FLAGS: Final = (
    mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_HORIZ_REL
    | mavlink.ESTIMATOR_POS_HORIZ_ABS
    | mavlink.ESTIMATOR_POS_VERT_ABS
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_TEST_RATIOS: Final = (0.05, 0.05, 0.03, 0.05)  # velocity, horizontal and vertical position, compass
_ACCURACY_M: Final = (0.8, 0.5)
_CHANNELS: Final = 18
_NO_CHANNEL: Final = 65535
_RSSI_UNKNOWN: Final = 255
_MOST_INT32: Final = 2**31 - 1
_NO_CELL: Final = 65535
_TEMPERATURE_UNKNOWN: Final = 32767
_LOW_PERCENT, _CRITICAL_PERCENT = 15, 7  # PX4's BAT_LOW_THR and BAT_CRIT_THR


def milliseconds(autopilot: SimulatedAutopilot, now_s: float) -> int:
    """Time since boot (ms), 0 before it."""
    return 0 if autopilot.booted_s is None else max(0, round((now_s - autopilot.booted_s) * 1e3))


def heartbeat(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    base_mode, custom_mode = autopilot.mode_numbers
    if autopilot.commander.in_failsafe:
        state = mavlink.MAV_STATE_CRITICAL
    elif autopilot.armed:
        state = mavlink.MAV_STATE_ACTIVE
    else:
        state = mavlink.MAV_STATE_STANDBY if autopilot.aligned else mavlink.MAV_STATE_CALIBRATING
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, autopilot.profile.autopilot_id, base_mode, custom_mode, state, 3
    )


def current_mode(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """CURRENT_MODE of a PX4 from 1.15 on; it names no standard mode of most of its modes."""
    _, custom_mode = autopilot.mode_numbers
    return CurrentMode(0, custom_mode, autopilot.commander.intended_mode.custom_mode)


def sys_status(autopilot: SimulatedAutopilot, now_s: float, unhealthy: int = 0) -> Message:
    """SYS_STATUS: which sensors are well, and whether it would arm; `unhealthy`: bits of those that are
    not."""
    present = _SENSORS | _ESTIMATES
    if not autopilot.profile.prearm_in_health_only:
        present |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
    health = (_SENSORS | (_ESTIMATES if autopilot.aligned else 0)) & ~unhealthy
    if autopilot.ready_to_arm:
        health |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
    # without a fence it is not breached: a ground station takes a missing bit for a breach
    if not autopilot.fence_broken:
        health |= mavlink.MAV_SYS_STATUS_GEOFENCE
    if autopilot.fence.items or autopilot.fence_enabled:
        present |= mavlink.MAV_SYS_STATUS_GEOFENCE
    enabled = present if autopilot.fence_enabled else present & ~mavlink.MAV_SYS_STATUS_GEOFENCE
    battery = autopilot.battery
    return mavlink.MAVLink_sys_status_message(
        present, enabled, health, 300, round(1e3 * battery.voltage_v), round(1e2 * battery.current_a),
        autopilot.battery_percent, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def attitude(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """ATTITUDE in Euler angles."""
    estimate = autopilot.estimate
    return mavlink.MAVLink_attitude_message(
        milliseconds(autopilot, now_s), *euler_from_quat(estimate.attitude), *estimate.rate_body_rad_s
    )


def attitude_quaternion(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    estimate = autopilot.estimate
    return mavlink.MAVLink_attitude_quaternion_message(
        milliseconds(autopilot, now_s), *estimate.attitude, *estimate.rate_body_rad_s
    )


def attitude_target(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """ATTITUDE_TARGET: what the inner loop follows; ArduPilot's thrust is not raised by the tilt yet."""
    thrust = autopilot.thrust
    if autopilot.profile.thrust_is_upward:
        thrust *= tilt_cosine(autopilot.estimate.attitude)
    return mavlink.MAVLink_attitude_target_message(
        milliseconds(autopilot, now_s), 7, autopilot.attitude_setpoint, 0.0, 0.0, 0.0, thrust
    )


def local_position(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """LOCAL_POSITION_NED, once there is a position."""
    if not autopilot.aligned:
        return None
    estimate = autopilot.estimate
    return mavlink.MAVLink_local_position_ned_message(
        milliseconds(autopilot, now_s), *estimate.position_ned_m, *estimate.velocity_ned_m_s
    )


def global_position(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """GLOBAL_POSITION_INT, once there is a position."""
    if not autopilot.aligned:
        return None
    estimate = autopilot.estimate
    latitude, longitude, altitude = _scaled(autopilot, estimate.position_ned_m)
    over_home = autopilot.home_ned_m[2] - estimate.position_ned_m[2]
    north, east, down = (_bounded(100.0 * speed, 32767) for speed in estimate.velocity_ned_m_s)
    heading = round(math.degrees(euler_from_quat(estimate.attitude)[2]) * 100.0) % 36000
    return mavlink.MAVLink_global_position_int_message(
        milliseconds(autopilot, now_s), latitude, longitude, altitude, _bounded(1e3 * over_home, _MOST_INT32),
        north, east, down, heading,
    )  # fmt: skip


def home_position(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """HOME_POSITION: where it was armed, in both kinds of coordinates."""
    if not autopilot.commander.situation.home_set:
        return None
    home = autopilot.home_ned_m
    return mavlink.MAVLink_home_position_message(
        *_scaled(autopilot, home), *home, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
    )


def gps_global_origin(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """GPS_GLOBAL_ORIGIN of its local frame."""
    if not autopilot.aligned:
        return None
    return mavlink.MAVLink_gps_global_origin_message(*_scaled(autopilot, (0.0, 0.0, 0.0)))


def extended_sys_state(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    landed: int = getattr(mavlink, f"MAV_LANDED_STATE_{autopilot.landed_state.name}")
    return mavlink.MAVLink_extended_sys_state_message(0, landed)


def battery_status(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """BATTERY_STATUS: of each cell, and what has been consumed."""
    battery, percent = autopilot.battery, autopilot.battery_percent
    cells = (round(1e3 * battery.voltage_v / CELLS),) * CELLS + (_NO_CELL,) * (10 - CELLS)
    state = mavlink.MAV_BATTERY_CHARGE_STATE_OK
    if percent <= _LOW_PERCENT:
        critical = percent <= _CRITICAL_PERCENT
        low = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
        state = mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL if critical else low
    return mavlink.MAVLink_battery_status_message(
        0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, _TEMPERATURE_UNKNOWN, cells,
        round(1e2 * battery.current_a), round(battery.consumed_mah), round(1e-2 * battery.consumed_j),
        percent, 0, state,
    )  # fmt: skip


def system_time(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """SYSTEM_TIME since boot; the world's time is not known here."""
    return mavlink.MAVLink_system_time_message(0, milliseconds(autopilot, now_s))


def autopilot_version(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    profile = autopilot.profile
    return mavlink.MAVLink_autopilot_version_message(
        profile.capabilities, profile.flight_version, 0, 0, 1, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1
    )


def vfr_hud(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """VFR_HUD: speeds, heading, throttle and the altitude above sea level; it has no airspeed sensor."""
    if not autopilot.aligned:
        return None
    estimate = autopilot.estimate
    north, east, down = estimate.velocity_ned_m_s
    ground_speed = norm((north, east, 0.0))
    heading = round(math.degrees(euler_from_quat(estimate.attitude)[2])) % 360
    throttle = round(100.0 * autopilot.thrust) if autopilot.armed else 0
    altitude_m = autopilot.geodetic(estimate.position_ned_m)[2]
    return mavlink.MAVLink_vfr_hud_message(ground_speed, ground_speed, heading, throttle, altitude_m, -down)


def altitude(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """ALTITUDE above sea level, over the local frame's origin and over home; of terrain it knows nothing."""
    if not autopilot.aligned:
        return None
    down = autopilot.estimate.position_ned_m[2]
    amsl_m = autopilot.geodetic(autopilot.estimate.position_ned_m)[2]
    return mavlink.MAVLink_altitude_message(
        1000 * milliseconds(autopilot, now_s), amsl_m, amsl_m, -down, autopilot.home_ned_m[2] - down,
        math.nan, math.nan,
    )  # fmt: skip


def position_target(autopilot: SimulatedAutopilot, now_s: float) -> Message | None:
    """POSITION_TARGET_LOCAL_NED: the motion that is flown; while an attitude is flown there is none."""
    wanted = autopilot.wanted
    if not autopilot.armed or wanted is None or isinstance(wanted, AttitudeSetpoint):
        return None
    fields = (
        *wanted.position_ned_m, *wanted.velocity_ned_m_s, *wanted.acceleration_ned_m_s2,
        wanted.yaw_rad, wanted.yaw_rate_rad_s,
    )  # fmt: skip
    bits = (*(1 << n for n in range(9)), 1 << 10, 1 << 11)  # bit 9 means force, not acceleration
    mask = sum(bit for bit, value in zip(bits, fields, strict=True) if math.isnan(value))
    return mavlink.MAVLink_position_target_local_ned_message(
        milliseconds(autopilot, now_s), mavlink.MAV_FRAME_LOCAL_NED, mask, *fields
    )


def rc_channels(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """RC_CHANNELS: sticks and switches (microseconds); none without RC input."""
    channels = autopilot.rc_input.channels
    return mavlink.MAVLink_rc_channels_message(
        milliseconds(autopilot, now_s),
        0 if channels is None else len(channels),
        *((_NO_CHANNEL,) * _CHANNELS if channels is None else channels),
        _RSSI_UNKNOWN,
    )


def estimator_status(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """ESTIMATOR_STATUS (PX4): what its filter knows, and test ratios as in a calm hover."""
    flags = mavlink.ESTIMATOR_ATTITUDE | (_ESTIMATOR_FLAGS if autopilot.aligned else 0)
    return mavlink.MAVLink_estimator_status_message(
        1000 * milliseconds(autopilot, now_s), flags, *_TEST_RATIOS, 0.0, 0.0, *_ACCURACY_M
    )


def ekf_status_report(autopilot: SimulatedAutopilot, now_s: float) -> Message:
    """EKF_STATUS_REPORT (ArduPilot): the same as ESTIMATOR_STATUS in its own words."""
    # its flags have the same bits
    flags = mavlink.EKF_ATTITUDE | (_ESTIMATOR_FLAGS if autopilot.aligned else mavlink.EKF_CONST_POS_MODE)
    return mavlink.MAVLink_ekf_status_report_message(flags, *_TEST_RATIOS, 0.0)


def _scaled(autopilot: SimulatedAutopilot, position_ned_m: Vector3) -> tuple[int, int, int]:
    latitude, longitude, altitude = autopilot.geodetic(position_ned_m)
    return round(latitude * 1e7), round(longitude * 1e7), _bounded(altitude * 1e3, _MOST_INT32)


def _bounded(value: float, limit: int) -> int:
    return max(-limit, min(limit, round(value)))


Builder = Callable[[SimulatedAutopilot, float], Message | None]
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
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: position_target,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: rc_channels,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: lambda autopilot, _: mission_current(autopilot.mission),
}
OWN_BUILDERS: Final[dict[AutopilotKind, dict[int, Builder]]] = {
    "px4": {
        CURRENT_MODE: current_mode,
        mavlink.MAVLINK_MSG_ID_ALTITUDE: altitude,
        mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    },
    "ardupilot": {mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report},
}


def builders_of(autopilot: AutopilotKind) -> dict[int, Builder]:
    """The messages of one autopilot, its sensors' apart."""
    return BUILDERS | OWN_BUILDERS[autopilot]
