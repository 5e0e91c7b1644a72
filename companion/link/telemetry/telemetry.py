"""Telemetry: the autopilot's messages -> AutopilotState. Pure.

One function a message, in a table by message id. The autopilot's frame is its own local NED, origin and all.
Values that are not finite are dropped: the last good one stays.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from companion.base.autopilots import PROFILES, mode_name
from companion.base.geometry import Vector3, quat_from_euler, quat_normalise, vector3
from companion.base.messages import AutopilotState, LandedState
from companion.link.codec import CURRENT_MODE, Message, mavlink

KEPT_TEXTS: Final = 10
_CHUNK_BYTES: Final = 50
AUTOPILOT_KINDS: Final = {profile.mavlink_autopilot: kind for kind, profile in PROFILES.items()}
# What our setpoints, take-off and landing are made for. A VTOL flies as a plane at a mode's change.
_MULTIROTORS: Final = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
    }
)
_LANDED: Final[dict[int, LandedState]] = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: LandedState.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: LandedState.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: LandedState.TAKEOFF,
    mavlink.MAV_LANDED_STATE_LANDING: LandedState.LANDING,
}

# Both are asked for at 5 Hz. An old "on the ground" is no sign of a touchdown, an old altitude no height.
_OLDEST_S: Final = 1.5
# SYS_STATUS is asked for at 2 Hz
_OLDEST_STATUS_S: Final = 3.0

# of EKF_STATUS_REPORT: what ArduCopter's position_ok() asks for before it arms in GUIDED
_EKF_NEEDED: Final = mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ
_EKF_POSITION: Final = mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_POS_HORIZ_REL
_EKF_HINDERS: Final = mavlink.EKF_CONST_POS_MODE | mavlink.EKF_UNINITIALIZED


def update_state(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    """The state after one message of our autopilot's, measured at `time_s` of our clock.

    STATUSTEXT is not among them: its chunks are put together by `StatusTexts` first (see `add_text`).
    """
    handler = _HANDLERS.get(message.get_msgId())
    return state if handler is None else handler(state, message, time_s)


def without_old(state: AutopilotState, now_s: float) -> AutopilotState:
    """The state without where and how it was a while ago, which says nothing of now."""
    if state.landed is not LandedState.UNDEFINED and now_s - state.landed_time_s > _OLDEST_S:
        state = replace(state, time_s=now_s, landed=LandedState.UNDEFINED)
    if state.global_position is not None and now_s - state.global_position_time_s > _OLDEST_S:
        state = replace(state, time_s=now_s, global_position=None)
    told = state.ready_to_arm or state.battery_share is not None
    if told and now_s - state.status_time_s > _OLDEST_STATUS_S:
        state = replace(state, time_s=now_s, ready_to_arm=False, battery_share=None)
    return state


def add_text(state: AutopilotState, text: str, time_s: float) -> AutopilotState:
    """The state with one more of the autopilot's texts; the oldest goes."""
    return replace(state, time_s=time_s, texts=(*state.texts, text)[-KEPT_TEXTS:])


class StatusTexts:
    """Puts one sender's long STATUSTEXTs, sent in chunks, together again; lost chunks are shown as "...".

    (A message's `id` is STATUSTEXT's own field here, not the message id: that is `get_msgId()`.)
    """

    def __init__(self) -> None:
        self._id = 0
        self._next_chunk = 0
        self._text = ""

    def receive(self, message: Message) -> list[str]:
        """The texts that end with this message: usually one, none amid chunks, two after a lost end."""
        ended: list[str] = []
        if self._id and message.id != self._id:
            ended.append(self._text + "...")
            self._id = 0
        if message.id == 0:
            return [*ended, str(message.text)]
        if self._id == 0:
            self._id, self._next_chunk, self._text = message.id, 0, ""
        if message.chunk_seq != self._next_chunk:
            self._text += "..."
        self._text += message.text
        self._next_chunk = message.chunk_seq + 1
        if len(message.text) < _CHUNK_BYTES:
            ended.append(self._text)
            self._id = 0
        return ended


