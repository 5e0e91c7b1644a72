"""A small autopilot for the link's tests: heartbeats, telemetry, modes, commands and parameters; no flight.

Sans I/O like the session: bytes in, bytes out, time as an argument.
"""

import math
from dataclasses import dataclass, field

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import custom_mode
from companion.link.codec import Codec, CurrentMode, Message, mavlink, status_texts, timesync

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
HOME = (47.0, 8.0, 400.0)
EKF_USES_GPS = 0x33F  # what ArduCopter 4.6 says once it may arm in GUIDED


@dataclass
class FakeAutopilot:
    """Its state is public: tests set it and look at it."""

    autopilot_kind: AutopilotKind = "px4"
    system_id: int = 1
    clock_offset_s: float = 0.0
    heading_rad: float = 0.0
    height_m: float = 0.0  # over home
    mode: str = "AUTO.LOITER"
    armed: bool = False
    believes_in_air: bool = False
    refuses: dict[int, str] = field(default_factory=dict)
    deaf_to: dict[int, int] = field(default_factory=dict)
    deaf_to_parameters: int = 0
    keeps_parameters: bool = False
    keeps_mode: bool = False  # though it accepts another
    rates_hz: dict[int, float] = field(default_factory=dict)
    heard: list[Message] = field(default_factory=list)
    parameters: dict[str, float] = field(default_factory=lambda: {"MIS_TAKEOFF_ALT": 2.5})

    def __post_init__(self) -> None:
        self.codec = Codec(self.system_id, 1)
        self._due_s: dict[int, float] = {}

    def commands(self, number: int) -> list[Message]:
        """The commands of this number heard so far."""
        return [m for m in self.heard if m.get_type().startswith("COMMAND_") and m.command == number]

    def setpoints(self) -> list[Message]:
        """The setpoints heard so far."""
        return [m for m in self.heard if m.get_type().startswith("SET_")]

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes and answer them."""
        answers: list[Message] = []
        for message in self.codec.decode(data):
            self.heard.append(message)
            kind = message.get_type()
            if kind in {"COMMAND_LONG", "COMMAND_INT"}:
                answers += self._obey(message)
            elif kind == "TIMESYNC" and message.tc1 == 0:
                answers.append(timesync(round((now_s + self.clock_offset_s) * 1e9), message.ts1))
            elif kind in {"PARAM_SET", "PARAM_REQUEST_READ"}:
                answers += self._parameter(message)
        return self._pack(answers)

    def tick(self, now_s: float) -> bytes:
        """Telemetry that is due: a heartbeat at 1 Hz and what was asked for."""
        messages: list[Message] = []
        for message_id, rate_hz in {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0, **self.rates_hz}.items():
            if now_s >= self._due_s.get(message_id, -math.inf):
                self._due_s[message_id] = now_s + 1.0 / rate_hz
                messages.append(self.message(message_id, now_s))
        return self._pack(messages)

    def message(self, message_id: int, now_s: float) -> Message:
        """One telemetry message of now."""
        boot_ms = round((now_s + self.clock_offset_s) * 1000.0) & 0xFFFFFFFF
        latitude, longitude, altitude = round(HOME[0] * 1e7), round(HOME[1] * 1e7), round(HOME[2] * 1e3)
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        present = 0 if self.autopilot_kind == "px4" else prearm
        messages: dict[int, Message] = {
            m.id: m
            for m in (
                self._heartbeat(),
                CurrentMode(0, custom_mode(self.autopilot_kind, self.mode), 0),
                mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, self.heading_rad, 0.0, 0.0, 0.0),
                mavlink.MAVLink_local_position_ned_message(boot_ms, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3),
                mavlink.MAVLink_global_position_int_message(
                    boot_ms, latitude, longitude, altitude + round(1e3 * self.height_m), 0, 0, 0, 0, 0
                ),
                mavlink.MAVLink_extended_sys_state_message(0, 2 if self.believes_in_air else 1),
                mavlink.MAVLink_sys_status_message(present, present, prearm, *[0] * 10),
                mavlink.MAVLink_ekf_status_report_message(EKF_USES_GPS, 0.0, 0.0, 0.0, 0.0, 0.0),
                mavlink.MAVLink_home_position_message(
                    latitude, longitude, altitude, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0
                ),
            )
        }
        return messages[message_id]

    def _heartbeat(self) -> Message:
        autopilot = (
            mavlink.MAV_AUTOPILOT_PX4 if self.autopilot_kind == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        )
        base_mode = 1 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR,
            autopilot,
            base_mode,
            custom_mode(self.autopilot_kind, self.mode),
            4,
            3,
        )

    def _obey(self, command: Message) -> list[Message]:
        number = command.command
        if self.deaf_to.get(number, 0) > 0:
            self.deaf_to[number] -= 1
            return []
        forced = number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and command.param2 == 21196.0
        texts = [] if forced or number not in self.refuses else [self.refuses[number]]
        if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and not command.param1:
            refused = self.believes_in_air and not forced
        else:
            refused = bool(texts)
        answers = [m for text in texts for m in status_texts(text, "error", 1)]
        target = (command.get_srcSystem(), command.get_srcComponent())
        result = DENIED if refused else ACCEPTED
        answers.append(mavlink.MAVLink_command_ack_message(number, result, 0, 0, *target))
        if not refused:
            answers += self._do(command)
        return answers

    def _do(self, command: Message) -> list[Message]:
        number = command.command
        if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = command.param1 == 1.0
        elif number == mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = self.mode if self.keeps_mode else self._mode(int(command.param2), int(command.param3))
        elif number == mavlink.MAV_CMD_NAV_TAKEOFF:
            self.believes_in_air = True
        elif number == mavlink.MAV_CMD_NAV_LAND:
            self.mode = "LAND" if self.autopilot_kind == "ardupilot" else "AUTO.LAND"
        elif number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.rates_hz[int(command.param1)] = 1e6 / command.param2
            return []
        elif number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            known = command.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION
            return [self.message(int(command.param1), 0.0)] if known else []
        return [self.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0.0)]

    def _mode(self, main: int, sub: int) -> str:
        if self.autopilot_kind == "ardupilot":
            return {4: "GUIDED", 9: "LAND", 17: "BRAKE"}[main]
        return {(6, 0): "OFFBOARD", (4, 3): "AUTO.LOITER", (4, 6): "AUTO.LAND"}[(main, sub)]

    def _parameter(self, message: Message) -> list[Message]:
        name = message.param_id
        if self.deaf_to_parameters > 0:
            self.deaf_to_parameters -= 1
            return []
        if not self.keeps_parameters and message.get_type() == "PARAM_SET":
            self.parameters[name] = message.param_value
        value = self.parameters.get(name, 0.0)
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        return [mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0)]

    def _pack(self, messages: list[Message]) -> bytes:
        return b"".join(self.codec.encode(message) for message in messages)
