"""A downward ultrasonic that is asked: the US-100 in serial mode (jumper set). No input or output here.

9600 8N1: 0x55 has it ping; the answer is the distance in millimetres, two bytes, the high one first, at the
moment of the echo. A JSN-SR04T that is asked answers the same question with four bytes: 0xFF, the distance in
millimetres, the sum of the three: that is recognised and named, but not taken, since its modes differ in when
they measure. There is neither a header nor a checksum, so what counts is when bytes come: those before
a question are no answer, and a question whose answer is not whole when the next one is due has none. The
sensor reckons with the temperature that it measures itself. 0 or a distance beyond the range is "no echo".
"""

import math
from typing import Final

from companion.base.messages import RangeSample
from companion.config import RangeConfig
from companion.sense.range.ultrasonic import RANGE_BAUD

ASK: Final = b"\x55"
ANSWER_BYTES: Final = 2
FRAME_HEAD: Final = 0xFF
FRAME_BYTES: Final = 4
FRAMES_IN_A_ROW: Final = 3  # two bytes of noise behind an answer look like one now and then
SILENCE_S: Final = 1.0
SPEED_OF_SOUND_M_S: Final = 340.0  # near enough for when the sound met the ground
_BITS_PER_BYTE: Final = 10


class Us100:
    """Asks `config.rate_hz` times a second and understands the answers.

    `problem` says in one line what is wrong with sensor or line, None when all is well, as of the last
    `watch`.
    """

    def __init__(self, config: RangeConfig) -> None:
        self._minimum_m = config.minimum_m
        self._maximum_m = config.maximum_m
        self._period_s = 1.0 / config.rate_hz
        self._byte_s = _BITS_PER_BYTE / RANGE_BAUD
        self._buffer = bytearray()
        self._asked_s = -math.inf
        self._waiting = False
        self._frames = 0
        self._started_s: float | None = None
        self._heard_s = self._answer_s = -math.inf
        self.problem: str | None = None

    def pending(self, now_s: float) -> bytes:
        """What to send now: the question when it is due."""
        if now_s - self._asked_s < self._period_s - 1e-6:
            return b""
        self._note_frame()
        self._buffer.clear()
        self._asked_s = now_s
        self._waiting = True
        return ASK

    def watch(self, now_s: float) -> None:
        """Bring `problem` up to date; call it about once a second."""
        if self._started_s is None:
            self._started_s = now_s
        self.problem = None
        if now_s - max(self._started_s, self._answer_s) > SILENCE_S:
            heard = now_s - self._heard_s <= SILENCE_S
            self.problem = f"ultrasonic: {'no answer in what is' if heard else 'nothing'} received"
        if self._frames >= FRAMES_IN_A_ROW:
            self.problem = (
                "ultrasonic: answers with 4-byte frames, as a JSN-SR04T that is asked; expected a US-100 for "
                "sense.range.kind polled, or the JSN-SR04T set to send by itself and kind frames"
            )

    def _note_frame(self) -> None:
        """Whether all that has come since the last question is a frame of the other kind."""
        b = self._buffer
        frame = len(b) == FRAME_BYTES and b[0] == FRAME_HEAD and sum(b[:3]) & 0xFF == b[3]
        if b:
            self._frames = self._frames + 1 if frame else 0

    def feed(self, data: bytes, received_s: float) -> list[RangeSample]:
        """The echo that `data` completes; `received_s` is when its last byte came.

        `time_s` is when the sound met the surface: the answer's first bit less half the sound's way.
        """
        self._heard_s = received_s
        answered = not self._waiting
        self._buffer += data[: FRAME_BYTES + 1 - len(self._buffer)]
        if answered or len(self._buffer) < ANSWER_BYTES:
            return []
        self._waiting = False
        if len(self._buffer) > ANSWER_BYTES or self._buffer[0] == FRAME_HEAD:
            return []  # one question has one answer: this is noise, or another sensor's; 65 m is none
        self._answer_s = received_s
        distance_m = int.from_bytes(self._buffer, "big") / 1000.0
        if not self._minimum_m <= distance_m <= self._maximum_m:
            return []
        echo_s = received_s - ANSWER_BYTES * self._byte_s
        return [RangeSample(echo_s - distance_m / SPEED_OF_SOUND_M_S, distance_m)]
