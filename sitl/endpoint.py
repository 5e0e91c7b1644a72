"""The simulated autopilot's MAVLink port, sans I/O: bytes in with `receive`, bytes out with `transmit`.

MAVLink 2, system 1, component 1. Commands are taken from anyone and acknowledged to the sender. Whatever
arrives that is not MAVLink, or not for us, is dropped.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.geometry import Quaternion, Vector3, quat_normalise
from sitl import pilot_inputs
from sitl.autopilot import AttitudeSetpoint, Autopilot, Frame, Severity, StreamedMotion
from sitl.commands import execute, request_from_message
from sitl.mission_protocol import MissionProtocol
from sitl.onboard import OnboardSensors
from sitl.parameter_protocol import ParameterProtocol
from sitl.sensor_telemetry import SensorMessages
from sitl.telemetry import BUILDERS, Message, Streams, milliseconds
from sitl.truth_telemetry import TruthMessages

_TEXT_BYTES: Final = 50
_IGNORE_ATTITUDE: Final = 128
_IGNORE_THROTTLE: Final = 64
_IGNORE_YAW_RATE: Final = 4
_ANYTHING_IN_A_FRAME = (ValueError, struct.error, mavlink.MAVError)


class MavlinkEndpoint:
    """One autopilot's end of a link; without `sensors` it tells nothing of what its own ones measure.

    With `truth` it tells the simulator's truth to those who ask for it.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        sensors: OnboardSensors | None = None,
        system_id: int = 1,
        component_id: int = 1,
        truth: TruthMessages | None = None,
    ) -> None:
        self.autopilot = autopilot
        self._truth = truth
        self._sensors = None if sensors is None else SensorMessages(autopilot, sensors)
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._streams = Streams()
        self._outgoing: list[Message] = []
        self._text_id = 0
        self._handlers: dict[int, Callable[[Message, float], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_local_target,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._on_global_target,
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._on_attitude_target,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
        }
        self._parameters = ParameterProtocol(autopilot)
        self._mission = MissionProtocol(autopilot.mission)
        for protocol in (self._parameters, self._mission):
            for message_id in protocol.message_ids:
                self._handlers[message_id] = partial(self._answer_by, protocol)
        for message_id, handler in pilot_inputs.HANDLERS.items():
            self._handlers[message_id] = partial(handler, autopilot)

    # ------------------------------------------------------------ bytes

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that have just arrived."""
        for message in self._parse(data):
            handler = self._handlers.get(message.get_msgId())
            if handler is not None and self._is_for_us(message):
                handler(message, now_s)

    def transmit(self, now_s: float) -> bytes:
        """All that is due: answers, texts, telemetry."""
        for severity, text in self.autopilot.take_texts():
            self._queue_text(severity, text)
        self._outgoing += self._parameters.due(now_s)
        self._outgoing += self._mission.due(now_s)
        for message_id in self._streams.due(now_s):
            self.send_once(message_id, now_s)
        if not self._outgoing:
            return b""
        data = b"".join([self._pack(message) for message in self._outgoing])
        self._outgoing.clear()
        return data

    def _parse(self, data: bytes) -> list[Message]:
        try:
            return self._parser.parse_buffer(data) or []
        except _ANYTHING_IN_A_FRAME:
            return []  # a frame with a good checksum and a content that makes no sense

    def _pack(self, message: Message) -> bytes:
        packed = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def _is_for_us(self, message: Message) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        return system in (0, self._mav.srcSystem) and component in (0, self._mav.srcComponent)

    # ------------------------------------------------------------ out

    def send_once(self, message_id: int, now_s: float) -> bool:
        """Queue a telemetry message; False when there is no such message (no data yet is not that)."""
        builder = BUILDERS.get(message_id)
        if builder is not None:
            message = builder(self.autopilot, now_s)
        elif self._sensors is not None and message_id in self._sensors:
            self._sensors.ask(message_id)
            message = self._sensors.build(message_id, now_s)
        elif self._truth is not None and message_id in self._truth:
            message = self._truth.build(message_id, now_s)
        else:
            return False
        if message is not None:
            self._outgoing.append(message)
        return True

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL; False when there is no such message."""
        return self._has(message_id) and self._streams.set_interval(message_id, interval_us)

    def tell_interval(self, message_id: int) -> None:
        """MESSAGE_INTERVAL: 0 for a message that does not exist, -1 for one that is not streamed."""
        period = self._streams.period_s(message_id)
        interval = 0 if not self._has(message_id) else -1 if period is None else round(period * 1e6)
        self._outgoing.append(
            mavlink.MAVLink_message_interval_message(min(max(message_id, 0), 0xFFFF), interval)
        )

    def _has(self, message_id: int) -> bool:
        others = (self._sensors, self._truth)
        return message_id in BUILDERS or any(told is not None and message_id in told for told in others)

    def _queue_text(self, severity: Severity, text: str) -> None:
        data = text.encode("ascii", "replace")
        chunks = [data[i : i + _TEXT_BYTES] for i in range(0, len(data) + 1, _TEXT_BYTES)]
        if len(data) <= _TEXT_BYTES:
            self._outgoing.append(mavlink.MAVLink_statustext_message(severity, data))
            return
        self._text_id = self._text_id % 0xFFFF + 1
        for number, chunk in enumerate(chunks):  # the last one is not full, which is how its end is known
            self._outgoing.append(mavlink.MAVLink_statustext_message(severity, chunk, self._text_id, number))

    # ------------------------------------------------------------ commands and modes

    def _on_command(self, message: Message, now_s: float) -> None:
        result = execute(self, request_from_message(message), now_s)
        self._outgoing.append(
            mavlink.MAVLink_command_ack_message(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
        )

    def _on_set_mode(self, message: Message, now_s: float) -> None:
        if message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self.autopilot.set_mode(message.custom_mode)

    # ------------------------------------------------------------ setpoints

    def _on_local_target(self, m: Message, now_s: float) -> None:
        self.autopilot.stream_fields(_motion(m, m.coordinate_frame, (m.x, m.y, m.z)), now_s)

    def _on_global_target(self, m: Message, now_s: float) -> None:
        over_home = m.coordinate_frame in (
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        )
        place = (m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt)
        self.autopilot.stream_global(_motion(m, Frame.LOCAL_NED, (0.0, 0.0, 0.0)), place, over_home, now_s)

    def _on_attitude_target(self, m: Message, now_s: float) -> None:
        attitude = _unit_quaternion(m.q)
        unusable = m.type_mask & (_IGNORE_ATTITUDE | _IGNORE_THROTTLE)
        if unusable or attitude is None or not math.isfinite(m.thrust):
            return
        given = not m.type_mask & _IGNORE_YAW_RATE and math.isfinite(m.body_yaw_rate)
        yaw_rate = m.body_yaw_rate if given else 0.0
        self.autopilot.stream(AttitudeSetpoint(attitude, m.thrust, yaw_rate), now_s)

    # ------------------------------------------------------------ time, parameters, missions

    def _on_timesync(self, message: Message, now_s: float) -> None:
        if message.tc1 == 0:
            ours_ns = milliseconds(self.autopilot, now_s) * 1_000_000
            self._outgoing.append(mavlink.MAVLink_timesync_message(max(ours_ns, 1), message.ts1))

    def _answer_by(
        self, protocol: ParameterProtocol | MissionProtocol, message: Message, now_s: float
    ) -> None:
        self._outgoing += protocol.handle(message, now_s)


def _motion(m: Message, frame: int, position: Vector3) -> StreamedMotion:
    return StreamedMotion(
        frame, m.type_mask, position, (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz), m.yaw, m.yaw_rate
    )


def _unit_quaternion(values: list[float]) -> Quaternion | None:
    """The attitude of a message, None when it is none."""
    w, x, y, z = values
    length = w * w + x * x + y * y + z * z
    if not math.isfinite(length) or length < 0.5:
        return None
    return quat_normalise((w, x, y, z))
