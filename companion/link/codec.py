"""MAVLink 2 bytes <-> messages: framing, the messages we build. Pure.

Both sides of the link use it: the app and the bundled simulator. pymavlink is untyped, so it gets its names
here once: `mavlink`, and `Message` for what it makes. Frames and units are MAVLink's: local
NED in m, angles in rad, quaternions (w, x, y, z), latitude and longitude in 1e-7 deg.

Framing is our own: pymavlink's parser drops everything a false start byte claims, where this one goes back to
the next byte, so that garbage never costs a good message.
"""

import functools
import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from pymavlink.dialects.v20 import ardupilotmega

from companion.base.geometry import ZERO3, Vector3, norm
from companion.base.messages import LandingTargetPose, Setpoint
from companion.link.signing import SIGNATURE_BYTES, SIGNED_FLAG, V2_MARKER, LinkSigning

# ---------------------------------------------------------------- the dialect
# pymavlink's `ardupilotmega` (which holds `common`), and CURRENT_MODE: it has moved into `common` in 2024,
# and PX4 1.15 and later send it; the pymavlink in use has it in development only, whose dialects take a
# second to import. It is built here from the message's definition.

mavlink: Any = ardupilotmega
CURRENT_MODE: Final = 436


class CurrentMode(mavlink.MAVLink_message):  # type: ignore[misc]
    """CURRENT_MODE: `custom_mode` as in HEARTBEAT, sent at a rate that can be set."""

    id = CURRENT_MODE
    msgname = "CURRENT_MODE"
    fieldnames = ("standard_mode", "custom_mode", "intended_custom_mode")
    ordered_fieldnames = ("custom_mode", "intended_custom_mode", "standard_mode")
    fieldtypes = ("uint8_t", "uint32_t", "uint32_t")
    fielddisplays_by_name: Final[dict[str, str]] = {}
    fieldenums_by_name: Final[dict[str, str]] = {"standard_mode": "MAV_STANDARD_MODE"}
    fieldunits_by_name: Final[dict[str, str]] = {}
    native_format = bytearray(b"<IIB")
    orders = (2, 0, 1)
    lengths = (1, 1, 1)
    array_lengths = (0, 0, 0)
    crc_extra = 193
    unpacker = struct.Struct("<IIB")
    instance_field = None
    instance_offset = -1

    def __init__(self, standard_mode: int, custom_mode: int, intended_custom_mode: int) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field = self.instance_field
        self._instance_offset = self.instance_offset
        self.standard_mode = standard_mode
        self.custom_mode = custom_mode
        self.intended_custom_mode = intended_custom_mode

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's own messages pack themselves."""
        payload = self.unpacker.pack(self.custom_mode, self.intended_custom_mode, self.standard_mode)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


mavlink.mavlink_map.setdefault(CURRENT_MODE, CurrentMode)


def message_number(name: str) -> int:
    """MAVLink's number of a message.

    Raises:
        KeyError: the dialect has no such message.
    """
    number: int = CURRENT_MODE if name == CurrentMode.msgname else vars(mavlink)[f"MAVLINK_MSG_ID_{name}"]
    return number


Message = Any

COMPANION_COMPONENT: Final = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT: Final = 1

Severity = Literal["info", "warning", "error"]
_UNKNOWN_8, _UNKNOWN_32, _UNKNOWN_TEMPERATURE = 0xFF, 0xFFFFFFFF, 127
_SEVERITY: Final[dict[Severity, int]] = {"info": 6, "warning": 4, "error": 3}  # MAV_SEVERITY
_TEXT_BYTES: Final = 50  # of one STATUSTEXT
_NAN: Final = math.nan
_NANS: Final = (_NAN,) * 7

# ---------------------------------------------------------------- framing

MARKER: Final = re.compile(b"[\xfd\xfe]")
_V2_HEADER_BYTES: Final = 10
_V1_HEADER_BYTES: Final = 6
_CRC_BYTES: Final = 2


@dataclass(slots=True)
class CodecCounters:
    """What came in: messages given on and passed over unread, bytes of no message, gaps in the sequence.

    `refused`: whole messages without a right and fresh signature, where one is demanded.
    """

    decoded: int = 0
    passed_over: int = 0
    skipped_bytes: int = 0
    lost: int = 0
    refused: int = 0


