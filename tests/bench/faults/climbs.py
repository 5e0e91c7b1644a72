"""Climbs by the app's setpoints that no text announced, in the record of a flight.

A climb begins at the last moment before the rise at which the vehicle climbed with less than 0.1 m/s, and
goes on until it has not risen for half a second; a shorter pause is none once it has risen 0.2 m. A text that
announces a climb covers all of one that begins from 1 s before the text to 3 s after it.

What rises more slowly than 0.7 m in 10 s follows the receiver, whose height wanders by 1.5 m (standard
deviation) in a minute: the app, which has no other height once the pad is out of view, flies level by all it
knows. Of that the judge allows what it allows of fence and ceiling.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from sitl.mavlink.app_words import AppText
from tests.bench.faults.witness import SAMPLE_S, Sample

CLIMB_M: Final = 0.7
WITHIN_S: Final = 10.0
WANDER_M: Final = 3.0
DRIFT_M: Final = 0.2
RISING_M_S: Final = 0.1
PAUSE_S: Final = 0.5
ANNOUNCED_BEFORE_S: Final = 3.0
ANNOUNCED_AFTER_S: Final = 1.0
# what the app says when it is about to climb; the name of a phase alone says nothing of it
ANNOUNCES: Final = re.compile(
    r"climbing |back to .* over the pad to try again|waiting again over the pad|take off: "
)


def unannounced_climbs(flown: Iterable[Sample], texts: Sequence[AppText]) -> Iterator[str]:
    """The first rise by more than `CLIMB_M` of what the app has `flown` that nothing announced."""
    announced_s = [text.time_s for text in texts if ANNOUNCES.search(text.text)]
    climb = _Climb()
    for sample in flown:
        if not climb.step(sample):
            continue
        if not any(-ANNOUNCED_BEFORE_S <= t - climb.begun_s <= ANNOUNCED_AFTER_S for t in announced_s):
            yield f"climbed from {climb.begun_s:.1f} s, unannounced"
            return
        climb.known = True


class _Climb:
    """Follows the rise; what is `known` counts no more until it ends."""

    def __init__(self) -> None:
        self.begun_s = 0.0
        self.known = False
        self._lowest_down_m = -math.inf
        self._lately: deque[tuple[float, float]] = deque()  # time and down, the lowest first, then rising
        self._seen_s = self._still_since_s = -math.inf

    def step(self, sample: Sample) -> bool:
        """Whether the vehicle climbs: it has risen by so much, lately or at all since the app flies it."""
        now_s, down_m = sample.time_s, sample.position_ned_m[2]
        if now_s - self._seen_s > 1.5 * SAMPLE_S:  # meanwhile the autopilot flew it, or it stood
            self.begun_s, self.known, self._lowest_down_m = now_s, False, down_m
            self._lately.clear()
            self._still_since_s = now_s
        self._seen_s = now_s
        still = sample.velocity_ned_m_s[2] > -RISING_M_S
        self._still_since_s = min(self._still_since_s, now_s) if still else math.inf
        if now_s - self._still_since_s >= PAUSE_S:
            self.begun_s, self.known = now_s, False
        self._lowest_down_m = down_m if self.known else max(self._lowest_down_m, down_m)
        rise_m = self._lowest_lately_m(now_s, down_m) - down_m
        if still and not self.known and rise_m <= DRIFT_M:
            self.begun_s = now_s
        return rise_m >= CLIMB_M or self._lowest_down_m - down_m >= WANDER_M

    def _lowest_lately_m(self, now_s: float, down_m: float) -> float:
        """The largest down within `WITHIN_S`, or since what is known."""
        lately = self._lately
        if self.known:
            lately.clear()
        while lately and lately[-1][1] <= down_m:
            lately.pop()
        lately.append((now_s, down_m))
        while now_s - lately[0][0] > WITHIN_S:
            lately.popleft()
        return lately[0][1]
