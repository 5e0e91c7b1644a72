"""Frames as a sensor with noise gives them, and a camera that does what a test says."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from companion.base.clock import Clock
from companion.base.messages import Frame
from companion.sense.camera.reader import ReadBack

AGE_S, FRAME_S = 0.02, 1 / 30
_RNG = np.random.default_rng(11)
_NOISE = [_RNG.integers(80, 120, (480, 640)).astype(np.uint8) for _ in range(3)]


def noisy(number: int) -> NDArray[np.uint8]:
    """A picture of nothing with its own noise: another than those of the numbers beside it."""
    return _NOISE[number % len(_NOISE)]


def noisy_frame(number: int, time_s: float) -> Frame:
    """A good frame that was exposed at that time."""
    return Frame(time_s, time_s + AGE_S, number, noisy(number))


class ScriptedCamera:
    """A `LiveSource` at 30 frames a second; `act` makes of each frame another, None (silence) or raises."""

    def __init__(self, act: Callable[[Frame], Frame | None], *, held_for_s: float = 0.0) -> None:
        """`held_for_s`: how long its driver keeps the device once it is to let go."""
        self._act, self._clock, self._number = act, Clock(), -1
        self._due_s = self._clock.now_s() + FRAME_S
        self._held_for_s, self._parted_s = held_for_s, float("inf")
        self.notes: list[str] = []
        self.closed = False
        self.read_back = ReadBack(0.004, 2.0)

    @property
    def held(self) -> bool:
        """See `LiveSource`."""
        return self._clock.now_s() < self._parted_s + self._held_for_s

    async def next(self) -> Frame:
        """See `LiveSource`."""
        while True:
            await self._clock.sleep_until(self._due_s)
            self._due_s = self._clock.now_s() + FRAME_S
            self._number += 1
            frame = self._act(noisy_frame(self._number, self._clock.now_s() - AGE_S))
            if frame is not None:
                return frame

    def take_notes(self) -> list[str]:
        """See `LiveSource`."""
        notes, self.notes = self.notes, []
        return notes

    def let_go(self) -> None:
        """See `LiveSource`."""
        self._parted_s = self._clock.now_s()

    def close(self) -> None:
        """See `LiveSource`."""
        self.let_go()
        self.closed = True
