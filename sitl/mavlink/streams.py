"""The rate of each telemetry message on one link, and the groups of the older stream requests.

Every link has its own rates: MAV_CMD_SET_MESSAGE_INTERVAL sets one message's, REQUEST_DATA_STREAM (which
ArduPilot still supports and PX4 does not) a whole group's.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from companion.base.autopilot_kind import AutopilotKind
from companion.link.codec import CURRENT_MODE
from sitl.mavlink.framing import dialect

mavlink: Any = dialect

_LOWEST_RATE_HZ: Final = 0.01
_HIGHEST_RATE_HZ: Final = 200.0
DEFAULT_RATES_HZ: Final[dict[int, float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    CURRENT_MODE: 0.5,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: 2.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 2.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 2.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_VIBRATION: 0.5,
}


# of REQUEST_DATA_STREAM (MAV_DATA_STREAM), as ArduCopter 4.6 groups its messages
STREAM_GROUPS: Final[dict[AutopilotKind, dict[int, tuple[int, ...]]]] = {
    "px4": {},
    "ardupilot": {
        mavlink.MAV_DATA_STREAM_RAW_SENSORS: (
            mavlink.MAVLINK_MSG_ID_RAW_IMU,
            mavlink.MAVLINK_MSG_ID_SCALED_IMU,
            mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
        ),
        mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
            mavlink.MAVLINK_MSG_ID_SYS_STATUS,
            mavlink.MAVLINK_MSG_ID_POWER_STATUS,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
            mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        ),
        mavlink.MAV_DATA_STREAM_RC_CHANNELS: (
            mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
        ),
        mavlink.MAV_DATA_STREAM_POSITION: (
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        ),
        mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
        mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
        mavlink.MAV_DATA_STREAM_EXTRA3: (
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
            mavlink.MAVLINK_MSG_ID_VIBRATION,
        ),
    },
}


def grouped_messages(autopilot: AutopilotKind, group: int) -> tuple[int, ...]:
    """Message ids of a MAV_DATA_STREAM; none when the autopilot does not know it."""
    groups = STREAM_GROUPS[autopilot]
    if group == mavlink.MAV_DATA_STREAM_ALL:
        return tuple(message_id for members in groups.values() for message_id in members)
    return groups.get(group, ())


class Streams:
    """Selects the telemetry that is due; rates can be changed at any time."""

    def __init__(self, exists: Callable[[int], bool]) -> None:
        """Stream by default what is in `DEFAULT_RATES_HZ` and `exists`."""
        self._default_s = {
            message_id: 1.0 / rate for message_id, rate in DEFAULT_RATES_HZ.items() if exists(message_id)
        }
        self._period_s = dict(self._default_s)
        self._due_s = dict.fromkeys(self._period_s, -math.inf)
        self._next_s = -math.inf

    def period_s(self, message_id: int) -> float | None:
        """Seconds between two of a message, None when it is not streamed."""
        return self._period_s.get(message_id)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: -1 stops, 0 is the default; False when it is not finite."""
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
