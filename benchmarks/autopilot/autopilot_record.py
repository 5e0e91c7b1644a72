"""What an autopilot did with what it was sent: a .tlog, or bytes as they left a simulated vehicle.

A .tlog is a row of frames, each behind eight bytes of microseconds since 1970 (big-endian). Times here are
seconds from its first frame; the vehicle's motion stands at its own clock (time_boot_ms), shifted to ours by
the shortest way that a message took within a second of it: a simulator's clock may run slower than the
wall's. NED and radians as MAVLink has them.
"""

import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega

from companion.base.geometry import FloatArray

AUTOPILOT: Final = (1, 1)
CLIENT: Final = (255, 191)
ON_GROUND: Final = 1
_ARMED: Final = 128
_NEIGHBOURS: Final = 50  # rows to either side, at 50 Hz
_MARK_V2, _MARK_V1, _SIGNED = 0xFD, 0xFE, 0x01


class Stamped(NamedTuple):
    """One message and when it was heard or sent; `frame` are its bytes."""

    time_s: float
    message: Any
    frame: bytes


class Said(NamedTuple):
    """A change that the autopilot told of: `kind` is "ack", "text", "mode", "armed" or "landed"."""

    time_s: float
    kind: str
    what: Any


@dataclass
class AutopilotRecord:
    """One flight: `motion` (n, 7) of time, position and velocity NED, `attitude` (n, 4) of time, roll, pitch,
    yaw; it booted at `booted_s`."""

    sent: list[Stamped] = field(default_factory=list)
    said: list[Said] = field(default_factory=list)
    motion: FloatArray = field(default_factory=lambda: np.empty((0, 7)))
    attitude: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    booted_s: float = 0.0

    def heard(self, kind: str, after_s: float = -math.inf, before_s: float = math.inf) -> list[Said]:
        """What it said of that kind in between."""
        return [said for said in self.said if said.kind == kind and after_s <= said.time_s < before_s]

    def last(self, kind: str, time_s: float) -> Any:
        """What held at a time, None before the first word."""
        held = self.heard(kind, before_s=time_s)
        return held[-1].what if held else None


def read_tlog(path: Path) -> AutopilotRecord:
    """The record of one file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no .tlog.
    """
    return record_of(_messages(_tlog_frames(path.read_bytes(), path.name)))


def record_of(messages: Iterable[Stamped], start_s: float | None = None) -> AutopilotRecord:
    """Sort messages of both sides into a record; `start_s` is its time zero, or else the first stamp."""
    rows: dict[str, list[tuple[float, ...]]] = {"LOCAL_POSITION_NED": [], "ATTITUDE": []}
    record = AutopilotRecord()
    held: dict[str, Any] = {}
    for stamp_s, message, frame in messages:
        start_s = stamp_s if start_s is None else start_s
        time_s = stamp_s - start_s
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source == CLIENT:
            record.sent.append(Stamped(time_s, message, frame))
        elif source == AUTOPILOT:
            if (row := rows.get(message.get_type())) is not None:
                row.append((time_s, *_row(message)))
            record.said.extend(
                Said(time_s, kind, what)
                for kind, what in _told(message)
                if kind in ("ack", "text") or held.get(kind) != what
            )
            held.update(_told(message))
    record.motion, record.attitude = (
        _on_one_clock(rows["LOCAL_POSITION_NED"]),
        _on_one_clock(rows["ATTITUDE"]),
    )
    first = rows["ATTITUDE"][0]
    record.booted_s = first[0] - first[1]
    return record


def _on_one_clock(rows: list[tuple[float, ...]]) -> FloatArray:
    """Rows of (heard, its own clock, ...) to rows of (our clock, ...)."""
    table = np.array(rows)
    way = np.pad(table[:, 0] - table[:, 1], _NEIGHBOURS, mode="edge")
    shift = np.lib.stride_tricks.sliding_window_view(way, 2 * _NEIGHBOURS + 1).min(axis=1)
    return np.column_stack([table[:, 1] + shift, table[:, 2:]])


def _row(m: Any) -> tuple[float, ...]:
    boot_s = m.time_boot_ms * 1e-3
    if m.get_type() == "ATTITUDE":
        return (boot_s, m.roll, m.pitch, m.yaw)
    return (boot_s, m.x, m.y, m.z, m.vx, m.vy, m.vz)


def _told(m: Any) -> list[tuple[str, Any]]:
    name = m.get_type()
    if name == "COMMAND_ACK":
        return [("ack", (m.command, m.result))]
    if name == "STATUSTEXT":
        return [("text", m.text)]
    if name == "HEARTBEAT":
        return [("mode", m.custom_mode), ("armed", bool(m.base_mode & _ARMED))]
    return [("landed", m.landed_state)] if name == "EXTENDED_SYS_STATE" else []


# ---------------------------------------------------------------- frames


def decoder() -> Callable[[bytes], list[Any]]:
    """Turns bytes into the messages in them; a frame of an id unknown here is none."""
    parser = ardupilotmega.MAVLink(None)
    parser.robust_parsing = True

    def decode(frame: bytes) -> list[Any]:
        return [m for m in parser.parse_buffer(frame) or [] if m.get_msgId() >= 0 and m.get_srcSystem()]

    return decode


def _messages(frames: Iterable[tuple[float, bytes]]) -> Iterator[Stamped]:
    decode = decoder()
    for time_s, frame in frames:
        for message in decode(frame):
            yield Stamped(time_s, message, frame)


def _tlog_frames(data: bytes, name: str) -> Iterator[tuple[float, bytes]]:
    at = 0
    while at + 11 <= len(data):
        (micros,) = struct.unpack_from(">Q", data, at)
        length = _frame_bytes(data, at + 8)
        if length == 0:
            raise ValueError(f"{name}: no MAVLink frame at byte {at + 8}; expected a .tlog")
        yield micros * 1e-6, data[at + 8 : at + 8 + length]
        at += 8 + length


def _frame_bytes(data: bytes, at: int) -> int:
    mark, payload = data[at], data[at + 1]
    if mark == _MARK_V2:
        return payload + 12 + (13 if data[at + 2] & _SIGNED else 0)
    return payload + 8 if mark == _MARK_V1 else 0
