"""A clock at the other end of a line with delays: stamped samples and answers to TIMESYNC, heard in order."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.link.timesync import BootClock, Instant, TimeSync

Delay = Callable[[float], float]
IMU_S = 0.005
SYNC_S = 0.1


@dataclass(frozen=True)
class StampedSample:
    """One sample: when it was measured (our clock), its stamp, when it was heard, what was made of it."""

    measured_s: float
    stamp_s: float
    heard_s: float
    instant: Instant | None

    @property
    def error_s(self) -> float:
        """By how much its time is late."""
        return math.nan if self.instant is None else self.instant.time_s - self.measured_s


@dataclass
class FarClock:
    """`theirs` turns our time into the other clock's, NaN while that is off.

    What is sent at t arrives `there` or `back` later.
    """

    theirs: Callable[[float], float]
    there: Delay = lambda _: 0.001
    back: Delay = lambda _: 0.001
    heard: list[StampedSample] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.timesync = TimeSync()
        self.clock = BootClock(self.timesync)

    def run(self, until_s: float) -> list[StampedSample]:
        """Samples at 200 Hz and questions at 10 Hz from 0 on; what has become of the samples."""
        arrivals: list[tuple[float, float, int]] = []  # heard, told, question's ts1 or 0 for a sample
        arrivals += [(0.0, k * IMU_S, 0) for k in range(round(until_s / IMU_S))]
        arrivals = [(t + self.back(t), t, 0) for _, t, _ in arrivals]
        for k in range(1, round(until_s / SYNC_S)):
            asked_s = k * SYNC_S
            ts1_ns = round(asked_s * 1e9)
            told_s = asked_s + self.there(asked_s)
            arrivals.append((told_s + self.back(told_s), told_s, ts1_ns))
        asked: set[int] = set()
        floor_s = 0.0
        for _, told_s, ts1_ns in sorted(arrivals, key=lambda arrival: arrival[1]):
            # a line keeps the order: what comes behind something late is late as well
            floor_s = max(floor_s, told_s + self.back(told_s))
            self._ask_up_to(floor_s, asked)
            if math.isnan(self.theirs(told_s)):
                continue
            if ts1_ns:
                self.timesync.answered(round(self.theirs(told_s) * 1e9), ts1_ns, floor_s)
            else:
                stamp_s = self.theirs(told_s)
                self.heard.append(
                    StampedSample(told_s, stamp_s, floor_s, self.clock.instant("imu", stamp_s, floor_s))
                )
        return self.heard

    def _ask_up_to(self, now_s: float, asked: set[int]) -> None:
        for k in range(len(asked) + 1, math.floor(now_s / SYNC_S + 1e-9) + 1):
            asked.add(self.timesync.ask(k * SYNC_S))


def usable(heard: list[StampedSample], from_s: float = 1.0) -> list[StampedSample]:
    """The samples of a clock that has had the time to settle."""
    return [sample for sample in heard if sample.measured_s >= from_s]
