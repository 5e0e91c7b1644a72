"""A downward ultrasonic that talks by itself: bytes to distances along its axis. No input or output here.

Frames of the JSN-SR04T (serial mode), A02YYUW and alike, 9600 8N1, by themselves every 50 to 100 ms:
0xFF, distance high, distance low (mm), low byte of the sum of the three. A distance of 0, or beyond the
range, is "no echo".
"""

import math
from typing import Final

from companion.base.messages import RangeSample
from companion.config import RangeConfig

# ---------------------------------------------------------------- spikes
# Kept from the estimator without delaying what is good. A spike (a rotor's noise, a second way of the sound,
# the shell's ringing) stands alone; a real step, as at the pad's edge, stays. So a distance that could not
# have been reached from the last good one at `maximum_speed_m_s` waits for the next: when that agrees with
# it, both were true and the newer is taken. What fits is passed on at once, as it is: no filter, no lag.
# Spikes that last are the estimator's to refuse, which knows more than one sensor.

MARGIN_M: Final = 0.03
MARGIN_SHARE: Final = 0.03  # three standard deviations of 1 %
REMEMBER_S: Final = 1.0  # after so long the last distance says nothing any more


class SpikeFilter:
    """The filter of one sensor."""

    def __init__(self, config: RangeConfig) -> None:
        self._speed_m_s = config.maximum_speed_m_s
        self._good: RangeSample | None = None
        self._doubted: RangeSample | None = None

    def step(self, sample: RangeSample) -> RangeSample | None:
        """The sample, or None while it has to be taken for a spike."""
        if self._follows(self._good, sample) or self._follows(self._doubted, sample):
            self._good, self._doubted = sample, None
            return sample
        self._doubted = sample
        return None

    def _follows(self, before: RangeSample | None, sample: RangeSample) -> bool:
        if before is None:
            return False
        elapsed_s = abs(sample.time_s - before.time_s)
        farther_m = max(before.distance_m, sample.distance_m)
        allowed_m = self._speed_m_s * elapsed_s + MARGIN_M + MARGIN_SHARE * farther_m
        return elapsed_s <= REMEMBER_S and abs(sample.distance_m - before.distance_m) <= allowed_m


RANGE_BAUD: Final = 9600  # fixed in these sensors and in the US-100
FRAME_BYTES: Final = 4
SILENCE_S: Final = 1.0  # ten frames and more: it sends them whether or not there is an echo
SPEED_OF_SOUND_M_S: Final = 340.0  # what the sensor itself reckons with
_HEADER: Final = 0xFF
_BITS_PER_BYTE: Final = 10


class Ultrasonic:
    """Finds frames in what comes, byte by byte or in heaps; garbage between them does no harm.

    `problem` says in one line what is wrong with sensor or line, None when all is well, as of the last
    `watch`.
    """

    def __init__(self, config: RangeConfig) -> None:
        self._minimum_m = config.minimum_m
        self._maximum_m = config.maximum_m
        self._byte_s = _BITS_PER_BYTE / RANGE_BAUD
        self._buffer = bytearray()
        self._started_s: float | None = None
        self._heard_s = self._frame_s = -math.inf  # when the last one came
        self.problem: str | None = None

    def pending(self, now_s: float) -> bytes:
        """Nothing to send: it pings by itself."""
        return b""

    def watch(self, now_s: float) -> None:
        """Bring `problem` up to date; call it about once a second."""
        if self._started_s is None:
            self._started_s = now_s
        self.problem = None
        if now_s - max(self._started_s, self._frame_s) > SILENCE_S:
            heard = now_s - self._heard_s <= SILENCE_S
            self.problem = f"ultrasonic: {'no frame in what is' if heard else 'nothing'} received"

    def feed(self, data: bytes, received_s: float) -> list[RangeSample]:
        """Echoes in the bytes so far; `received_s` is when the last of `data` came.

        `time_s` is when the sound met the surface: the frame leaves the sensor as the echo arrives, so it is
        the frame's first bit less half the sound's way there and back.
        """
        self._buffer += data
        self._heard_s = received_s
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
            self._frame_s = received_s
            after = len(self._buffer) - FRAME_BYTES
            del self._buffer[:FRAME_BYTES]
            distance_m = (high << 8 | low) / 1000.0
            if self._minimum_m <= distance_m <= self._maximum_m:
                echo_s = received_s - (FRAME_BYTES + after) * self._byte_s
                samples.append(RangeSample(echo_s - distance_m / SPEED_OF_SOUND_M_S, distance_m))
        return samples
