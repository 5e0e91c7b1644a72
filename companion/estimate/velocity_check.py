"""Compares our horizontal velocity with the autopilot's: two filters with an IMU each, on one airframe.

An IMU whose board turns on the airframe in flight leads our velocity away by 3 m/s each second (20 deg), and
fixes that contradict it are refused as a receiver's error at first. The attitude follows seconds later, by
what the fixes say. The autopilot's velocity shows it within one second.

Both err alike where no fix corrects them, so that theirs is taken to be as uncertain as ours. NED, m/s.
"""

import math
from typing import Final

from companion.base.geometry import Vector3, subtract
from companion.base.messages import Quantity, SourceComparison

TIME_CONSTANT_S: Final = 0.3
FORGET_S: Final = 2.0  # without a report
# of theirs beyond the filters' own: its stamp is off by 0.1 s in a manoeuvre of 3 m/s²
OTHER_VELOCITY_STD_M_S: Final = 0.3


class VelocityCheck:
    """Feed it every report of the autopilot; `comparisons` is what they say."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin again: ours has."""
        self._last_s = -math.inf
        self._north_m_s = self._east_m_s = self._std_m_s = 0.0  # ours less theirs
        self._figures: tuple[Vector3, Vector3] | None = None

    def take(self, time_s: float, ours: Vector3, theirs: Vector3, std_m_s: float) -> None:
        """Take a report of a time; `std_m_s`: of ours at that time, on an axis."""
        elapsed_s = time_s - self._last_s
        if elapsed_s <= 0.0:
            return
        share = -math.expm1(-elapsed_s / TIME_CONSTANT_S) if elapsed_s <= FORGET_S else 1.0
        north, east, _ = subtract(ours, theirs)
        self._north_m_s += share * (north - self._north_m_s)
        self._east_m_s += share * (east - self._east_m_s)
        self._std_m_s = math.hypot(std_m_s, std_m_s, OTHER_VELOCITY_STD_M_S)
        self._last_s, self._figures = time_s, (ours, theirs)

    def comparisons(self, now_s: float) -> tuple[SourceComparison, ...]:
        """Of the velocities (m/s); none where no report has come lately."""
        if self._figures is None or now_s - self._last_s > FORGET_S:
            return ()
        ours, theirs = (f"north {v[0]:.1f}, east {v[1]:.1f} m/s" for v in self._figures)
        difference = math.hypot(self._north_m_s, self._east_m_s)
        return (SourceComparison(self._last_s, Quantity.VELOCITY, ours, theirs, difference, self._std_m_s),)
