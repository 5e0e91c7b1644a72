"""The simulated autopilot's end of one link, sans I/O: bytes in with `receive`, bytes out with `transmit`.

System 1, component 1; it sends MAVLink 2 always, as both autopilots' simulators do. A vehicle with several
links has one endpoint per link on one autopilot (`sitl.mavlink.network`), each with its own framing, sequence
numbers and rates; they share the signing key. Commands are accepted from any sender and acknowledged to the
sender. Bytes that are not MAVLink, and messages for other targets, are dropped.

The rate of each telemetry message on one link, and the groups of the older stream requests.

Every link has its own rates: MAV_CMD_SET_MESSAGE_INTERVAL sets one message's, REQUEST_DATA_STREAM (which
ArduPilot still supports and PX4 does not) a whole group's.
"""

import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Final

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import ZERO3, Vector3
from companion.link.codec import CURRENT_MODE, Message, mavlink
from sitl.autopilot.control.setpoints import StreamedAttitude, StreamedMotion
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.modes import Severity
from sitl.mavlink.commands import PILOT_INPUTS, execute, request_from_message
from sitl.mavlink.framing import FrameReader, MavFrame, Signing, number, packed
from sitl.mavlink.mission_protocol import MissionProtocol
from sitl.mavlink.parameter_protocol import ANSWERS, ParameterProtocol
from sitl.mavlink.sensor_telemetry import SensorMessages, TruthMessages
from sitl.mavlink.telemetry import builders_of
from sitl.sensors.autopilot_sensors import SimulatedAutopilotSensors

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
            self._due_s.pop(message_id, None)
        else:
            self._period_s[message_id] = min(max(period, 1.0 / _HIGHEST_RATE_HZ), 1.0 / _LOWEST_RATE_HZ)
            self._due_s[message_id] = -math.inf
            self._next_s = -math.inf
        return True

    def due(self, now_s: float) -> list[int]:
        """Message ids to send now; most calls find nothing and cost next to nothing."""
        if now_s < self._next_s:
            return []
        found = [message_id for message_id, due in self._due_s.items() if now_s >= due]
        for message_id in found:
            due, period = self._due_s[message_id], self._period_s[message_id]
            # keep the rate when called a little late, but never catch up by a burst
            self._due_s[message_id] = due + period if now_s - due < period else now_s + period
        self._next_s = min(self._due_s.values(), default=math.inf) - 1e-6
        return found


_TEXT_BYTES: Final = 50
_ANYTHING_IN_A_FRAME = (ValueError, struct.error, mavlink.MAVError)


