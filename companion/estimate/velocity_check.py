"""Judges our horizontal velocity by two others: the GPS receiver's and that of the autopilot's own filter.

An IMU whose board turns on the airframe in flight leads our velocity away by 3 m/s each second (20 deg), and
fixes that contradict it are refused as a receiver's error at first. The attitude follows seconds later, by
what the fixes say. The other two velocities show it within about one second.

Ours is in doubt where both others contradict it, in each report of the last 0.6 s: with one of them wrong, or
for a moment, two of three agree. Where no fix corrects them both filters err alike, so that the autopilot's
is taken to be as uncertain as ours. NED, m/s.
"""

import math
from collections import deque
from typing import Final, NamedTuple

from companion.base.geometry import Vector3
from companion.base.messages import Quantity, SourceComparison

REPORTS: Final = 4  # at 5 Hz; an ArduPilot that has lost its velocity sends zero until it says so, at 2 Hz
FRESH_S: Final = 1.0  # of a report, and of a fix
# of theirs beyond the filters' own: its stamp is off by 0.1 s in a manoeuvre of 3 m/s²
OTHER_VELOCITY_STD_M_S: Final = 0.3


class _Report(NamedTuple):
    time_s: float
    ours: Vector3
    theirs: Vector3
    apart_m_s: float  # from ours: the autopilot's, or the receiver's if that is nearer
    std_m_s: float


class VelocityCheck:
    """Feed it every fix, and every report of the autopilot; `comparisons` is what they say."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin again: ours has."""
        self._reports: deque[_Report] = deque(maxlen=REPORTS)
        self._fix_s, self._fix_apart_m_s = -math.inf, math.inf

    def take_fix(self, time_s: float, ours: Vector3, receivers: Vector3) -> None:
        """Take the receiver's velocity at a time, and ours as it was before that fix."""
        self._fix_s, self._fix_apart_m_s = time_s, _apart(ours, receivers)

    def take(self, time_s: float, ours: Vector3, theirs: Vector3, std_m_s: float) -> None:
        """Take the autopilot's at a time; `std_m_s`: of ours at that time, on an axis."""
        if self._reports and not 0.0 < time_s - self._reports[-1].time_s <= FRESH_S:
            self._reports.clear()
        apart_m_s = _apart(ours, theirs)
        if abs(time_s - self._fix_s) <= FRESH_S:
            apart_m_s = min(apart_m_s, self._fix_apart_m_s)
        std_m_s = math.hypot(std_m_s, std_m_s, OTHER_VELOCITY_STD_M_S)
        self._reports.append(_Report(time_s, ours, theirs, apart_m_s, std_m_s))

    def comparisons(self, now_s: float) -> tuple[SourceComparison, ...]:
        """Of the velocities (m/s); none without enough reports lately."""
        if len(self._reports) < REPORTS or now_s - self._reports[-1].time_s > FRESH_S:
            return ()
        least, newest = min(self._reports, key=lambda report: report.apart_m_s), self._reports[-1]
        ours, theirs = (f"north {v[0]:.1f}, east {v[1]:.1f} m/s" for v in (newest.ours, newest.theirs))
        return (
            SourceComparison(newest.time_s, Quantity.VELOCITY, ours, theirs, least.apart_m_s, least.std_m_s),
        )


def _apart(one: Vector3, other: Vector3) -> float:
    return math.hypot(one[0] - other[0], one[1] - other[1])
