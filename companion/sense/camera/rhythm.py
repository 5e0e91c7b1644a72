"""Whether a frame that brings no time of its own has come in time, by the rhythm of those before it. Pure.

When such a frame was exposed is known by its arrival alone, less the delay that its stream usually has.
Frames come late, never early. What a link or a loop held up comes in a heap, each frame less late than the
one before, the last one in time. If frames were lost instead, those after them stay as late as the first, as
they do when a camera has slowed down. Which of the two it is shows after `SURE_S`; until then it is not known
when a late frame was exposed.
"""

from collections import deque
from typing import Final

LATE_S: Final = 0.03
SURE_S: Final = 0.2  # meanwhile a link that carries a fifth more than the frames catches up by LATE_S
_GAIN: Final = 0.1  # of the phase; the period's follows from it (critically damped alpha-beta filter)


class FrameRhythm:
    """Phase and period of the frames of one connection, by their numbers and arrivals."""

    def __init__(self, rate_hz: float) -> None:
        """`rate_hz` to begin with: the true one is learnt."""
        self._period_s = 1.0 / rate_hz
        self._number: int | None = None
        self._count = 0
        self._due_s = 0.0
        self._late: deque[tuple[int, float, float]] = deque()  # in a row: count, arrival, by how much

    def in_time(self, number: int, received_s: float) -> bool:
        """Whether frame `number`, those between counted too, came no later than it was due."""
        if self._number is None:
            self._number, self._due_s = number - 1, received_s - self._period_s
        frames = max(1, number - self._number)  # a sender may not count, or begin to count anew
        self._number, self._count = number, self._count + frames
        self._due_s += frames * self._period_s
        off_s = received_s - self._due_s
        if off_s > LATE_S:
            return self._stays_late(received_s, off_s)
        self._late.clear()
        # what comes early shows at once that those before were late
        gain = 1.0 if off_s < -LATE_S else _GAIN
        self._due_s += gain * off_s
        self._period_s += 0.5 * _GAIN * gain * off_s / frames
        return True

    def _stays_late(self, received_s: float, late_s: float) -> bool:
        """Whether frames have been late for so long, no less at the end, that this is their rhythm now."""
        self._late.append((self._count, received_s, late_s))
        while len(self._late) > 2 and received_s - self._late[1][1] >= SURE_S:
            self._late.popleft()
        first_count, first_received_s, first_late_s = self._late[0]
        if received_s - first_received_s < SURE_S or late_s <= first_late_s - LATE_S:
            return False
        self._period_s = (received_s - first_received_s) / (self._count - first_count)
        self._due_s = received_s
        self._late.clear()
        return True
