"""Ultrasonic sensors' serial protocols: one pings by itself and sends 4-byte frames, one pings on request.

Both wait for their own sound before they write. A02YYUW data sheet (frames), US-100 manual (0x55 asks for a
distance in two bytes of millimetres, 0x50 for a temperature in one byte of degrees plus 45).
"""

import math
from typing import Final

from sitl.sensors.sensors import RangeSensor

SPEED_OF_SOUND_M_S: Final = 340.0
_NO_ECHO_S: Final = 0.03  # how long it listens
_ASK_DISTANCE, _ASK_TEMPERATURE = 0x55, 0x50
_TEMPERATURE_C = 20


class UltrasonicDevice:
    """A02YYUW-like; `period_s` between pings. `silent` is an unplugged sensor."""

    def __init__(self, sensor: RangeSensor, period_s: float = 0.08) -> None:
        self._sensor = sensor
        self._period_s = period_s
        self._next_s: float | None = None
        self._frame = b""
        self._answer_s = 0.0
        self.silent = False

    def receive(self, data: bytes) -> None:
        """Bytes from the companion computer are ignored."""

    @property
    def next_s(self) -> float:
        """Time of the next ping or transmission."""
        if self._next_s is None:
            return -math.inf
        return min(self._next_s, self._answer_s) if self._frame else self._next_s

    def step(self, now_s: float, height_m: float, tilt_rad: float = 0.0) -> bytes:
        if self._next_s is None:
            self._next_s = now_s
        if now_s >= self._next_s:
            self._next_s += self._period_s
            distance_m = self._sensor.sample(height_m, tilt_rad)
            self._answer_s = now_s + _echo_s(distance_m)
            self._frame = frame(distance_m)
        if not self._frame or now_s < self._answer_s:
            return b""
        data, self._frame = self._frame, b""
        return b"" if self.silent else data


class PolledUltrasonicDevice:
    """US-100 in serial mode. `silent` is an unplugged sensor."""

    def __init__(self, sensor: RangeSensor) -> None:
        self._sensor = sensor
        self._asked = b""
        self._answer = b""
        self._answer_s = 0.0
        self.silent = False

    def receive(self, data: bytes) -> None:
        """Bytes from the companion computer; ignored while it waits for an echo."""
        if not self._answer:
            self._asked += data

    @property
    def next_s(self) -> float:
        if self._asked:
            return -math.inf
        return self._answer_s if self._answer else math.inf

    def step(self, now_s: float, height_m: float, tilt_rad: float = 0.0) -> bytes:
        for command in self._asked:
            if command == _ASK_DISTANCE:
                distance_m = self._sensor.sample(height_m, tilt_rad)
                self._answer = millimetres(distance_m)
                self._answer_s = now_s + _echo_s(distance_m)
            elif command == _ASK_TEMPERATURE:
                self._answer, self._answer_s = bytes((_TEMPERATURE_C + 45,)), now_s
        self._asked = b""
        if not self._answer or now_s < self._answer_s:
            return b""
        data, self._answer = self._answer, b""
        return b"" if self.silent else data


def millimetres(distance_m: float | None) -> bytes:
    """Two bytes, the high one first; 0 when there is no echo."""
    number = 0 if distance_m is None else max(0, min(0xFFFF, round(distance_m * 1000.0)))
    return number.to_bytes(2, "big")


def frame(distance_m: float | None) -> bytes:
    high, low = millimetres(distance_m)
    return bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))


def _echo_s(distance_m: float | None) -> float:
    return 2.0 * distance_m / SPEED_OF_SOUND_M_S if distance_m else _NO_ECHO_S
