"""Wrong MAVLink of many kinds, made from legal messages: one function a kind."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from sitl.mavlink.framing import dialect

mavlink: Any = dialect

GARBAGE_SYSTEM: Final = 9
_HEADER: Final = 10
_SPECIAL: Final = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -0.0)
_SETUP_SIGNING: Final = mavlink.MAVLINK_MSG_ID_SETUP_SIGNING
_COMMANDS: Final = (
    *(20, 21, 22, 16, 17, 31, 84, 92, 176, 178, 179, 192, 195),
    *(400, 410, 511, 512, 519, 520, 521, 300),
)

Rng = np.random.Generator


def templates() -> list[Any]:
    """Legal messages of all kinds that the vehicle takes, and some that it does not."""
    position = (0.0, 0.0, -5.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    level = [1.0, 0.0, 0.0, 0.0]
    return [
        mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3),
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b110111000111, *position),
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, 0b110111111000, 470000000, 80000000, 5.0, *position[3:]
        ),
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, level, 0.0, 0.0, 0.0, 0.5),
        mavlink.MAVLink_timesync_message(0, 123456),
        mavlink.MAVLink_ping_message(1, 2, 0, 0),
        mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1),
        mavlink.MAVLink_param_request_read_message(1, 1, b"SYSID_THISMAV", -1),
        mavlink.MAVLink_param_request_list_message(1, 1),
        mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 1500.0, 9),
        mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 5.0, 9),
        mavlink.MAVLink_set_mode_message(1, 1, 4),
        mavlink.MAVLink_mission_request_list_message(1, 1, 0),
        mavlink.MAVLink_mission_count_message(1, 1, 3, 0),
        mavlink.MAVLink_mission_item_int_message(
            1, 1, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 470000000, 80000000, 10.0, 0
        ),
        mavlink.MAVLink_mission_request_int_message(1, 1, 0, 0),
        mavlink.MAVLink_mission_set_current_message(1, 1, 0),
        mavlink.MAVLink_mission_clear_all_message(1, 1, 0),
        mavlink.MAVLink_landing_target_message(0, 0, 12, 0.1, 0.1, 2.0, 0.1, 0.1),
        mavlink.MAVLink_rc_channels_override_message(1, 1, *(1500,) * 8),
        mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        mavlink.MAVLink_statustext_message(6, b"a text that is as long as a text of this kind may be.", 3, 0),
        mavlink.MAVLink_follow_target_message(
            0, 3, 470000000, 80000000, 400.0, [0.0] * 3, [0.0] * 3, level, [0.0] * 3, [1.0] * 3, 0
        ),
        *(mavlink.MAVLink_command_long_message(1, 1, number, 0, *(0.5,) * 7) for number in _COMMANDS),
        *(
            mavlink.MAVLink_command_int_message(
                1, 1, 6, number, 0, 0, 0.5, 0.5, 0.5, 0.5, 470000000, 80000000, 10.0
            )
            for number in _COMMANDS
        ),
    ]  # fmt: skip


# ---------------------------------------------------------------- one function a kind of garbage


def random_bytes(rng: Rng, frame: bytes) -> bytes:
    """Noise, now and then begun as a frame begins."""
    noise = rng.bytes(int(rng.integers(1, 300)))
    return (b"\xfd", b"\xfe", b"")[int(rng.integers(3))] + noise


def flipped(rng: Rng, frame: bytes) -> bytes:
    """Some bits the other way round; the check sum is wrong."""
    data = bytearray(frame)
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data)


def flipped_and_mended(rng: Rng, frame: bytes) -> bytes:
    """Some bits of the content the other way round, and the check sum fits."""
    data = bytearray(frame)
    for _ in range(int(rng.integers(1, 9))):
        data[int(rng.integers(_HEADER, len(data) - 2))] ^= 1 << int(rng.integers(8))
    return mended(data)


def special_values(rng: Rng, frame: bytes) -> bytes:
    """Floats that are none, infinite, huge or tiny, anywhere."""
    data = bytearray(frame)
    for at in range(_HEADER, len(data) - 2 - 3, 4):
        if rng.random() < 0.5:
            struct.pack_into("<f", data, at, _SPECIAL[int(rng.integers(len(_SPECIAL)))])
    return mended(data)


def random_content(rng: Rng, frame: bytes) -> bytes:
    """Any message of the dialect with any content."""
    message_id = int(rng.choice(_MESSAGE_IDS))
    size = int(rng.integers(1, 256))
    header = struct.pack("<BBBBBBB", 0xFD, size, 0, 0, 0, GARBAGE_SYSTEM, int(rng.integers(256)))
    data = bytearray(header + message_id.to_bytes(3, "little") + rng.bytes(size) + b"\0\0")
    return mended(data)


def wrong_length(rng: Rng, frame: bytes) -> bytes:
    """A payload shorter or longer than the message's, and the check sum fits."""
    size = int(rng.integers(1, 256))
    payload = (frame[_HEADER:-2] + rng.bytes(255))[:size]
    return mended(bytearray(frame[:1] + bytes((size,)) + frame[2:_HEADER] + payload + b"\0\0"))


def false_length(rng: Rng, frame: bytes) -> bytes:
    """A length byte that claims other bytes than come."""
    return frame[:1] + rng.bytes(1) + frame[2:]


def truncated(rng: Rng, frame: bytes) -> bytes:
    """The beginning of a frame, or its end."""
    at = int(rng.integers(1, len(frame)))
    return frame[:at] if rng.random() < 0.5 else frame[at:]


def foreign(rng: Rng, frame: bytes) -> bytes:
    """A message that is in no dialect here."""
    return frame[:7] + int(rng.integers(60000, 1 << 24)).to_bytes(3, "little") + frame[_HEADER:]


def signed_by_nobody(rng: Rng, frame: bytes) -> bytes:
    """A signature of noise."""
    data = bytearray(frame)
    data[2] |= 1
    return mended(data) + rng.bytes(13)


def first_version(rng: Rng, frame: bytes) -> bytes:
    """MAVLink 1, its content flipped."""
    size, payload = frame[1], bytearray(frame[_HEADER:-2])
    payload[int(rng.integers(len(payload)))] ^= 1 << int(rng.integers(8))
    data = bytes((0xFE, size, frame[4], frame[5], frame[6], frame[7])) + bytes(payload)
    return data + _check_sum(data[1:], frame[7]) if frame[8:10] == b"\0\0" else data


KINDS: Final[tuple[Callable[[Rng, bytes], bytes], ...]] = (
    random_bytes,
    flipped,
    flipped_and_mended,
    special_values,
    random_content,
    wrong_length,
    false_length,
    truncated,
    foreign,
    signed_by_nobody,
    first_version,
)
# a key that really is taken over would end the legal stream, as it should
_MESSAGE_IDS: Final = [i for i in sorted(mavlink.mavlink_map) if i != _SETUP_SIGNING]


def mended(data: bytearray) -> bytes:
    """A MAVLink 2 frame with the check sum that its bytes ask for."""
    data[-2:] = _check_sum(bytes(data[1:-2]), int.from_bytes(data[7:10], "little"))
    return bytes(data)


def _check_sum(covered: bytes, message_id: int) -> bytes:
    extra = mavlink.mavlink_map[message_id].crc_extra
    return int(mavlink.x25crc(bytearray((*covered, extra))).crc).to_bytes(2, "little")
