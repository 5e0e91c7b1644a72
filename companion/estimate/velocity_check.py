"""Compares our horizontal velocity with two others: the GPS receiver's and that of the autopilot's filter.

If the IMU's board turns by 20 deg in flight, our velocity drifts by 3 m/s each second. Fixes that contradict
it are refused as outliers at first, and the attitude check follows only seconds later.

Ours is disputed if both other velocities contradict it in each report of 0.6 s: with one of them wrong, or
for a moment, two of three agree. Without fixes both filters drift alike, so the autopilot's gets our standard
deviation. NED, m/s.
"""

import math
from collections import deque
from typing import Final

from companion.base.geometry import Vector3
from companion.base.messages import Quantity, SourceComparison
from companion.estimate.vehicle.fix_watch import FRESH_S

REPORTS: Final = 4  # at 5 Hz; an ArduPilot that has lost its velocity sends zero until it says so, at 2 Hz
# of theirs beyond the filters' own: its stamp is off by 0.1 s in a manoeuvre of 3 m/s²
OTHER_VELOCITY_STD_M_S: Final = 0.3


class VelocityCheck:
    """Feed it every fix, and every report of the autopilot; `comparisons` is what they say."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin again: ours has."""
        self._reports: deque[SourceComparison] = deque(maxlen=REPORTS)
        self._fix: tuple[float, Vector3, Vector3] | None = None

    def take_fix(self, time_s: float, ours: Vector3, receivers: Vector3) -> None:
        """Take the receiver's velocity at a time, and ours as it was before that fix."""
        self._fix = time_s, ours, receivers

    def take(self, time_s: float, ours: Vector3, theirs: Vector3, std_m_s: float) -> None:
        """Take the autopilot's at a time; `std_m_s`: of ours at that time, on an axis."""
        if self._reports and not 0.0 < time_s - self._reports[-1].time_s <= FRESH_S:
            self._reports.clear()
        pairs = [(ours[:2], theirs[:2])]
        if self._fix is not None and abs(time_s - self._fix[0]) <= FRESH_S:
            pairs.append((self._fix[1][:2], self._fix[2][:2]))
        nearest = min(pairs, key=lambda pair: math.dist(*pair))
        first, second = (f"north {north:.1f}, east {east:.1f} m/s" for north, east in nearest)
        std_m_s = math.hypot(std_m_s, std_m_s, OTHER_VELOCITY_STD_M_S)
        self._reports.append(
            SourceComparison(time_s, Quantity.VELOCITY, first, second, math.dist(*nearest), std_m_s)
        )

    def comparisons(self, now_s: float) -> tuple[SourceComparison, ...]:
        """Of the velocities (m/s), by the report nearest to ours; none without enough of them lately."""
        if len(self._reports) < REPORTS or now_s - self._reports[-1].time_s > FRESH_S:
            return ()
        return (min(self._reports, key=lambda report: report.difference),)