class MavlinkEndpoint:
    """One autopilot's end of a link; without `sensors` it sends no sensor messages.

    With `truth` it sends the simulator's truth on request.
    """

    def __init__(
        self,
        autopilot: SimulatedAutopilot,
        sensors: SimulatedAutopilotSensors | None = None,
        system_id: int = 1,
        component_id: int = 1,
        *,
        signing: Signing | None = None,
        link_id: int = 0,
        datagrams: bool = False,
        unix_at_start_s: float = 0.0,
        truth: TruthMessages | None = None,
    ) -> None:
        """`datagrams`: `receive` takes whole datagrams; `unix_at_start_s`: UTC at time 0."""
        self.autopilot = autopilot
        self.signing = signing or Signing(autopilot.profile.name)
        self._builders = builders_of(autopilot.profile.name)
        self._sensors = None if sensors is None else SensorMessages(autopilot, sensors, unix_at_start_s)
        self._truth = truth
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._decoder = mavlink.MAVLink(None)  # without a key: signatures have been checked before
        self._reader = FrameReader(datagrams=datagrams)
        self._link_id = link_id
        self._unix_at_start_s = unix_at_start_s
        self._state_time_s = -math.inf
        self._streams = Streams(self._has)
        self._outgoing: list[Message] = []
        self.send_to_other_links: Callable[[Message], None] | None = None
        self._text_id = 0
        self._handlers: dict[int, Callable[[Message, float], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_local_target,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._on_global_target,
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._on_attitude_target,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_PING: self._on_ping,
            mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._on_data_stream,
            mavlink.MAVLINK_MSG_ID_SETUP_SIGNING: self._on_setup_signing,
        }
        self._parameters = ParameterProtocol(autopilot)
        self._mission = MissionProtocol(autopilot.mission, autopilot.fence, autopilot.go_to_where_guided)
        for protocol in (self._parameters, self._mission):
            for message_id in protocol.message_ids:
                self._handlers[message_id] = partial(self._answer_by, protocol)
        for message_id, handler in PILOT_INPUTS.items():
            self._handlers[message_id] = partial(handler, autopilot)
        for message_id, answer in ANSWERS.items():
            self._handlers[message_id] = partial(self._answer_with, answer)

    def restart(self) -> None:
        """After a reset of the autopilot: the default streams, and nothing to send."""
        self._streams = Streams(self._has)
        self._outgoing.clear()

    # ------------------------------------------------------------ bytes

    def receive(self, data: bytes, now_s: float) -> None:
        for frame in self.frames(data, now_s):
            self.handle(frame, now_s)

    @property
    def waits(self) -> bool:
        """Whether a partial frame is buffered, which `frames` drops after a time-out."""
        return self._reader.waits

    def frames(self, data: bytes, now_s: float) -> list[MavFrame]:
        """The frames that these bytes complete and that pass signing."""
        self.signing.advance(self._unix_at_start_s + now_s)
        return [frame for frame in self._reader.read(data, now_s) if self.signing.accepts(frame)]

    def handle(self, frame: MavFrame, now_s: float) -> None:
        handler = self._handlers.get(frame.message_id)
        if handler is None or not self._is_addressed(frame):
            return
        try:
            message = self._decoder.decode(bytearray(frame.data))
        except _ANYTHING_IN_A_FRAME:
            return  # the checksum is right, the content is not
        handler(message, now_s)

    def transmit(self, now_s: float) -> bytes:
        """All that is due on a vehicle's only link: answers, texts, telemetry."""
        due = self.due(now_s)
        for severity, text in self.autopilot.take_texts():
            self.send_text(severity, text)
        return b"".join(due + self.answers(now_s))

    def due(self, now_s: float) -> list[bytes]:
        """All that is due, frame by frame; the autopilot's state is that of `now_s`."""
        self._state_time_s = now_s
        self._outgoing += self._parameters.due(now_s)
        self._outgoing += self._mission.due(now_s)
        for message_id in self._streams.due(now_s):
            self.send_once(message_id, now_s)
        return self.answers(now_s)

    def answers(self, now_s: float) -> list[bytes]:
        """What is not streamed: answers and texts, frame by frame."""
        if not self._outgoing:
            return []
        self.signing.advance(self._unix_at_start_s + now_s)
        self.signing.prepare(self._mav, self._link_id)
        data = [packed(self._mav, message) for message in self._outgoing]
        self._outgoing.clear()
        return data

    def _is_addressed(self, frame: MavFrame) -> bool:
        system, component = frame.target
        return system in (0, self._mav.srcSystem) and component in (0, self._mav.srcComponent)

    # ------------------------------------------------------------ out

    def send_once(self, message_id: int, now_s: float) -> bool:
        """Queue a telemetry message; False when there is no such message (no data yet is not that)."""
        if self._sensors is not None and message_id in self._sensors:
            self._sensors.ask(message_id)
            message = self._sensors.build(message_id, max(now_s, self._state_time_s))
        elif self._truth is not None and message_id in self._truth:
            message = self._truth.build(message_id, max(now_s, self._state_time_s))
        elif message_id in self._builders:
            # a request between two states is answered with the last state
            message = self._builders[message_id](self.autopilot, max(now_s, self._state_time_s))
        else:
            return False
        if message is not None:
            self._outgoing.append(message)
        return True

    def queue(self, message: Message) -> None:
        self._outgoing.append(message)

    def announce(self, message: Message) -> None:
        """Send a message over this link and the vehicle's others."""
        self.queue(message)
        if self.send_to_other_links is not None:
            self.send_to_other_links(message)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL; False when there is no such message. A PX4 keeps its heartbeat's rate."""
        fixed = self.autopilot.profile.name == "px4" and message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        return not fixed and self._has(message_id) and self._streams.set_interval(message_id, interval_us)

    def send_message_interval(self, message_id: int) -> None:
        """MESSAGE_INTERVAL: 0 for a message that does not exist, -1 for one that is not streamed."""
        period = self._streams.period_s(message_id)
        interval = 0 if not self._has(message_id) else -1 if period is None else round(period * 1e6)
        self._outgoing.append(
            mavlink.MAVLink_message_interval_message(min(max(message_id, 0), 0xFFFF), interval)
        )

    def _has(self, message_id: int) -> bool:
        others = (self._sensors, self._truth)
        return message_id in self._builders or any(
            other is not None and message_id in other for other in others
        )

    def send_text(self, severity: Severity, text: str) -> None:
        data = text.encode("ascii", "replace")
        chunks = [data[i : i + _TEXT_BYTES] for i in range(0, len(data) + 1, _TEXT_BYTES)]
        if len(data) <= _TEXT_BYTES:
            self._outgoing.append(mavlink.MAVLink_statustext_message(severity, data))
            return
        self._text_id = self._text_id % 0xFFFF + 1
        for index, chunk in enumerate(chunks):  # the last chunk is not full, which marks the end
            self._outgoing.append(mavlink.MAVLink_statustext_message(severity, chunk, self._text_id, index))

    # ------------------------------------------------------------ commands and modes

    def _on_command(self, message: Message, now_s: float) -> None:
        result = execute(self, request_from_message(message), now_s)
        self.queue(
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
        place = (m.lat_int * 1e-7, m.lon_int * 1e-7, number(m.alt))
        self.autopilot.stream_global(_motion(m, m.coordinate_frame, ZERO3), place, now_s)

    def _on_attitude_target(self, m: Message, now_s: float) -> None:
        w, x, y, z = m.q
        rates = (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate)
        fields = StreamedAttitude(m.type_mask, (w, x, y, z), rates, m.thrust)
        self.autopilot.stream_attitude(fields, now_s)

    # ------------------------------------------------------------ time, streams, parameters, missions

    def _on_timesync(self, message: Message, now_s: float) -> None:
        if message.tc1 == 0:
            booted_s = self.autopilot.booted_s
            ours_ns = 0 if booted_s is None else round((now_s - booted_s) * 1e9)
            self.queue(mavlink.MAVLink_timesync_message(max(ours_ns, 1), message.ts1))

    def _on_ping(self, message: Message, now_s: float) -> None:
        if (message.target_system, message.target_component) == (0, 0):
            self.queue(
                mavlink.MAVLink_ping_message(
                    message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
                )
            )

    def _on_data_stream(self, message: Message, now_s: float) -> None:
        """REQUEST_DATA_STREAM: a rate for a group of messages."""
        if message.start_stop not in (0, 1):
            return
        rate_hz = message.req_message_rate if message.start_stop else 0
        interval_us = 1e6 / rate_hz if rate_hz else -1.0
        for message_id in grouped_messages(self.autopilot.profile.name, message.req_stream_id):
            self.set_interval(message_id, interval_us)

    def _on_setup_signing(self, message: Message, now_s: float) -> None:
        self.signing.set_up(bytes(message.secret_key), message.initial_timestamp)

    def _answer_with(
        self, answer: Callable[[Message], Message | None], message: Message, now_s: float
    ) -> None:
        reply = answer(message)
        if reply is not None:
            self.queue(reply)

    def _answer_by(
        self, protocol: ParameterProtocol | MissionProtocol, message: Message, now_s: float
    ) -> None:
        changes = message.get_msgId() == mavlink.MAVLINK_MSG_ID_PARAM_SET
        for answer in protocol.handle(message, now_s):
            # all links receive a changed parameter
            (self.announce if changes else self.queue)(answer)


def _motion(m: Message, frame: int, position: Vector3) -> StreamedMotion:
    x, y, z = position
    return StreamedMotion(
        frame,
        m.type_mask,
        (number(x), number(y), number(z)),
        (number(m.vx), number(m.vy), number(m.vz)),
        (number(m.afx), number(m.afy), number(m.afz)),
        number(m.yaw),
        number(m.yaw_rate),
    )