class Codec:
    """Decodes a byte stream into messages and encodes messages as one system and component.

    `wanted` are the message ids to decode (None: all of the dialect); others are checked and passed over.
    """

    def __init__(
        self, system_id: int, component_id: int = COMPANION_COMPONENT, wanted: Iterable[int] | None = None
    ) -> None:
        self.counters = CodecCounters()
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._signing: LinkSigning | None = None
        self._wanted = None if wanted is None else frozenset(wanted)
        self._buffer = bytearray()
        self._sequence: dict[tuple[int, int], int] = {}

    def sign(self, signing: LinkSigning) -> None:
        """Sign all that is sent from now on, and take nothing without a right and fresh signature."""
        self._signing, packer = signing, self._packer.signing
        packer.secret_key, packer.sign_outgoing, packer.link_id = signing.secret, True, self.component_id

    def advance(self, now_s: float) -> None:
        """Move the time stamps of our signatures on, if we sign."""
        if self._signing is not None:
            self._signing.advance(now_s)

    @property
    def system_id(self) -> int:
        """The system id we send as; it may be changed until the first message is sent."""
        return int(self._packer.srcSystem)

    @system_id.setter
    def system_id(self, value: int) -> None:
        self._packer.srcSystem = value

    @property
    def component_id(self) -> int:
        """The component id we send as."""
        return int(self._packer.srcComponent)

    def encode(self, message: Message) -> bytes:
        """One message as bytes, with the next sequence number."""
        if self._signing is not None:
            self._packer.signing.timestamp = self._signing.next_stamp()
        data: bytes = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        return data

    def decode(self, data: bytes) -> list[Message]:
        """The messages completed by these bytes, in order; what is no message is skipped and counted."""
        buffer = self._buffer
        buffer += data
        messages: list[Message] = []
        start = 0
        while (marker := MARKER.search(buffer, start)) is not None:
            self.counters.skipped_bytes += marker.start() - start
            start = marker.start()
            size = frame_size(buffer, start)
            if size > len(buffer) - start:
                break
            if size == 0 or not self._take(buffer[start : start + size], messages):
                self.counters.skipped_bytes += 1
                size = 1
            start += size
        else:
            self.counters.skipped_bytes += len(buffer) - start
            start = len(buffer)
        del buffer[:start]
        return messages

    def _take(self, frame: bytearray, messages: list[Message]) -> bool:
        """Decode one whole frame; False when it is not one of the dialect's or its check sum is wrong."""
        message_id = message_id_of(frame)
        if not check_sum_is_right(frame, message_id):
            return False
        if self._wanted is not None and message_id not in self._wanted:
            self.counters.passed_over += 1
        elif self._signing is not None and not self._signing.accepts(frame):
            self.counters.refused += 1
            return True
        else:
            messages.append(unpacked(frame, message_id))
            self.counters.decoded += 1
        self._count_lost(frame)
        return True

    def _count_lost(self, frame: bytearray) -> None:
        at = 4 if frame[0] == V2_MARKER else 2
        sequence, source = frame[at], (frame[at + 1], frame[at + 2])
        last = self._sequence.get(source)
        self._sequence[source] = sequence
        if last is not None:
            self.counters.lost += (sequence - last - 1) % 256


def frame_size(buffer: bytearray, start: int) -> int:
    """Bytes of the frame that would start here; 0 when none can, more than there are when it is cut off."""
    have = len(buffer) - start
    if buffer[start] != V2_MARKER:
        if have < _V1_HEADER_BYTES:
            return _V1_HEADER_BYTES
        return frame_length(buffer, start) if buffer[start + 5] in mavlink.mavlink_map else 0
    if have < _V2_HEADER_BYTES:
        return _V2_HEADER_BYTES
    message_id = int.from_bytes(buffer[start + 7 : start + 10], "little")
    if buffer[start + 2] & ~SIGNED_FLAG or message_id not in mavlink.mavlink_map:
        return 0
    return frame_length(buffer, start)


def frame_length(buffer: bytes | bytearray, start: int) -> int:
    """Bytes of the frame that starts here, of whatever dialect, by its first three."""
    if buffer[start] != V2_MARKER:
        return _V1_HEADER_BYTES + buffer[start + 1] + _CRC_BYTES
    signature = SIGNATURE_BYTES if buffer[start + 2] & SIGNED_FLAG else 0
    return _V2_HEADER_BYTES + buffer[start + 1] + _CRC_BYTES + signature


def message_id_of(buffer: bytes | bytearray, start: int = 0) -> int:
    """The message id of the whole frame that starts here."""
    is_v2 = buffer[start] == V2_MARKER
    return int.from_bytes(buffer[start + 7 : start + 10], "little") if is_v2 else buffer[start + 5]


def header_bytes(frame: bytes | bytearray) -> int:
    """Size of a frame's header."""
    return _V2_HEADER_BYTES if frame[0] == V2_MARKER else _V1_HEADER_BYTES


def check_sum_is_right(frame: bytearray, message_id: int) -> bool:
    """Whether a whole frame's CRC, with the message's CRC_EXTRA, is right."""
    header = header_bytes(frame)
    end = header + frame[1]
    covered = frame[1:end]
    covered.append(mavlink.mavlink_map[message_id].crc_extra)
    return bool(mavlink.x25crc(covered).crc == int.from_bytes(frame[end : end + _CRC_BYTES], "little"))


