"""A ground station at the pad, sans I/O: it sends the pad's position.

MAVLink system 255, component 190. On a request for FOLLOW_TARGET (MAV_CMD_REQUEST_MESSAGE) it sends the
position of the pad's own GPS half a second later: a receiver of the NEO-6M's class (2.5 m CEP), which is off
by a constant and a little noise. `position_cov` holds standard deviations (eph, eph, epv), m. Truth in, NED.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, Final

import numpy as np

from companion.base.geometry import ZERO3, Vector3, geodetic_from_ned
from companion.link.codec import mavlink
from sitl.mavlink.framing import FrameReader, MavFrame, Signing, packed
from sitl.scenario.scenario import BeaconSettings

SYSTEM_ID: Final = 255
COMPONENT_ID: Final = 190

_HEARTBEAT_S: Final = 1.0
_NOISE_STD_M: Final = 0.2
_VERTICAL_FACTOR: Final = 1.5
_POSITION_AND_VELOCITY: Final = 0b11
_LINK_ID: Final = 255  # of its signatures; differs from the vehicle's links
_MOST_ANSWERS: Final = 32  # pending


class GroundStation:
    """One ground station on the vehicle's link."""

    def __init__(
        self, beacon: BeaconSettings, rng: np.random.Generator, home: Vector3, signing: Signing | None = None
    ) -> None:
        """`beacon`: the pad's GPS, without which (`available` False) the request is UNSUPPORTED; `signing`:
        what its frames are signed with."""
        self.requests = 0
        self._rng = rng
        self._beacon = beacon
        self._home = home
        self._fix_period_s = 0.0 if beacon.rate_hz is None else 1.0 / beacon.rate_hz
        self._fix_due_s = -math.inf
        self._fix: tuple[float, Vector3, Vector3] = (0.0, ZERO3, ZERO3)
        north, east, down = (beacon.position_std_m * rng.standard_normal(3)).tolist()
        self._offset: Vector3 = (north, east, _VERTICAL_FACTOR * down)
        self._mav = mavlink.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
        self._decoder = mavlink.MAVLink(None)
        self._signing = signing
        self._reader = FrameReader()
        self._acknowledgements: list[Any] = []
        self._answers_due_s: list[float] = []
        self._heartbeat_due_s = -math.inf
        self._follow_due_s = -math.inf
        self.clear_faults()

    def clear_faults(self) -> None:
        """It sends what it is asked for alone, and nobody else is on the link."""
        self._operator: tuple[Vector3, float] | None = None
        self.intruders: dict[str, Intruder] = {}

    def follow(self, operator_ned_m: Vector3, rate_hz: float) -> None:
        """Send the operator's place (NED from home), unasked."""
        self._operator = (operator_ned_m, 1.0 / rate_hz)

    def second_companion(self, component_id: int, rate_hz: float) -> None:
        """Somebody who tells the vehicle to stand still, as often as a companion does."""
        self.intruders["setpoints"] = Companion(component_id, 1.0 / rate_hz)

    def forge(self, rate_hz: float) -> None:
        """Somebody without the key, in the vehicle's name."""
        self.intruders["forged"] = Forger(1.0 / rate_hz)

    def receive(self, data: bytes, now_s: float) -> None:
        for frame in self._reader.read(data, now_s):
            self.handle(frame, now_s)

    def handle(self, frame: MavFrame, now_s: float) -> None:
        if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG and _is_addressed(frame.target):
            self._handle_command(self._decoder.decode(bytearray(frame.data)), now_s)

    def transmit(self, now_s: float, pad_position_ned_m: Vector3, pad_velocity_ned_m_s: Vector3) -> bytes:
        """All that is due; the pad's true position (NED from home) and velocity are where its GPS starts."""
        messages, self._acknowledgements = self._acknowledgements, []
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + _HEARTBEAT_S
            messages.append(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        if now_s >= self._fix_due_s:
            self._fix_due_s = now_s + self._fix_period_s
            self._fix = (now_s, pad_position_ned_m, pad_velocity_ned_m_s)
        while self._answers_due_s and now_s >= self._answers_due_s[0]:
            self._answers_due_s.pop(0)
            messages.append(self._follow_target(*self._fix))
        if self._operator is not None and now_s >= self._follow_due_s:
            place, period_s = self._operator
            self._follow_due_s = now_s + period_s
            messages.append(self._follow_target(now_s, place, ZERO3))
        others = [intruder.due(now_s) for intruder in self.intruders.values()]
        return b"".join([*(self._pack(message) for message in messages), *others])

    def _pack(self, message: Any) -> bytes:
        if self._signing is not None:
            self._signing.prepare(self._mav, _LINK_ID)
        return packed(self._mav, message)

    def _handle_command(self, message: Any, now_s: float) -> None:
        wanted = message.param1
        known = self._beacon.available and (
            message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
            and wanted == mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET
        )
        busy = len(self._answers_due_s) >= _MOST_ANSWERS
        if known and not busy:
            self.requests += 1
            self._answers_due_s.append(now_s + self._beacon.delay_s)
        result = mavlink.MAV_RESULT_ACCEPTED if known else mavlink.MAV_RESULT_UNSUPPORTED
        result = mavlink.MAV_RESULT_TEMPORARILY_REJECTED if known and busy else result
        self._acknowledgements.append(
            mavlink.MAVLink_command_ack_message(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
        )

    def _follow_target(self, fix_s: float, position: Vector3, velocity: Vector3) -> Any:
        noise = self._rng.standard_normal(6).tolist()
        shown = [
            p + offset + _NOISE_STD_M * n
            for p, offset, n in zip(position, self._offset, noise[:3], strict=True)
        ]
        speed = [v + self._beacon.velocity_std_m_s * n for v, n in zip(velocity, noise[3:], strict=True)]
        latitude, longitude, altitude = geodetic_from_ned((shown[0], shown[1], shown[2]), self._home)
        eph = math.hypot(self._beacon.position_std_m, _NOISE_STD_M)
        return mavlink.MAVLink_follow_target_message(
            max(0, round(fix_s * 1e3)), _POSITION_AND_VELOCITY, round(latitude * 1e7), round(longitude * 1e7),
            altitude, speed, [0.0] * 3, [1.0, 0.0, 0.0, 0.0], [0.0] * 3,
            [eph, eph, _VERTICAL_FACTOR * eph], 0,
        )  # fmt: skip


def _is_addressed(target: tuple[int, int]) -> bool:
    system, component = target
    return system == SYSTEM_ID and component in (0, COMPONENT_ID)


# ---------------------------------------------------------------- intruders

_VEHICLE: Final = (1, 1)
_WRONG_KEY: Final = b"not the key of this vehicle, 32b."[:32]
_LATEST_STAMP: Final = (1 << 48) - 256  # the packer counts on from it
_VELOCITY_ALONE: Final = 0b0000_1101_1100_0111  # of a setpoint's mask: what is ignored


class Intruder(ABC):
    """Somebody on the link, who sends a frame a period (s)."""

    def __init__(self, component_id: int, period_s: float) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=_VEHICLE[0], srcComponent=component_id)
        self._period_s, self._due_s = period_s, -math.inf

    def due(self, now_s: float) -> bytes:
        if now_s < self._due_s:
            return b""
        self._due_s = now_s + self._period_s
        return packed(self._mav, self._message(now_s))

    @abstractmethod
    def _message(self, now_s: float) -> Any:
        """What it sends now."""


class Companion(Intruder):
    """Tells the vehicle to stand still, in its own name, as often as a companion does."""

    def _message(self, now_s: float) -> Any:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            max(0, round(now_s * 1e3)), *_VEHICLE, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY_ALONE,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip


class Forger(Intruder):
    """Sends heartbeats as the vehicle's, signed with another key, from the end of time."""

    def __init__(self, period_s: float) -> None:
        super().__init__(_VEHICLE[1], period_s)
        self._mav.signing.secret_key, self._mav.signing.sign_outgoing = _WRONG_KEY, True

    def _message(self, now_s: float) -> Any:
        self._mav.signing.timestamp = _LATEST_STAMP
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, mavlink.MAV_STATE_STANDBY, 3
        )
