"""Others on the link that command our vehicle: a companion with our ids, and whoever sends setpoints. Pure.

A second companion with another component id is a component of the vehicle's like any other, until it sends
setpoints. (A router passes those on to the autopilot alone: then only the autopilot's mode tells.)
"""

from dataclasses import replace
from typing import Final

from companion.base.messages import AutopilotState
from companion.link.codec import Message, is_twins_heartbeat, mavlink

SETPOINT_MESSAGES: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    }
)


def with_twin(
    state: AutopilotState, message: Message, us: tuple[int, int], process: int, now_s: float
) -> AutopilotState | None:
    """The state with what this message tells of them; None: it is no such message."""
    if is_twins_heartbeat(message, us, process):
        return replace(state, twin_time_s=now_s)
    if message.get_msgId() not in SETPOINT_MESSAGES:
        return None
    sender = message.get_srcSystem(), message.get_srcComponent()
    ours = sender == us or message.target_system not in {0, us[0]}
    return state if ours else replace(state, rival=sender, rival_time_s=now_s)
