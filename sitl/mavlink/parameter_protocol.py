"""MAVLink's parameter protocol, sans I/O: list, read, set, and PX4's hash.

One object per link. A list is paced as on a real link, so that a client that requests again what it
missed is served meanwhile. Integers go bytewise in the float field with PX4, as plain numbers with ArduPilot.
Sources: mavlink.io's parameter protocol; PX4 1.16 `mavlink_parameters.cpp`; ArduPilot 4.6 `GCS_Param.cpp`.
"""

import math
import struct
import zlib
from collections.abc import Callable
from typing import Final

from companion.link.codec import Message, mavlink
from sitl.autopilot.flight.autopilot import SimulatedAutopilot
from sitl.autopilot.flight.modes import Severity

HASH_NAME: Final = "_HASH_CHECK"
_BURST: Final = 20
_BURST_PERIOD_S: Final = 0.05
_NO_INDEX: Final = 0xFFFF
_REAL32: Final = mavlink.MAV_PARAM_TYPE_REAL32
_INTEGERS: Final = {
    8: mavlink.MAV_PARAM_TYPE_INT8,
    16: mavlink.MAV_PARAM_TYPE_INT16,
    32: mavlink.MAV_PARAM_TYPE_INT32,
}
_ALL_ONES: Final = 0xFFFFFFFF