def _heartbeat(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    known = message.type in _MULTIROTORS
    autopilot_kind = AUTOPILOT_KINDS.get(message.autopilot) if known else None
    mode = "" if autopilot_kind is None else mode_name(autopilot_kind, message.custom_mode)
    # another mode is a choice, unless PX4 says that a failsafe flies: then what was intended stays so
    kept = mode == state.mode or message.system_status == mavlink.MAV_STATE_CRITICAL
    profile = None if autopilot_kind is None else PROFILES[autopilot_kind]
    reports_outputs = profile is not None and profile.reports_outputs
    # PX4 says it here, its kill switch too; ArduPilot in SYS_STATUS
    terminated = message.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION
    cut = terminated or (reports_outputs and state.motors_cut)
    # its filter's report is asked for: until that comes it is not known to be ready
    ekf_ready = False if reports_outputs and state.ekf_ready is None else state.ekf_ready
    return replace(
        state,
        time_s=time_s,
        connected=True,
        autopilot_kind=autopilot_kind,
        armed=bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
        mode=mode,
        intended_mode=state.intended_mode if kept else "",
        offboard=profile is not None and mode == profile.control_mode,
        motors_cut=cut,
        ekf_ready=ekf_ready,
    )


def _current_mode(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    """The modes alone, sooner than the next heartbeat has one of them."""
    kind = state.autopilot_kind
    if kind is None or not state.connected:
        return state
    mode, intended = mode_name(kind, message.custom_mode), ""
    if message.intended_custom_mode != 0:  # the message's value for one that is not supplied
        intended = mode_name(kind, message.intended_custom_mode)
    offboard = mode == PROFILES[kind].control_mode
    return replace(state, time_s=time_s, mode=mode, intended_mode=intended, offboard=offboard)


def _autopilot_version(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    """Its firmware's: major, minor and patch are the upper three bytes."""
    major, minor, patch, _ = message.flight_sw_version.to_bytes(4, "big")
    return replace(state, time_s=time_s, version=(major, minor, patch))


def _sys_status(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    """Whether it may be armed, its battery, and whether its outputs are cut."""
    enabled = message.onboard_control_sensors_enabled
    healthy = message.onboard_control_sensors_health
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    profile = None if state.autopilot_kind is None else PROFILES[state.autopilot_kind]
    by_bit = profile is None or profile.prearm_in_health_alone
    if not by_bit and not message.onboard_control_sensors_present & prearm:
        ready = enabled & ~healthy == 0
    else:
        ready = bool(healthy & prearm)
    charge = message.battery_remaining  # percent, -1 unknown
    battery_share = 0.01 * charge if 0 <= charge <= 100 else None
    state = replace(
        state, time_s=time_s, ready_to_arm=ready, battery_share=battery_share, status_time_s=time_s
    )
    if profile is None or not profile.reports_outputs:
        return state
    # an emergency stop, or a safety switch, takes its outputs out of what is enabled (GCS.cpp)
    outputs = mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    stopped = bool(message.onboard_control_sensors_present & outputs and not enabled & outputs)
    return replace(state, motors_cut=stopped and state.armed)


def _ekf_status_report(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    flags = message.flags
    known = flags & _EKF_NEEDED == _EKF_NEEDED and bool(flags & _EKF_POSITION)
    return replace(state, time_s=time_s, ekf_ready=known and not flags & _EKF_HINDERS)


def _extended_sys_state(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    landed = _LANDED.get(message.landed_state, LandedState.UNDEFINED)
    return replace(state, time_s=time_s, landed=landed, landed_time_s=time_s)


def _attitude(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    angles = _finite(message.roll, message.pitch, message.yaw)
    if angles is None or time_s <= state.attitude_time_s:
        return state
    return replace(state, time_s=time_s, attitude=quat_from_euler(*angles), attitude_time_s=time_s)


def _attitude_quaternion(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    quaternion = (message.q1, message.q2, message.q3, message.q4)
    length = math.hypot(*quaternion)
    if not 0.5 < length < 2.0 or time_s <= state.attitude_time_s:
        return state
    return replace(state, time_s=time_s, attitude=quat_normalise(quaternion), attitude_time_s=time_s)


def _attitude_target(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    """Its thrust alone: ArduPilot's before it is raised by the tilt, PX4's along the body."""
    if not math.isfinite(message.thrust) or time_s <= state.thrust_time_s:
        return state
    return replace(state, time_s=time_s, thrust=message.thrust, thrust_time_s=time_s)


def _global_position(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    if message.lat == 0 and message.lon == 0:
        return state  # ArduPilot's value for unknown
    if time_s <= state.global_position_time_s:
        return state
    position = vector3((message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3))
    state = replace(state, time_s=time_s, global_position=position, global_position_time_s=time_s)
    if state.ekf_ready is False or time_s <= state.velocity_time_s:
        return state  # an ArduPilot that does not know it sends zero
    velocity = vector3((message.vx * 1e-2, message.vy * 1e-2, message.vz * 1e-2))
    return replace(state, velocity_ned_m_s=velocity, velocity_time_s=time_s)


def _home_position(state: AutopilotState, message: Message, time_s: float) -> AutopilotState:
    if message.latitude == 0 and message.longitude == 0:
        return state
    home = vector3((message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3))
    return replace(state, time_s=time_s, home=home)


def _finite(x: float, y: float, z: float) -> Vector3 | None:
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None


_HANDLERS: Final[dict[int, Callable[[AutopilotState, Message, float], AutopilotState]]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: _attitude_target,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf_status_report,
    CURRENT_MODE: _current_mode,
}
