"""The downward ultrasonic: bytes of its serial mode to distances along its axis. No input or output here.

Frames of the JSN-SR04T (serial mode), A02YYUW and alike, 9600 8N1, by themselves every 50 to 100 ms:
0xFF, distance high, distance low (mm), low byte of the sum of the three. A distance of 0, or beyond the
range, is "no echo".
"""

from __future__ import annotations

from typing import Final

from companion.config import RangeConfig
from companion.messages import RangeSample

FRAME_BYTES: Final = 4
SPEED_OF_SOUND_M_S: Final = 340.0  # what the sensor itself reckons with
_HEADER: Final = 0xFF
_BITS_PER_BYTE: Final = 10


class Ultrasonic:
    """Finds frames in what comes, byte by byte or in heaps; garbage between them does no harm."""

    def __init__(self, config: RangeConfig) -> None:
        self._minimum_m = config.minimum_m
        self._maximum_m = config.maximum_m
        self._byte_s = _BITS_PER_BYTE / config.baud
        self._buffer = bytearray()

    def feed(self, data: bytes, received_s: float) -> list[RangeSample]:
        """Echoes in the bytes so far; `received_s` is when the last of `data` came.

        `time_s` is when the sound met the surface: the frame leaves the sensor as the echo arrives, so it is
        the frame's first bit less half the sound's way there and back.
        """
        self._buffer += data
        samples = []
        while True:
            start = self._buffer.find(_HEADER)
            if start < 0:
                self._buffer.clear()
                break
            del self._buffer[:start]
            if len(self._buffer) < FRAME_BYTES:
                break
            header, high, low, total = self._buffer[:FRAME_BYTES]
            if (header + high + low) & 0xFF != total:
                # a 0xFF inside a frame, or a damaged one: the next 0xFF may begin a whole one
                del self._buffer[:1]
                continue
            after = len(self._buffer) - FRAME_BYTES
            del self._buffer[:FRAME_BYTES]
            distance_m = (high << 8 | low) / 1000.0
            if self._minimum_m <= distance_m <= self._maximum_m:
                echo_s = received_s - (FRAME_BYTES + after) * self._byte_s
                samples.append(RangeSample(echo_s - distance_m / SPEED_OF_SOUND_M_S, distance_m))
        return samples
