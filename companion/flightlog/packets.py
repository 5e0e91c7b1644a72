"""MAVLink bytes of either version, cut into packets for the .tlog file. Pure."""

from __future__ import annotations

from typing import Final

MAVLINK2_MAGIC: Final = 0xFD
MAVLINK1_MAGIC: Final = 0xFE


def split_packets(data: bytes) -> tuple[list[bytes], bytes]:
    """Cut a run of MAVLink bytes into whole packets and the unfinished rest; garbage is passed over."""
    packets: list[bytes] = []
    at = 0
    while at < len(data):
        if data[at] not in (MAVLINK1_MAGIC, MAVLINK2_MAGIC):
            at += 1
            continue
        length = _packet_length(data, at)
        if length is None or at + length > len(data):
            break
        packets.append(data[at : at + length])
        at += length
    return packets, data[at:]


def _packet_length(data: bytes, at: int) -> int | None:
    """Bytes of the packet that starts at `at`; None while its header is not all there."""
    if at + 3 > len(data):
        return None
    payload = data[at + 1]
    if data[at] == MAVLINK1_MAGIC:
        return payload + 8
    return payload + 12 + (13 if data[at + 2] & 1 else 0)
