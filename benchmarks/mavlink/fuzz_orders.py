"""Orders that hang together and make no sense: what a vehicle may be told, in legal frames, with wild values.

Missions half uploaded, jumps without end, homes upon homes, places and headings that are no numbers, sticks,
landing targets, parameters; now and then an order to arm and fly, so that all of it meets a vehicle in the
air. Legal frames reach the handlers that garbage hardly ever gets to.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from sitl.autopilot import SimulatedAutopilot
from sitl.mavlink.commands import FORCE_MAGIC, HANDLERS
from sitl.mavlink.framing import dialect

mavlink: Any = dialect
Rng = np.random.Generator
Message = Any  # pymavlink's classes are generated without types

FLOATS: Final = (
    0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, 90.0, 180.0, 30_000.0, 99_000.0,
    5.0, 50.0, 400.0, 410.0, 2.0, 3.0, -2.0, float(FORCE_MAGIC), 1e6,
)  # fmt: skip
WHOLE: Final = (0, 1, -1, 2**31 - 1, -(2**31), 470_000_000, 80_000_000, 470_001_000, 80_001_000)
NEAR: Final = (0, 470_000_000, 80_000_000, 470_001_000, 80_001_000)
STICKS: Final = (-32768, 32767, 0, 1000, -1000, 500)
CHANNELS: Final = (0, 1, 1000, 1500, 2000, 65534, 65535)
ITEMS: Final = (16, 17, 18, 19, 20, 21, 22, 82, 93, 112, 115, 177, 178, 179, 189)
FRAMES: Final = (0, 2, 3, 5, 6)
_ARM, _SET_MODE, _TAKE_OFF, _START = 400, 176, 22, 300


class Orders:
    """One who orders about: `next` is the next message, in sequences that go on from call to call."""

    def __init__(self, rng: Rng, autopilot: SimulatedAutopilot) -> None:
        self._rng = rng
        self._names = [name.encode() for name in autopilot.parameters]
        self._modes = [mode.custom_mode for mode in autopilot.profile.modes]
        self._is_px4 = autopilot.profile.name == "px4"
        self._waiting: list[Message] = []
        self._kinds: tuple[Callable[[], Message], ...] = (
            *(self._command,) * 3, *(self._command_int,) * 3, self._home, self._reposition, self._target,
            self._stick, self._channel, self._local, self._global, self._attitude, self._parameter,
            *(self._count,) * 2, *(self._item,) * 4, self._part, self._clear, self._current, self._request,
            self._mode, self._rate, self._text,
        )  # fmt: skip

    def next(self) -> Message:
        """The next message."""
        if not self._waiting:
            draw = self._rng.random()
            if draw < 0.04:
                self._waiting = self._fly()
            elif draw < 0.08:
                self._waiting = self._mission()
            else:
                return self._one(self._kinds)()
        return self._waiting.pop(0)

    # ------------------------------------------------------------ sequences

    def _fly(self) -> list[Message]:
        mode = (1, 4, 3) if self._is_px4 else (1, 4, 0)
        height = 410.0 if self._is_px4 else 10.0
        return [
            _long(_SET_MODE, *mode),
            _long(_ARM, 1, FORCE_MAGIC),
            _long(_TAKE_OFF, 0, 0, 0, 0, 0, 0, height),
        ]

    def _mission(self) -> list[Message]:
        """An upload, usually of what is taken, and the order to fly it."""
        count = int(self._rng.integers(1, 6))
        items = [self._item() for _ in range(count)]
        for number, item in enumerate(items):
            item.seq = number
            if self._rng.random() < 0.7:
                item.command = self._one((16, 16, 22, 177, 18, 178, 179))
            item.z = item.z if abs(item.z) <= 30_000.0 else 20.0
        begin = mavlink.MAVLink_mission_count_message(1, 1, count, 0)
        return [begin, *items, _long(_ARM, 1, FORCE_MAGIC), _long(_START)]

    # ------------------------------------------------------------ one function a kind

    def _command(self) -> Message:
        return _long(self._one(tuple(HANDLERS)), *self._floats(7))

    def _command_int(self) -> Message:
        return mavlink.MAVLink_command_int_message(
            1, 1, self._one((0, 1, 3, 5, 6, 10, 255)), self._one(tuple(HANDLERS)), 0, 0, *self._floats(4),
            self._one(WHOLE), self._one(WHOLE), *self._floats(1),
        )  # fmt: skip

    def _home(self) -> Message:
        return self._at(mavlink.MAV_CMD_DO_SET_HOME, (0.0,) * 4, (99_000.0, 29_000.0, -99_000.0, 10.0))

    def _reposition(self) -> Message:
        parameters = (-1.0, 1.0, 0.0, self._one((math.inf, -math.inf, math.nan, 3.4e38, 1.0)))
        return self._at(mavlink.MAV_CMD_DO_REPOSITION, parameters, (10.0, 30_000.0, math.nan))

    def _at(self, command: int, parameters: Sequence[float], heights: Sequence[float]) -> Message:
        return mavlink.MAVLink_command_int_message(
            1, 1, self._one((3, 6)), command, 0, 0, *parameters, 470_001_000, 80_001_000, self._one(heights)
        )

    def _target(self) -> Message:
        return mavlink.MAVLink_landing_target_message(
            0, 0, self._one((0, 1, 8, 12, 200)), *self._floats(8), self._floats(4), 2, self._one((0, 1, 2))
        )

    def _stick(self) -> Message:
        return mavlink.MAVLink_manual_control_message(1, *self._some(STICKS, 4), 65535)

    def _channel(self) -> Message:
        return mavlink.MAVLink_rc_channels_override_message(1, 1, *self._some(CHANNELS, 18))

    def _local(self) -> Message:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, self._one((1, 7, 8, 9, 12)), self._below(4096), *self._floats(11)
        )

    def _global(self) -> Message:
        return mavlink.MAVLink_set_position_target_global_int_message(
            0,
            1,
            1,
            self._one((0, 3, 5, 6, 10, 11)),
            self._below(4096),
            *self._some(WHOLE, 2),
            *self._floats(9),
        )

    def _attitude(self) -> Message:
        attitude = self._one(([1.0, 0.0, 0.0, 0.0], [0.7071, 0.7071, 0.0, 0.0], self._floats(4)))
        return mavlink.MAVLink_set_attitude_target_message(
            0, 1, 1, self._below(256), attitude, *self._floats(3), self._one((0.5, 1.0, math.nan, math.inf))
        )

    def _parameter(self) -> Message:
        bits = struct.unpack("<f", struct.pack("<i", self._one((0, 1, 2, 100, -1))))[0]
        return mavlink.MAVLink_param_set_message(
            1, 1, self._one(self._names), self._one((*FLOATS, bits)), self._one((9, 6, 2, 4))
        )

    def _count(self) -> Message:
        return mavlink.MAVLink_mission_count_message(
            1, 1, self._one((0, 1, 2, 5, 5, 65535)), self._one((0, 0, 1))
        )

    def _item(self) -> Message:
        return mavlink.MAVLink_mission_item_int_message(
            1, 1, self._below(6), self._one(FRAMES), self._one(ITEMS), 0, 1, *self._floats(4),
            *self._some(NEAR, 2), self._one((10.0, 20.0, 30_000.0, -30_000.0, math.nan)), 0,
        )  # fmt: skip

    def _part(self) -> Message:
        return mavlink.MAVLink_mission_write_partial_list_message(1, 1, self._below(6), self._below(6), 0)

    def _clear(self) -> Message:
        return mavlink.MAVLink_mission_clear_all_message(1, 1, self._one((0, 255, 1)))

    def _current(self) -> Message:
        return mavlink.MAVLink_mission_set_current_message(1, 1, self._below(7))

    def _request(self) -> Message:
        kinds = (mavlink.MAVLink_mission_request_int_message, mavlink.MAVLink_mission_request_message)
        return self._one(kinds)(1, 1, self._below(7), self._one((0, 0, 1)))

    def _mode(self) -> Message:
        return mavlink.MAVLink_set_mode_message(1, 1, self._one(self._modes))

    def _rate(self) -> Message:
        rate = self._one((0, 1, 65535))
        return mavlink.MAVLink_request_data_stream_message(1, 1, self._below(14), rate, self._below(3))

    def _text(self) -> Message:
        return mavlink.MAVLink_statustext_message(
            self._below(256), bytes(range(130, 180)), self._below(65536), 0
        )

    # ------------------------------------------------------------ draws

    def _one(self, values: Sequence[Any]) -> Any:
        return values[int(self._rng.integers(len(values)))]

    def _some(self, values: Sequence[Any], count: int) -> list[Any]:
        return [self._one(values) for _ in range(count)]

    def _floats(self, count: int) -> list[float]:
        return self._some(FLOATS, count)

    def _below(self, limit: int) -> int:
        return int(self._rng.integers(limit))


def _long(command: int, *parameters: float) -> Message:
    filled = (*parameters, *(0.0,) * 7)[:7]
    return mavlink.MAVLink_command_long_message(1, 1, command, 0, *filled)
