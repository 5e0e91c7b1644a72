"""The way through the waypoints that we fly ourselves: by minimum jerk, round the obstacles between them.

Waypoints are north and east of home (m), with a height over home where it is not the take-off's; what is
flown is in the EKF's NED. m, s.
"""

from __future__ import annotations

import math
from typing import Final

from companion.config import MissionConfig
from companion.geometry import Vector3, add, norm
from companion.plan.guidance import Guide
from companion.plan.min_jerk import Motion
from companion.plan.mission import Event
from companion.plan.touchdown import Finding

# The reference passes through a point exactly: this near to it, it has.
_PASSED_M: Final = 0.5


class Waypoints:
    """One flight through them: `begin`, then `step` every cycle. Steers the guide in the EKF's NED."""

    def __init__(self, config: MissionConfig, guide: Guide) -> None:
        self._config, self._guide = config, guide
        self._left: list[Vector3] = []
        self._last: Vector3 | None = None

    @property
    def first_from_home_m(self) -> Vector3:
        """The waypoint to which the autopilot would fly, NED from home."""
        return (*self._config.waypoint_ned_m, -self._config.take_off_height_m)

    @property
    def further(self) -> bool:
        """Whether there are more than the autopilot flies to."""
        return bool(self._config.waypoints_ned_m)

    def begin(self, *, with_first: bool) -> None:
        """Start over; `with_first` when the autopilot has not flown to the first."""
        self._left = [self.first_from_home_m] if with_first else []
        for north, east, *height in self._config.waypoints_ned_m:
            self._left.append((north, east, -(height[0] if height else self._config.take_off_height_m)))
        self._last = self._left[-1] if self._left else None

    def at_first(self, actual: Motion, home_ned_m: Vector3) -> Finding:
        """Whether the vehicle is at the first waypoint, slow; in the EKF's NED."""
        first, v = add(self.first_from_home_m, home_ned_m), actual.velocity_m_s
        distance_m = math.dist(actual.position_m[:2], first[:2])
        slow = math.hypot(v[0], v[1]) <= self._config.arrival_speed_m_s
        if distance_m <= self._config.arrival_radius_m and slow:
            return Event.ONWARD, f"{distance_m:.1f} m from the first waypoint"
        return None

    def step(self, actual: Motion, home_ned_m: Vector3, now_s: float) -> Finding:
        """One cycle with control ours; `actual` and home are in the EKF's NED."""
        if self._last is None:
            return Event.ARRIVED, "no further waypoints"
        reference = self._guide.at(now_s).position_m
        while self._left and math.dist(reference, add(self._left[0], home_ned_m)) <= _PASSED_M:
            self._left.pop(0)
        last = add(self._last, home_ned_m)
        self._guide.fly_along([*(add(p, home_ned_m) for p in self._left[:-1]), last], now_s)
        slow = norm(actual.velocity_m_s) <= self._config.arrival_speed_m_s
        distance_m = math.dist(actual.position_m, last)
        if not self._left and slow and distance_m <= self._config.arrival_radius_m:
            return Event.ARRIVED, f"{distance_m:.1f} m from the last waypoint"
        return None
