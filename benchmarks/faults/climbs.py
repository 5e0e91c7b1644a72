"""Climbs by the app's setpoints that no text announced, in the record of a flight.

A climb is a rise of the vehicle, in truth, by 0.7 m that the app commands: its reference has risen as much
since the lowest, however slowly. One that it does not command counts when it takes less than 10 s.

A climb begins at the last moment before the rise at which the vehicle climbed with less than 0.1 m/s, and
goes on until it has not risen for half a second; a shorter pause is none once it has risen 0.2 m. A text that
announces a climb covers all of one that begins from 1 s before the text to 3 s after it.

What rises over a level reference as the receiver wanders, by 1.5 m (standard deviation) in a minute, is flown
level by all that the app knows: it has no other height once the pad is out of view. So what does not count
in 10 s is how far the app's believed height has fallen behind the true one, as far as the receiver's own
error, which the simulator knows, explains it. Of a slow rise the judge allows what it allows of fence and
ceiling.
"""

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from benchmarks.faults.witness import SAMPLE_S, Commanded, TruthSample
from sitl.faults.schedule import AppText

CLIMB_M: Final = 0.7
WITHIN_S: Final = 10.0
WANDER_M: Final = 3.0
DRIFT_M: Final = 0.2
RISING_M_S: Final = 0.1
PAUSE_S: Final = 0.5
FOLLOWS_S: Final = 3.0  # so late the app's height follows the receiver's
ANNOUNCED_BEFORE_S: Final = 3.0
ANNOUNCED_AFTER_S: Final = 1.0
# what the app says when it is about to climb; the name of a phase alone says nothing of it
ANNOUNCES: Final = re.compile(
    r"climbing |back to .* over the pad to try again|waiting again over the pad|take off: "
)


def unannounced_climbs(
    flown: Iterable[TruthSample], texts: Sequence[AppText], commanded: Sequence[Commanded] = ()
) -> Iterator[str]:
    """The first rise by more than `CLIMB_M` of what the app has `flown` that nothing announced."""
    reference = _Reference(commanded)
    announced_s = [text.time_s for text in texts if ANNOUNCES.search(text.text)]
    climb = _Climb()
    for sample in flown:
        if not climb.step(sample, reference.up_m(sample.time_s)):
            continue
        if not any(-ANNOUNCED_BEFORE_S <= t - climb.begun_s <= ANNOUNCED_AFTER_S for t in announced_s):
            yield f"climbed from {climb.begun_s:.1f} s, unannounced"
            return
        climb.known = True


class _Reference:
    """How far the reference has risen; what differs between two frames is no rise."""

    def __init__(self, commanded: Sequence[Commanded]) -> None:
        self._commanded, self._next, self._up_m = commanded, 0, 0.0

    def up_m(self, time_s: float) -> float:
        """Its height (m) over where it began; the times never run backwards."""
        while self._next < len(self._commanded) and self._commanded[self._next].time_s <= time_s:
            now, before = self._commanded[self._next], self._commanded[max(0, self._next - 1)]
            self._up_m += before.down_m - now.down_m if now.origin == before.origin else 0.0
            self._next += 1
        return self._up_m


class _Climb:
    """Follows the rise; what is `known` counts no more until it ends."""

    def __init__(self) -> None:
        self.begun_s = 0.0
        self.known = False
        self._lowest_down_m = -math.inf
        self._lowest_commanded_m = math.inf
        self._lately: deque[tuple[float, float]] = deque()  # time and down, the lowest first, then rising
        self._samples: deque[TruthSample] = deque()  # of that time, and of what the app may follow late
        self._seen_s = self._still_since_s = -math.inf

    def step(self, sample: TruthSample, commanded_m: float) -> bool:
        """Whether the vehicle climbs: it has risen by so much, lately or at all since the app flies it.

        `commanded_m`: the reference's height, from anywhere.
        """
        now_s, down_m = sample.time_s, sample.position_ned_m[2]
        if now_s - self._seen_s > 1.5 * SAMPLE_S:  # meanwhile the autopilot flew it, or it stood
            self.begun_s, self.known, self._lowest_down_m = now_s, False, down_m
            self._lowest_commanded_m = commanded_m
            self._lately.clear()
            self._still_since_s = now_s
        self._seen_s = now_s
        still = sample.velocity_ned_m_s[2] > -RISING_M_S
        self._still_since_s = min(self._still_since_s, now_s) if still else math.inf
        if now_s - self._still_since_s >= PAUSE_S:
            self.begun_s, self.known = now_s, False
        self._lowest_down_m = down_m if self.known else max(self._lowest_down_m, down_m)
        self._lowest_commanded_m = commanded_m if self.known else min(self._lowest_commanded_m, commanded_m)
        rise_m = self._lowest_lately_m(now_s, down_m) - down_m
        if still and not self.known and rise_m <= DRIFT_M:
            self.begun_s = now_s
        self._samples.append(sample)
        while now_s - self._samples[0].time_s > WITHIN_S + FOLLOWS_S:
            self._samples.popleft()
        risen_m, ordered_m = self._lowest_down_m - down_m, commanded_m - self._lowest_commanded_m
        quick = rise_m >= CLIMB_M and rise_m - self._misled_m(self._lately[0][0]) >= CLIMB_M
        return quick or risen_m >= (CLIMB_M if ordered_m >= CLIMB_M else WANDER_M)

    def _misled_m(self, since_s: float) -> float:
        """How far the app rose since then because the receiver misled it."""
        meanwhile = [s for s in self._samples if s.time_s >= since_s]
        receiver = [s.receiver_low_m for s in self._samples if s.time_s >= since_s - FOLLOWS_S]
        behind_m = meanwhile[-1].believed_low_m - meanwhile[0].believed_low_m
        return max(0.0, min(behind_m, max(receiver) - min(receiver)))

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
