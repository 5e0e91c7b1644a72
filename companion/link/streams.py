"""Telemetry rates: asks for each message's rate until it is honoured, and again when it no longer is.

An autopilot that restarts forgets the rates, and another program on the link may change them (MAVSDK sets
EXTENDED_SYS_STATE to 1 Hz), so what counts is what arrives. Pure.
"""

import math
from dataclasses import dataclass
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.link.codec import CURRENT_MODE, mavlink, message_number

# what is decoded; the rest is checked and passed over
HEARD: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        mavlink.MAVLINK_MSG_ID_STATUSTEXT,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_TIMESYNC,
        mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        CURRENT_MODE,
    }
)
TELEMETRY_RATES_HZ: Final[dict[int, float]] = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 30.0,  # a control cycle looks at the newest
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
}
# for whoever takes over by attitude and thrust
THRUST_RATES_HZ: Final[dict[int, float]] = {mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 20.0}
# for whoever tells an autopilot of a place in its own frame, beside its attitude
POSE_RATES_HZ: Final[dict[int, float]] = {mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0}
_WINDOW_S: Final = 2.0
_LONGEST_WINDOW_S: Final = 16.0
_HONOURED_SHARE: Final = 0.6


def telemetry_rates_hz(autopilot_kind: AutopilotKind | None) -> dict[int, float]:
    """Rates (Hz) by message number: of every autopilot, and of this make alone."""
    own = {} if autopilot_kind is None else PROFILES[autopilot_kind].rates_hz
    return TELEMETRY_RATES_HZ | {message_number(name): rate_hz for name, rate_hz in own.items()}


def pose_rates_hz(autopilot_kind: AutopilotKind | None) -> dict[int, float]:
    """Rates (Hz) by message number, of a make that takes landing targets in its own frame alone."""
    local = autopilot_kind is not None and PROFILES[autopilot_kind].target_frame == "local_ned"
    return POSE_RATES_HZ if local else {}


@dataclass(slots=True)
class _Stream:
    rate_hz: float
    window_s: float = 0.0  # 0: ask at once
    since_s: float = 0.0
    count: int = 0


class TelemetryRates:
    """Counts what arrives and says which rates to ask for."""

    def __init__(self, rates_hz: dict[int, float] | None = None) -> None:
        rates = TELEMETRY_RATES_HZ if rates_hz is None else rates_hz
        self._streams = {message_id: _Stream(rate_hz) for message_id, rate_hz in rates.items()}
        self._due_s = -math.inf  # when the next window ends

    def want(self, rates_hz: dict[int, float]) -> None:
        """Ask for these as well; what is wanted already stays as it is."""
        for message_id, rate_hz in rates_hz.items():
            if message_id not in self._streams:
                self._streams[message_id] = _Stream(rate_hz)
                self._due_s = -math.inf

    def heard(self, message_id: int) -> None:
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.count += 1

    def to_ask(self, now_s: float) -> list[tuple[int, float]]:
        """Message ids and rates (Hz) to ask for now: all at first, later those that come too seldom.

        A rate that is never honoured (a slow serial line) is asked for less and less often.
        """
        asked: list[tuple[int, float]] = []
        if now_s < self._due_s:
            return asked
        for message_id, stream in self._streams.items():
            if stream.window_s > 0.0 and now_s - stream.since_s < stream.window_s:
                continue
            expected = _HONOURED_SHARE * stream.rate_hz * (now_s - stream.since_s)
            if stream.window_s > 0.0 and stream.count >= expected:
                stream.window_s = _WINDOW_S
            else:
                asked.append((message_id, stream.rate_hz))
                stream.window_s = min(max(2.0 * stream.window_s, _WINDOW_S), _LONGEST_WINDOW_S)
            stream.since_s, stream.count = now_s, 0
        self._due_s = min(
            (stream.since_s + stream.window_s for stream in self._streams.values()), default=math.inf
        )
        return asked

    def forget(self) -> None:
        """The autopilot was lost: ask for everything at once when it is back."""
        for stream in self._streams.values():
            stream.window_s, stream.count = 0.0, 0
        self._due_s = -math.inf