def unpacked(frame: bytearray, message_id: int) -> Message:
    """The message in a whole frame whose check sum is right.

    pymavlink's own `decode` finds out anew where each field stands, and takes twice as long.
    """
    kind, header = mavlink.mavlink_map[message_id], header_bytes(frame)
    size = kind.unpacker.size
    # zeros at the end are not sent
    payload = frame[header : header + frame[1]].ljust(size, b"\0")
    values = kind.unpacker.unpack_from(payload)
    fields = [values[at] if count == 1 else list(values[at : at + count]) for at, count in _fields(kind)]
    message = kind(*fields)
    flags, source = (frame[2:4], frame[4:7]) if frame[0] == V2_MARKER else ((0, 0), frame[2:5])
    message._header = mavlink.MAVLink_header(message_id, *flags, frame[1], *source)
    message._msgbuf = frame
    return message


@functools.cache
def _fields(kind: Any) -> tuple[tuple[int, int], ...]:
    """Of each field, in the order in which a message is made from them: its first value's place, how many."""
    counts = kind.lengths
    return tuple((sum(counts[:place]), counts[place]) for place in kind.orders)


# ---------------------------------------------------------------- what bytes hold

_COMMANDS: Final = (
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
    mavlink.MAVLINK_MSG_ID_COMMAND_INT,
    mavlink.MAVLINK_MSG_ID_SET_MODE,
)


def is_autopilot_heartbeat(message: Message) -> bool:
    """Whether it is the HEARTBEAT of a flight controller: not a camera's, a ground station's or ours."""
    return bool(
        message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        and message.get_srcComponent() == AUTOPILOT_COMPONENT
        and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    )


def is_mavlink_1(message: Message) -> bool:
    """Whether it came in a frame of MAVLink 1."""
    return bool(message.get_msgbuf()[0] != V2_MARKER)


def autopilot_heartbeats(data: bytes, system_id: int) -> Iterator[Message]:
    """The heartbeats of the autopilot of this system (0: of any) that whole frames in `data` hold."""
    for message in Codec(system_id, wanted=(mavlink.MAVLINK_MSG_ID_HEARTBEAT,)).decode(data):
        if is_autopilot_heartbeat(message) and system_id in (0, message.get_srcSystem()):
            yield message


def is_twins_heartbeat(message: Message, us: tuple[int, int], process: int) -> bool:
    """Whether another process sent it under our system and component ids; an echo of ours is none."""
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_HEARTBEAT or message.custom_mode == process:
        return False
    return (message.get_srcSystem(), message.get_srcComponent()) == us


def has_command(data: bytes) -> bool:
    """Whether whole frames in `data` hold a command or change a mode."""
    return bool(Codec(0, wanted=_COMMANDS).decode(data))


def holds_only(data: bytes, message_ids: frozenset[int]) -> bool:
    """Whether `data` are whole frames, and all of these messages; their check sums are not looked at."""
    start, end = 0, len(data)
    while end - start >= _V2_HEADER_BYTES and MARKER.match(data, start):
        size = frame_length(data, start)
        if start + size > end or message_id_of(data, start) not in message_ids:
            return False
        start += size
    return start == end


# ---------------------------------------------------------------- messages we build


def heartbeat(process: int = 0) -> Message:
    """HEARTBEAT of an onboard computer: no autopilot, or mavlink-router would not forward to it.

    `process` stands in the custom mode, which means nothing else there: by it two companions that have the
    same ids know each other from an echo.
    """
    kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(kind, none, 0, process, mavlink.MAV_STATE_ACTIVE, 3)


def setpoint_message(
    setpoint: Setpoint, time_s: float, target_system: int, target_component: int = AUTOPILOT_COMPONENT
) -> Message:
    """A setpoint already in the autopilot's heading, as SET_ATTITUDE_TARGET when it has an attitude.

    Otherwise SET_POSITION_TARGET_LOCAL_NED of velocity, acceleration, yaw and yaw rate: no position, so that
    nothing depends on the autopilot's origin. `time_s` becomes time_boot_ms.
    """
    time_ms = int(time_s * 1000.0) & 0xFFFFFFFF
    if setpoint.attitude is not None and setpoint.thrust is not None:
        ignore_rates = 0b0000_0111  # ArduPilot takes all three rates or none
        return mavlink.MAVLink_set_attitude_target_message(
            time_ms, target_system, target_component, ignore_rates,
            list(setpoint.attitude), *ZERO3, setpoint.thrust,
        )  # fmt: skip
    ignore = 0b0000_0000_0111 if setpoint.holds_horizontal_velocity else 0b0000_0001_1111
    return mavlink.MAVLink_set_position_target_local_ned_message(
        time_ms, target_system, target_component, mavlink.MAV_FRAME_LOCAL_NED, ignore, *ZERO3,
        *setpoint.velocity_ned_m_s, *setpoint.acceleration_ned_m_s2,
        setpoint.heading_rad, setpoint.heading_rate_rad_s,
    )  # fmt: skip


