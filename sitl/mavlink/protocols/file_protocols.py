"""Logs and files of an autopilot that has none, sans I/O: clients learn that at once instead of waiting.

LOG_REQUEST_LIST is answered with an empty list, LOG_REQUEST_DATA with no bytes. A request of MAVLink FTP is
answered with a NAK: no such file, or, for what would write, a protected one. Source: mavlink.io, MAVLink FTP.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

Message = Any  # pymavlink's classes are generated without types

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
