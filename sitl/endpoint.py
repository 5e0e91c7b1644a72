"""The simulated autopilot's MAVLink port, sans I/O: bytes in with `receive`, bytes out with `transmit`.

MAVLink 2, system 1, component 1. Commands are taken from anyone and acknowledged to the sender. Whatever
arrives that is not MAVLink, or not for us, is dropped.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.geometry import ZERO3, Vector3
from sitl.autopilot import Autopilot, Severity, StreamedAttitude, StreamedMotion
from sitl.commands import execute, request_from_message
from sitl.onboard import OnboardSensors
from sitl.sensor_telemetry import SensorMessages
from sitl.telemetry import BUILDERS, Message, Streams, milliseconds

_TEXT_BYTES: Final = 50
_INT32, _REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32
_ANYTHING_IN_A_FRAME = (ValueError, struct.error, mavlink.MAVError)


class MavlinkEndpoint:
    """One autopilot's end of a link; without `sensors` it tells nothing of what its own ones measure."""

    def __init__(
        self,
        autopilot: Autopilot,
        sensors: OnboardSensors | None = None,
        system_id: int = 1,
        component_id: int = 1,
    ) -> None:
        self.autopilot = autopilot
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
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_param_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_param_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_param_set,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_mission_list,
        }

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
        system = getattr(message, "target_system", 0)
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
        self._outgoing.append(mavlink.MAVLink_message_interval_message(max(message_id, 0), interval))

    def _has(self, message_id: int) -> bool:
        return message_id in BUILDERS or (self._sensors is not None and message_id in self._sensors)

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
        place = (m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt)
        self.autopilot.stream_global(_motion(m, m.coordinate_frame, ZERO3), place, now_s)

    def _on_attitude_target(self, m: Message, now_s: float) -> None:
        w, x, y, z = m.q
        rates = (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate)
        fields = StreamedAttitude(m.type_mask, (w, x, y, z), rates, m.thrust)
        self.autopilot.stream_attitude(fields, now_s)

    # ------------------------------------------------------------ time, parameters, missions

    def _on_timesync(self, message: Message, now_s: float) -> None:
        if message.tc1 == 0:
            ours_ns = milliseconds(self.autopilot, now_s) * 1_000_000
            self._outgoing.append(mavlink.MAVLink_timesync_message(max(ours_ns, 1), message.ts1))

    def _on_param_list(self, message: Message, now_s: float) -> None:
        for name in self.autopilot.parameters:
            self._queue_parameter(name)

    def _on_param_read(self, message: Message, now_s: float) -> None:
        parameters = self.autopilot.parameters
        index = message.param_index
        name = parameters.name_at(index) if index >= 0 else _text(message.param_id)
        if name is not None and name in parameters:
            self._queue_parameter(name)

    def _on_param_set(self, message: Message, now_s: float) -> None:
        name, value = _text(message.param_id), message.param_value
        if name not in self.autopilot.parameters:
            return
        if self.autopilot.manner.parameters_bytewise and message.param_type == _INT32:
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        self.autopilot.parameters.set(name, value)
        self._queue_parameter(name)  # a refused value is answered by the one that stands

    def _queue_parameter(self, name: str) -> None:
        parameters = self.autopilot.parameters
        value, kind = parameters[name], _INT32 if parameters.is_integer(name) else _REAL32
        if kind == _INT32 and self.autopilot.manner.parameters_bytewise:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self._outgoing.append(
            mavlink.MAVLink_param_value_message(
                name.encode(), value, kind, len(parameters), parameters.index_of(name)
            )
        )

    def _on_mission_list(self, message: Message, now_s: float) -> None:
        self._outgoing.append(
            mavlink.MAVLink_mission_count_message(
                message.get_srcSystem(), message.get_srcComponent(), 0, message.mission_type
            )
        )


def _motion(m: Message, frame: int, position: Vector3) -> StreamedMotion:
    return StreamedMotion(
        frame, m.type_mask, position, (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz), m.yaw, m.yaw_rate
    )


def _text(value: str | bytes) -> str:
    return value if isinstance(value, str) else value.decode("ascii", "replace")