class ParameterProtocol:
    """One link's end of the protocol."""

    def __init__(self, autopilot: SimulatedAutopilot) -> None:
        self._autopilot = autopilot
        self._next: int | None = None
        self._due_s = -math.inf
        self._handlers: dict[int, Callable[[Message, float], list[Message]]] = {
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_set,
        }
        self.message_ids: Final = frozenset(self._handlers)

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Answers to a message; none to one that is not of this protocol."""
        handler = self._handlers.get(message.get_msgId())
        return [] if handler is None else handler(message, now_s)

    def due(self, now_s: float) -> list[Message]:
        """The next parameters of a list under way."""
        first = self._next
        if first is None or now_s < self._due_s:
            return []
        self._due_s = now_s + _BURST_PERIOD_S
        last = min(first + _BURST, len(self._autopilot.parameters))
        self._next = last if last < len(self._autopilot.parameters) else None
        names = (self._autopilot.parameters.name_at(index) for index in range(first, last))
        return [self._value(name, index) for index, name in enumerate(names, first) if name is not None]

    def _on_list(self, m: Message, now_s: float) -> list[Message]:
        self._next, self._due_s = 0, now_s
        return [self._hash()] if self._bytewise else []

    def _on_read(self, m: Message, now_s: float) -> list[Message]:
        index = m.param_index
        parameters = self._autopilot.parameters
        name = parameters.name_at(index) if index >= 0 else _text(m.param_id)
        if name == HASH_NAME and self._bytewise:
            return [self._hash()]
        if name is None or name not in parameters:
            return []
        by_name = index < 0 and not self._bytewise
        return [self._value(name, _NO_INDEX if by_name else parameters.index_of(name))]

    def _on_set(self, m: Message, now_s: float) -> list[Message]:
        parameters, name, value = self._autopilot.parameters, _text(m.param_id), m.param_value
        if name == HASH_NAME and self._bytewise:
            self._next = None  # the client has all values already
            return []
        if name not in parameters:
            return []
        if self._bytewise:
            if m.param_type != self._type(name):
                self._autopilot.commander.send_text(Severity.CRITICAL, f"param types mismatch param: {name}")
                return []
            if parameters.is_integer(name):
                value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        parameters.set(name, value)
        # a rejected value is answered with the present one
        return [self._value(name, parameters.index_of(name) if self._bytewise else _NO_INDEX)]

    @property
    def _bytewise(self) -> bool:
        return self._autopilot.profile.parameters_bytewise

    def _type(self, name: str) -> int:
        parameters = self._autopilot.parameters
        kind: int = _INTEGERS[parameters.bits(name)] if parameters.is_integer(name) else _REAL32
        return kind

    def _value(self, name: str, index: int) -> Message:
        parameters = self._autopilot.parameters
        value = parameters[name]
        if self._bytewise:
            value = struct.unpack("<f", self._raw(name))[0]
        return mavlink.MAVLink_param_value_message(
            name.encode(), value, self._type(name), len(parameters), index
        )

    def _raw(self, name: str) -> bytes:
        value = self._autopilot.parameters[name]
        integer = self._autopilot.parameters.is_integer(name)
        return struct.pack("<i", int(value)) if integer else struct.pack("<f", value)

    def _hash(self) -> Message:
        """_HASH_CHECK: the CRC of all names and values, by which a client detects that it has them."""
        crc = 0
        for name in self._autopilot.parameters:
            for part in (name.encode(), self._raw(name)):
                crc = zlib.crc32(part, crc ^ _ALL_ONES) ^ _ALL_ONES
        value = struct.unpack("<f", struct.pack("<I", crc))[0]
        count = len(self._autopilot.parameters)
        return mavlink.MAVLink_param_value_message(
            HASH_NAME.encode(), value, mavlink.MAV_PARAM_TYPE_UINT32, count, _NO_INDEX
        )


def _text(value: str | bytes) -> str:
    return value if isinstance(value, str) else value.decode("ascii", "replace")


# ---------------------------------------------------------------- file protocols
# Logs and files of an autopilot that has none, sans I/O: clients learn that at once instead of waiting.
#
# LOG_REQUEST_LIST is answered with an empty list, LOG_REQUEST_DATA with no bytes. A request of MAVLink FTP is
# answered with a NAK: no such file, or, for what would write, a protected one. Source: mavlink.io, MAVLink
# FTP.

# sequence, session, opcode, size, requested opcode, end of a burst, padding, offset
_HEADER: Final = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES: Final = 251
_ACK, _NAK = 128, 129
_INVALID_SESSION, _UNKNOWN_COMMAND, _FILE_PROTECTED, _FILE_NOT_FOUND = 4, 7, 9, 10
_NONE, _TERMINATE_SESSION, _RESET_SESSIONS = 0, 1, 2
_WITHOUT_EFFECT: Final = frozenset({_NONE, _TERMINATE_SESSION, _RESET_SESSIONS})
# opcode: the error; reading by name finds nothing, by session there is none, nothing can be written
_ERRORS: Final[dict[int, int]] = {
    3: _FILE_NOT_FOUND,  # ListDirectory
    4: _FILE_NOT_FOUND,  # OpenFileRO
    5: _INVALID_SESSION,  # ReadFile
    6: _FILE_PROTECTED,  # CreateFile
    7: _INVALID_SESSION,  # WriteFile
    8: _FILE_NOT_FOUND,  # RemoveFile
    9: _FILE_PROTECTED,  # CreateDirectory
    10: _FILE_NOT_FOUND,  # RemoveDirectory
    11: _FILE_PROTECTED,  # OpenFileWO
    12: _FILE_NOT_FOUND,  # TruncateFile
    13: _FILE_NOT_FOUND,  # Rename
    14: _FILE_NOT_FOUND,  # CalcFileCRC32
    15: _INVALID_SESSION,  # BurstReadFile
}


def log_list(message: Message) -> Message:
    """LOG_ENTRY: there are no logs."""
    return mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0)


def log_data(message: Message) -> Message:
    """LOG_DATA without data: the end of a log."""
    return mavlink.MAVLink_log_data_message(message.id, message.ofs, 0, [0] * 90)


def file_reply(message: Message) -> Message | None:
    """FILE_TRANSFER_PROTOCOL's answer to a request; None to an answer."""
    sequence, session, opcode, *_ = _HEADER.unpack_from(bytes(message.payload))
    if opcode in (_ACK, _NAK):
        return None
    accepted = opcode in _WITHOUT_EFFECT
    error = b"" if accepted else bytes([_ERRORS.get(opcode, _UNKNOWN_COMMAND)])
    kind = _ACK if accepted else _NAK
    header = _HEADER.pack((sequence + 1) & 0xFFFF, session, kind, len(error), opcode, 0, 0, 0)
    payload = (header + error).ljust(_PAYLOAD_BYTES, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(
        0, message.get_srcSystem(), message.get_srcComponent(), list(payload)
    )


ANSWERS: Final[dict[int, Callable[[Message], Message | None]]] = {
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_LIST: log_list,
    mavlink.MAVLINK_MSG_ID_LOG_REQUEST_DATA: log_data,
    mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: file_reply,
}
