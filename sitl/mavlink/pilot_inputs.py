"""Messages that control the autopilot without commands: RC override, manual control, LANDING_TARGET.

Each handler takes (autopilot, message, now_s); invalid values are ignored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.landing_target import LandingTarget
from sitl.autopilot.flight.sticks import CHANNELS, Sticks

Message = Any  # pymavlink's classes are generated without types

_LEAVE: Final = 0xFFFF
_RELEASE_UPPER: Final = 0xFFFE
_FULL: Final = 1000
_NOT_GIVEN: Final = 0x7FFF


def channels_overridden(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """RC_CHANNELS_OVERRIDE: 0 releases channels 1 to 8 and leaves 9 to 18, 65534 releases these."""
    values: list[int | None] = []
    for number in range(1, CHANNELS + 1):
        raw = getattr(m, f"chan{number}_raw")
        leaves = raw == _LEAVE or (number > 8 and raw == 0)
        values.append(None if leaves else 0 if number > 8 and raw == _RELEASE_UPPER else raw)
    autopilot.override_rc_channels(values, m.get_srcSystem(), now_s)


def manually_controlled(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """MANUAL_CONTROL: x forward, y right, r clockwise (-1000..1000), z throttle (0..1000, 500 the middle)."""
    axes = [0 if value == _NOT_GIVEN else value for value in (m.y, m.x, 2 * m.z - _FULL, m.r)]
    roll, pitch, throttle, yaw = (min(max(axis / _FULL, -1.0), 1.0) for axis in axes)
    if m.z == _NOT_GIVEN:
        throttle = 0.0
    autopilot.set_manual_control(Sticks(roll, pitch, throttle, yaw), m.get_srcSystem(), now_s)


def target_seen(autopilot: SimulatedAutopilot, m: Message, now_s: float) -> None:
    """LANDING_TARGET: the position if position_valid is 1, else the angles."""
    position = (m.x, m.y, m.z) if m.position_valid == 1 else None
    numbers = (m.angle_x, m.angle_y, m.distance) if position is None else (*position, m.distance)
    if not all(math.isfinite(number) and abs(number) < 1e6 for number in numbers):
        return
    autopilot.handle_landing_target(
        LandingTarget(m.frame, position, (m.angle_x, m.angle_y), max(m.distance, 0.0))
    )


Handler = Callable[[SimulatedAutopilot, Message, float], None]
HANDLERS: Final[dict[int, Handler]] = {
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: channels_overridden,
    mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL: manually_controlled,
    mavlink.MAVLINK_MSG_ID_LANDING_TARGET: target_seen,
}
