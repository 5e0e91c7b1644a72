"""The ultrasonic as bytes: pings by itself, waits for its own sound, writes a 4-byte frame."""

from __future__ import annotations

from typing import Final

from sitl.sensors import RangeSensor

SPEED_OF_SOUND_M_S: Final = 340.0
_NO_ECHO_S: Final = 0.03  # how long it listens


class UltrasonicDevice:
    """A02YYUW-like; `period_s` between pings. `silent` is an unplugged sensor."""

    def __init__(self, sensor: RangeSensor, period_s: float = 0.08) -> None:
        self._sensor = sensor
        self._period_s = period_s
        self._next_s: float | None = None
        self._frame = b""
        self._answer_s = 0.0
        self.silent = False

    def step(self, now_s: float, height_m: float, tilt_rad: float = 0.0) -> bytes:
        """Bytes that start on the line now; `height_m` of the sensor over the floor under it."""
        if self._next_s is None:
            self._next_s = now_s
        if now_s >= self._next_s:
            self._next_s += self._period_s
            distance_m = self._sensor.sample(height_m, tilt_rad)
            self._answer_s = now_s + (2.0 * distance_m / SPEED_OF_SOUND_M_S if distance_m else _NO_ECHO_S)
            self._frame = frame(distance_m)
        if not self._frame or now_s < self._answer_s:
            return b""
        data, self._frame = self._frame, b""
        return b"" if self.silent else data


def frame(distance_m: float | None) -> bytes:
    """The serial frame of a distance; 0 mm when there is no echo."""
    millimetres = 0 if distance_m is None else max(0, min(0xFFFF, round(distance_m * 1000.0)))
    high, low = divmod(millimetres, 256)
    return bytes((0xFF, high, low, (0xFF + high + low) & 0xFF))
