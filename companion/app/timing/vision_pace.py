"""How much of the computer vision may take: fewer frames, in steps, before control is late.

Vision and control share the processor. Each step leaves it alone for one more of vision's own times after a
frame; a step back follows after long enough without a late cycle. Each is announced, and so is control that
is late all the same: FIFO overflows and lost estimates follow from it. s.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from statistics import fmean, median
from typing import Final

from companion.link.codec import Severity
from companion.plan.landing.contact import UNSEEN_S

FRAMES: Final = 10  # by which vision's time is known
CYCLES: Final = 30  # control's, by which a step is judged; the next one after as many
CALM_CYCLES: Final = 600  # twenty seconds at 30 Hz
LATE_SHARE: Final = 0.5  # of a period, on average: it is late


class VisionPace:
    """`took` and `rest` after each frame, `judge` in each control cycle."""

    def __init__(self, notify: Callable[[str, str, Severity], None]) -> None:
        self._notify = notify
        self._took_s: deque[float] = deque(maxlen=FRAMES)
        self._late_s: deque[float] = deque(maxlen=CYCLES)
        self._calm = 0
        self._told = False  # that no fewer frames are left to take
        self.rests = 0  # of vision's own times after a frame

    @property
    def vision_s(self) -> float | None:
        """How long (s) a frame takes from its receipt until it is used; None until some have come."""
        return median(self._took_s) if len(self._took_s) == FRAMES else None

    async def rest(self, took_s: float) -> None:
        """A frame took so long: leave the processor to control for a while, while frames are not too rare."""
        self._took_s.append(took_s)
        if self.rests:
            await asyncio.sleep(min(self.rests * took_s, max(0.0, UNSEEN_S - took_s)))

    def judge(self, late_s: float, period_s: float) -> None:
        """A control cycle begins, so late."""
        self._late_s.append(late_s)
        self._calm = self._calm + 1 if late_s <= LATE_SHARE * period_s else 0
        if len(self._late_s) < CYCLES:
            return
        mean_s = fmean(self._late_s)
        late = mean_s > LATE_SHARE * period_s
        more = late and self._fewer_left
        if late and not more and not self._told:
            self._told = True
            words = f"control {1e3 * mean_s:.0f} ms late, vision already at its lowest rate"
            self._notify("computer", words, "warning")
        if self._calm >= CALM_CYCLES:
            self._told = False
        if more or (self.rests and self._calm >= CALM_CYCLES):
            self.rests += 1 if more else -1
            self._late_s.clear()
            self._calm = 0
            share = "every frame" if not self.rests else f"1 of {1 + self.rests} frames"
            why = f"control {1e3 * mean_s:.0f} ms late" if more else "control in time"
            self._notify("computer", f"{why}: vision takes {share}", "warning" if more else "info")

    @property
    def _fewer_left(self) -> bool:
        """Whether fewer frames still follow one another closely enough to fly by."""
        vision_s = self.vision_s
        return vision_s is not None and (1 + self.rests) * vision_s < UNSEEN_S
