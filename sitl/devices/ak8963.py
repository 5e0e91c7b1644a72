"""The AK8963 magnetometer as registers, on the MPU9250's inner bus.

After PS-MPU-9250A-01 rev. 1.1: power-down, continuous (8 and 100 Hz) and fuse-ROM modes, 16 or 14 bits,
ST1 data-ready, ST2 overflow. Its axes are not the accelerometer's: x and y are swapped, z is opposite.
"""

from __future__ import annotations

import struct
from typing import Final

from companion.base.geometry import Vector3
from sitl.sensors.sensors import MagSensor

ADDRESS: Final = 0x0C
_WIA, _ST1, _HXL, _ST2, _CNTL1, _CNTL2, _ASAX = 0x00, 0x02, 0x03, 0x09, 0x0A, 0x0B, 0x10
_FUSE_ROM: Final = 0x0F
_PERIOD_S: Final = {0x02: 1.0 / 8.0, 0x06: 1.0 / 100.0}
_MEASUREMENT_S: Final = 0.0072
_FULL_SCALE_UT: Final = 4912.0


class Ak8963Device:
    """The magnetometer's registers. `adjustment` are the fuse ROM's three bytes.

    `silent` is a failed one: it acknowledges nothing.
    """

    def __init__(
        self,
        sensor: MagSensor,
        adjustment: tuple[int, int, int] = (176, 178, 165),
        clock_error: float = -0.004,
    ) -> None:
        self._sensor = sensor
        self._adjustment = adjustment
        self._per_ut = [1.0 / (0.15 * ((value - 128) * 0.5 / 128.0 + 1.0)) for value in adjustment]
        self._clock = 1.0 + clock_error
        self.silent = False
        self.reset()

    def reset(self) -> None:
        """Power-on state: powered down."""
        self._registers = bytearray(0x13)
        self._registers[_WIA] = 0x48
        self._period_s: float | None = None
        self._middle_s: float | None = None
        self._measured: tuple[float, Vector3] | None = None

    def is_due(self, now_s: float) -> bool:
        """Whether it measures in a step at that time: then the field counts."""
        return self._period_s is not None and (self._middle_s is None or now_s >= self._middle_s)

    def step(self, now_s: float, field_body_ut: Vector3, throttle: float) -> None:
        """Measure when it is time to; the result shows half a measurement later."""
        if self._measured is not None and now_s >= self._measured[0]:
            self._latch(self._measured[1])
            self._measured = None
        if self._period_s is None:
            return
        if self._middle_s is None:
            self._middle_s = now_s + 0.5 * _MEASUREMENT_S
        if now_s >= self._middle_s:
            field = self._sensor.sample(field_body_ut, throttle)
            self._measured = (self._middle_s + 0.5 * _MEASUREMENT_S, field)
            self._middle_s += self._period_s

    def read(self, register: int, length: int) -> bytes:
        """Read registers; reading the data or ST2 clears data-ready."""
        data = bytes(self._registers[register : register + length]).ljust(length, b"\0")
        if register <= _ST2 and register + length > _HXL:
            self._registers[_ST1] = 0
        return data

    def write(self, register: int, value: int) -> None:
        """Write a register: CNTL1 (mode, width) and CNTL2 (reset) do something."""
        if register == _CNTL2 and value & 0x01:
            self.reset()
        elif register == _CNTL1:
            self._registers[_CNTL1] = value
            mode = value & 0x0F
            period_s = _PERIOD_S.get(mode)
            self._period_s = None if period_s is None else period_s * self._clock
            self._middle_s = self._measured = None
            fuses = bytes(self._adjustment) if mode == _FUSE_ROM else bytes(3)
            self._registers[_ASAX : _ASAX + 3] = fuses

    def _latch(self, field: Vector3) -> None:
        x, y, z = field
        sixteen_bits = self._registers[_CNTL1] & 0x10
        step = 1.0 if sixteen_bits else 0.25
        limit = 32760 if sixteen_bits else 8190
        counts = [value * k * step for value, k in zip((y, x, -z), self._per_ut, strict=True)]
        raw = [max(-limit, min(limit, round(count))) for count in counts]
        struct.pack_into("<hhh", self._registers, _HXL, *raw)
        overflow = 0x08 if abs(x) + abs(y) + abs(z) >= _FULL_SCALE_UT else 0x00
        self._registers[_ST2] = sixteen_bits | overflow
        self._registers[_ST1] = 0x01
