"""Whoever else sends on the vehicle's link: a second companion, and somebody without the key. Sans I/O."""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

from sitl.mavlink.framing import dialect

mavlink: Any = dialect

_VEHICLE: Final = (1, 1)
_WRONG_KEY: Final = b"not the key of this vehicle, 32b."[:32]
_LATEST_STAMP: Final = (1 << 48) - 256  # the packer counts on from it
_VELOCITY_ALONE: Final = 0b0000_1101_1100_0111  # of a setpoint's mask: what is ignored


class Intruder(Protocol):
    """Somebody on the link."""

    def due(self, now_s: float) -> bytes:
        """A frame, when one is due."""
        ...


class Companion:
    """Tells the vehicle to stand still, in its own name, as often as a companion does."""

    def __init__(self, component_id: int, period_s: float) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=_VEHICLE[0], srcComponent=component_id)
        self._period_s, self._due_s = period_s, -math.inf

    def due(self, now_s: float) -> bytes:
        """See `Intruder`."""
        if now_s < self._due_s:
            return b""
        self._due_s = now_s + self._period_s
        message = mavlink.MAVLink_set_position_target_local_ned_message(
            max(0, round(now_s * 1e3)), *_VEHICLE, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY_ALONE,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        return _packed(self._mav, message)


class Forger:
    """Sends heartbeats as the vehicle's, signed with another key, from the end of time."""

    def __init__(self, period_s: float) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=_VEHICLE[0], srcComponent=_VEHICLE[1])
        self._mav.signing.secret_key, self._mav.signing.sign_outgoing = _WRONG_KEY, True
        self._mav.signing.timestamp = _LATEST_STAMP
        self._period_s, self._due_s = period_s, -math.inf

    def due(self, now_s: float) -> bytes:
        """See `Intruder`."""
        if now_s < self._due_s:
            return b""
        self._due_s = now_s + self._period_s
        message = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, mavlink.MAV_STATE_STANDBY, 3
        )
        self._mav.signing.timestamp = _LATEST_STAMP
        return _packed(self._mav, message)


def _packed(mav: Any, message: Any) -> bytes:
    packed = bytes(message.pack(mav))
    mav.seq = (mav.seq + 1) % 256
    return packed
