"""Coming in over the pad: approach down a slope, then straight down inside a cone.

The guide's frame is the pad's: vehicle minus pad, NED axes, m and s; heights of targets count from the
vehicle's reference point. Descent stops, and the way is kept, while the pad is unseen or the vehicle is
outside the cone.
"""

from __future__ import annotations

import math

from companion.config import LandingConfig, VehicleConfig
from companion.plan.guidance import Guide
from companion.plan.min_jerk import Motion
from companion.plan.mission import Event
from companion.plan.sight import Sight
from companion.plan.touchdown import Finding

_CENTRED_MARGIN_M = 0.7
_CENTRED_SPEED_M_S = 0.6
_LOW_MARGIN_M = 0.08
# Once outside the cone the vehicle has to come back this far inside before it goes on down.
_BACK_INSIDE = 0.8
_FLOOR_M = 0.15


class Landing:
    """Approach and descent; `begin` at each approach, `pause_ends` at each descent."""

    def __init__(self, config: LandingConfig, vehicle: VehicleConfig, guide: Guide) -> None:
        self._config, self._guide = config, guide
        self._leg_m = vehicle.leg_height_m
        self.goal_m = self._leg_m + config.approach_height_m
        self.paused = False
        self._begun_s = 0.0

    def begin(self, height_m: float, again: bool, now_s: float) -> None:
        """Start an approach from a height; `again` after a failed touchdown: only as high as that needs.

        A first approach never climbs.
        """
        c = self._config
        first_m = min(height_m, self._leg_m + c.approach_height_m)
        self.goal_m = self._leg_m + c.retry_height_m if again else first_m
        self.paused = False
        self._begun_s = now_s

    def approach(self, sight: Sight | None, now_s: float) -> Finding:
        """Towards the point above the pad, down a slope that keeps the pad in view."""
        if sight is None or min(sight.age_s, now_s - self._begun_s) > self._config.lost_unseen_s:
            return self._lost(sight)
        seen = sight.age_s <= self._config.pause_unseen_s
        self._go(self._slope_m(sight, now_s) if seen else max(self.goal_m, self._level(now_s)), now_s)
        near = abs(sight.height_m - self.goal_m) <= min(_CENTRED_MARGIN_M, 0.25 * self.goal_m)
        if seen and near and self._inside(sight) and sight.lateral_speed_m_s <= _CENTRED_SPEED_M_S:
            return Event.CENTRED, f"{sight.height_m:.1f} m above the pad"
        return None

    def _slope_m(self, sight: Sight, now_s: float) -> float:
        """The height to fly at: on the slope, never above the present one unless the goal is."""
        x, y, z = self._guide.at(now_s).position_m
        aside_m = max(math.hypot(x, y), sight.lateral_m)
        return max(self.goal_m, min(-z, aside_m / self._config.approach_slope))

    def descend(self, sight: Sight | None, now_s: float) -> Finding:
        """Straight down to where touchdown starts, only while inside the cone and seeing the pad."""
        if sight is None or sight.age_s > self._config.lost_unseen_s:
            return self._lost(sight)
        wait_m = self._leg_m + self._config.wait_height_m
        seen = sight.age_s <= self._config.pause_unseen_s
        go_on = seen and self._inside(sight, _BACK_INSIDE if self.paused else 1.0)
        if go_on:
            self._go(wait_m, now_s)
        elif not self.paused:
            self._guide.rest(self._guide.at(now_s), now_s)  # and stays at rest over the pad
        self.paused = not go_on
        if seen and sight.height_m <= wait_m + _LOW_MARGIN_M:
            return Event.LOW, f"{100.0 * (sight.height_m - self._leg_m):.0f} cm over the pad"
        return None

    def minimum_height_m(self, now_s: float) -> float:
        """What the controller may not go below; never above where the reference is."""
        return max(0.0, min(self._leg_m + _FLOOR_M, -self._guide.at(now_s).position_m[2] - 0.05))

    def _go(self, height_m: float, now_s: float) -> None:
        self._guide.fly_to(Motion((0.0, 0.0, -height_m)), now_s)

    def _level(self, now_s: float) -> float:
        """The height at which the reference can come to a stop."""
        now = self._guide.at(now_s)
        sink = max(0.0, now.velocity_m_s[2])
        return -now.position_m[2] - 0.5 * sink

    def _inside(self, sight: Sight, share: float = 1.0) -> bool:
        above_m = max(0.0, sight.height_m - self._leg_m)
        return sight.lateral_m <= share * max(self._config.cone_floor_m, self._config.cone_slope * above_m)

    def _lost(self, sight: Sight | None) -> Finding:
        if sight is None:
            return Event.PAD_LOST, "nothing is known of the pad"
        return Event.PAD_LOST, f"not seen for {sight.age_s:.1f} s"
