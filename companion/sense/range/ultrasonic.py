"""Downward ultrasonics on a serial line, 9600 8N1: bytes to distances along their axis. No I/O here.

A distance of 0, or beyond the range, is "no echo". One at the sensor's floor or below tells only that
something is nearer than that: it is no distance either.

One that talks by itself (`Ultrasonic`: JSN-SR04T in serial mode, A02YYUW and alike) sends a frame every 50 to
100 ms: 0xFF, distance high, distance low (mm), low byte of the sum of the three. Where several have come at
once, whoever reads was held up: nobody knows when the earlier ones came.

One that is asked (`Us100`: US-100 in serial mode, jumper set): 0x55 has it ping; the answer is the distance
in millimetres, two bytes, the high one first, at the moment of the echo. A JSN-SR04T that is asked answers
the same question with a frame as above: that is recognised and named, but not taken, since its modes differ
in when they measure. There is neither a header nor a checksum, so what counts is when bytes come: those
before a question are no answer, nor are those that come before the sound of it can be back, and a question
whose answer is not whole when the next one is due has none.
The sensor reckons with the temperature that it measures itself.
"""

import math
from typing import Final

from companion.base.messages import RangeSample
from companion.config import RangeConfig

RANGE_BAUD: Final = 9600  # fixed in these sensors
FRAME_BYTES: Final = 4
ASK: Final = b"\x55"
ANSWER_BYTES: Final = 2
FRAMES_IN_A_ROW: Final = 3  # two bytes of noise behind an answer look like one now and then
SILENCE_S: Final = 1.0  # ten frames and more: a sensor sends them whether or not there is an echo
SPEED_OF_SOUND_M_S: Final = 340.0  # near enough for when the sound met the surface
_HEADER: Final = 0xFF
_BYTE_S: Final = 10 / RANGE_BAUD


class _SerialUltrasonic:
    """What both have in common.

    `problem` says in one line what is wrong with sensor or line, None when all is well, as of the last
    `watch`.
    """

    _MESSAGE: str  # what comes from such a sensor

    def __init__(self, config: RangeConfig) -> None:
        self._config = config
        self._buffer = bytearray()
        self._started_s: float | None = None
        self._heard_s = self._message_s = -math.inf  # when the last one came
        self.problem: str | None = None

    def watch(self, now_s: float) -> None:
        """Bring `problem` up to date; call it about once a second."""
        if self._started_s is None:
            self._started_s = now_s
        self.problem = None
        if now_s - max(self._started_s, self._message_s) > SILENCE_S:
            heard = now_s - self._heard_s <= SILENCE_S
            self.problem = f"ultrasonic: {f'no {self._MESSAGE} in what is' if heard else 'nothing'} received"

    def _echo(self, distance_mm: int, began_s: float) -> list[RangeSample]:
        """The echo, if there is one, of which the sensor began to tell at `began_s`.

        `time_s` is when the sound met the surface: half of its way before the sensor hears it.
        """
        distance_m = distance_mm / 1000.0
        if not self._config.measures(distance_m):
            return []
        return [RangeSample(began_s - distance_m / SPEED_OF_SOUND_M_S, distance_m)]


class Ultrasonic(_SerialUltrasonic):
    """Finds frames in what comes, byte by byte or in heaps; garbage between them does no harm."""

    _MESSAGE = "frame"

    def pending(self, now_s: float) -> bytes:
        """Nothing to send: it pings by itself."""
        return b""

    def feed(self, data: bytes, received_s: float) -> list[RangeSample]:
        """The echo of the last whole frame in `data`; `received_s` is when the last of `data` came."""
        self._buffer += data
        self._heard_s = received_s
        samples: list[RangeSample] = []
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
            self._message_s = received_s
            # the frame leaves the sensor as the echo arrives
            samples = self._echo(high << 8 | low, received_s - len(self._buffer) * _BYTE_S)
            del self._buffer[:FRAME_BYTES]
        return samples


class Us100(_SerialUltrasonic):
    """Asks `config.rate_hz` times a second and understands the answers."""

    _MESSAGE = "answer"

    def __init__(self, config: RangeConfig) -> None:
        super().__init__(config)
        self._period_s = 1.0 / config.rate_hz
        self._asked_s = -math.inf
        self._waiting = False
        self._frames = 0

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
        super().watch(now_s)
        if self._frames >= FRAMES_IN_A_ROW:
            self.problem = (
                "ultrasonic: answers with 4-byte frames, as a JSN-SR04T that is asked; expected a US-100 for "
                "sense.range.kind polled, or the JSN-SR04T set to send by itself and kind frames"
            )

    def _note_frame(self) -> None:
        """Whether all that has come since the last question is a frame of the other kind."""
        b = self._buffer
        frame = len(b) == FRAME_BYTES and b[0] == _HEADER and sum(b[:3]) & 0xFF == b[3]
        if b:
            self._frames = self._frames + 1 if frame else 0

    def feed(self, data: bytes, received_s: float) -> list[RangeSample]:
        """The echo that `data` completes; `received_s` is when its last byte came."""
        self._heard_s = received_s
        answered = not self._waiting
        self._buffer += data[: FRAME_BYTES + 1 - len(self._buffer)]
        if answered or len(self._buffer) < ANSWER_BYTES:
            return []
        distance_mm = int.from_bytes(self._buffer[:ANSWER_BYTES], "big")
        sound_s = 2.0 * distance_mm / 1000.0 / SPEED_OF_SOUND_M_S
        if self._buffer[0] != _HEADER and received_s - self._asked_s < sound_s:
            self._buffer.clear()  # the answer to an earlier question, read late
            return []
        self._waiting = False
        if len(self._buffer) > ANSWER_BYTES or self._buffer[0] == _HEADER:
            return []  # one question has one answer: this is noise, or another sensor's; 65 m is none
        self._message_s = received_s
        return self._echo(distance_mm, received_s - ANSWER_BYTES * _BYTE_S)