def landing_target_message(target: LandingTargetPose, time_us: int) -> Message:
    """LANDING_TARGET of a position: BODY_FRD, or LOCAL_NED where there is one in the autopilot's own frame.

    `time_us` is the exposure by the clock that TIMESYNC tells of. The angles are to the right and backwards
    off the body's downward axis. ArduPilot divides the position by the distance and takes their product.
    """
    x, y, z = target.position_body_m
    own = target.position_ned_m
    frame = mavlink.MAV_FRAME_BODY_FRD if own is None else mavlink.MAV_FRAME_LOCAL_NED
    return mavlink.MAVLink_landing_target_message(
        time_us, 0, frame, math.atan2(y, z), math.atan2(-x, z), norm(target.position_body_m),
        *target.size_rad, *(target.position_body_m if own is None else own), list(target.attitude),
        mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL, 1,
    )  # fmt: skip


def timesync(tc1_ns: int, ts1_ns: int) -> Message:
    """TIMESYNC: a request has tc1 = 0 and ts1 = the sender's time; the reply's tc1 is the answerer's."""
    return mavlink.MAVLink_timesync_message(tc1_ns, ts1_ns)


_IN_ASCII: Final = str.maketrans({"±": "+-", "°": "deg", "µ": "u", "²": "2", "³": "3"})


def status_texts(text: str, severity: Severity, text_id: int) -> list[Message]:
    """STATUSTEXT in ASCII, in chunks of 50 bytes under `text_id` (1..65535) when the text is longer."""
    data = text.translate(_IN_ASCII).encode("ascii", "replace")
    chunks = [data[i : i + _TEXT_BYTES] for i in range(0, max(len(data), 1), _TEXT_BYTES)]
    if len(chunks) > 1 and len(chunks[-1]) == _TEXT_BYTES:
        chunks.append(b"")  # a text ends with a chunk that is not full
    chunk_id = text_id if len(chunks) > 1 else 0
    return [
        mavlink.MAVLink_statustext_message(_SEVERITY[severity], chunk, chunk_id, number)
        for number, chunk in enumerate(chunks)
    ]


def command_long(
    command: int,
    parameters: Sequence[float],
    target_system: int,
    target_component: int = AUTOPILOT_COMPONENT,
    confirmation: int = 0,
) -> Message:
    """COMMAND_LONG; missing parameters are NaN ("no value"), `confirmation` counts the repeats."""
    filled = (*parameters, *_NANS[len(parameters) :])
    return mavlink.MAVLink_command_long_message(
        target_system, target_component, command, confirmation, *filled
    )


def command_int(
    command: int,
    parameters: Sequence[float],
    position: Vector3,
    target_system: int,
    target_component: int = AUTOPILOT_COMPONENT,
) -> Message:
    """COMMAND_INT of up to four parameters at latitude (deg), longitude (deg), altitude (m AMSL)."""
    filled = (*parameters, *_NANS[len(parameters) : 4])
    latitude_e7, longitude_e7 = round(position[0] * 1e7), round(position[1] * 1e7)
    return mavlink.MAVLink_command_int_message(
        target_system, target_component, mavlink.MAV_FRAME_GLOBAL, command, 0, 0,
        *filled, latitude_e7, longitude_e7, position[2],
    )  # fmt: skip


def computer_status(
    unix_us: int,
    up_ms: int,
    cpu_percent: float | None,
    temperature_deg_c: float | None,
    ram_mb: tuple[float, float],
    storage_mb: tuple[float, float] | None,
) -> Message:
    """ONBOARD_COMPUTER_STATUS of a companion computer; (used, total) of memory and storage, None: unknown."""
    percent = _UNKNOWN_8 if cpu_percent is None else round(min(max(cpu_percent, 0.0), 100.0))
    board = _UNKNOWN_TEMPERATURE if temperature_deg_c is None else round(temperature_deg_c)
    used, total = (_UNKNOWN_32, _UNKNOWN_32) if storage_mb is None else map(round, storage_mb)
    none_8, none_16, none_32 = _UNKNOWN_8, [0x7FFF] * 4, [_UNKNOWN_32] * 3
    links = [_UNKNOWN_32] * 6
    return mavlink.MAVLink_onboard_computer_status_message(
        unix_us, up_ms, 0, [none_8] * 8, [percent, *[none_8] * 9], [none_8] * 4, [none_8] * 10,
        board, [_UNKNOWN_TEMPERATURE] * 8, none_16, round(ram_mb[0]), round(ram_mb[1]),
        [0, *none_32], [used, *none_32], [total, *none_32], links, links, links, links, links,
    )  # fmt: skip
