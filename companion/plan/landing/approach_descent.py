"""Approach down a slope to above the pad, then descent inside a cone.

The reference's frame is the pad's: vehicle minus pad, NED axes, m and s; heights of targets count from the
vehicle's reference point. Descent stops while the vehicle is outside the cone. While the pad is unseen the
reference is in the EKF's NED: over the pad's predicted place, but at a height that does not depend on it,
since the prediction of a height from few sightings sinks or rises without end.
"""

from __future__ import annotations

import math

from companion.base.messages import DescentCone, PadState
from companion.base.motion import Motion
from companion.config import LandingConfig, VehicleConfig
from companion.plan.events import NOTICE_THRESHOLD_M, Announcements, DetectedEvent, MissionEvent
from companion.plan.landing.relative_state import PadTrack
from companion.plan.trajectory.reference_generator import ReferenceGenerator

# At the height of the goal, and slow enough to stay in the cone: the descent corrects the rest on the way.
_CENTRED_MARGIN_M = 0.7
_CENTRED_SPEED_M_S = 0.6
# Over the height at which it waits; in gusts it hovers within that of it.
_LOW_MARGIN_M = 0.08
# Once outside the cone the vehicle comes back this far inside before it descends again.
_BACK_INSIDE = 0.8
# The controller climbs to keep in the cone what will be outside it so soon; from so much on it is told.
_CHASES_S = 0.3
_CHASED_M = 0.5
_FLOOR_M = 0.15  # over where it would stand: a pad that heaves does not reach the feet in the descent


class ApproachDescent:
    """One approach and its descent; `lowest_down_m` is a floor (EKF's NED) while the pad is unseen."""

    def __init__(
        self,
        config: LandingConfig,
        vehicle: VehicleConfig,
        generator: ReferenceGenerator,
        say: Announcements,
        height_m: float,
        now_s: float,
        *,
        again: bool = False,
    ) -> None:
        """Start from a height; `again` after a failed touchdown: only as high as that needs.

        A first approach never climbs.
        """
        self._config, self._generator, self._say = config, generator, say
        self._leg_m, self._begun_s = vehicle.leg_height_m, now_s
        # where the controller is to keep a descent: a little wider than where the plan stops going down
        self.cone = DescentCone(config.cone_slope, config.cone_floor_m, self._leg_m)
        first_m = min(height_m, self._leg_m + config.approach_height_m)
        self.goal_m = self._leg_m + config.retry_height_m if again else first_m
        self._blind_down_m = math.inf
        self._paused = self._chasing = False

    def step(
        self, pad: PadTrack, likely: Motion, lowest_down_m: float, now_s: float, *, descends: bool
    ) -> DetectedEvent | None:
        """A cycle of the approach or of the descent: by the pad while it is in view."""
        c, sight = self._config, pad.sight
        if sight is None or pad.motion is None:
            return MissionEvent.PAD_LOST, "no estimate of the pad"
        if min(sight.age_s, now_s - self._begun_s) > c.lost_unseen_s:
            return MissionEvent.PAD_LOST, f"not seen for {sight.age_s:.1f} s"
        if sight.age_s > c.pause_unseen_s:
            self._paused = True
            self._fly_blind(pad.motion, 0.0 if descends else self.goal_m, likely, lowest_down_m, now_s)
            return None
        self._generator.change_frame("pad", pad.motion, now_s)
        return self._descend(sight, now_s) if descends else self._approach(sight, now_s)

    def _approach(self, sight: PadState, now_s: float) -> DetectedEvent | None:
        """Towards the point above the pad, down a slope that keeps the pad in view."""
        self._paused = False
        self._go(self._slope_m(sight, now_s), now_s)
        near = abs(sight.height_m - self.goal_m) <= min(_CENTRED_MARGIN_M, 0.25 * self.goal_m)
        if near and self._inside(sight) and sight.lateral_speed_m_s <= _CENTRED_SPEED_M_S:
            return MissionEvent.CENTRED, f"{sight.height_m:.1f} m above the pad"
        return None

    def _slope_m(self, sight: PadState, now_s: float) -> float:
        """The height to fly at: on the slope, never above the present one unless the goal is."""
        x, y, z = self._generator.at(now_s).position_m
        aside_m = max(math.hypot(x, y), sight.lateral_m)
        return max(self.goal_m, min(-z, aside_m / self._config.approach_slope))

    def _descend(self, sight: PadState, now_s: float) -> DetectedEvent | None:
        """Straight down to where touchdown starts, only inside the cone."""
        wait_m = self._leg_m + self._config.wait_height_m
        self._paused = not self._inside(sight, _BACK_INSIDE if self._paused else 1.0)
        if self._paused:
            self._generator.fly_level(Motion((0.0, 0.0, -sight.height_m)), math.inf, now_s)
        else:
            self._go(wait_m, now_s)
        self._chase(sight, now_s)
        if sight.height_m <= wait_m + _LOW_MARGIN_M:
            return MissionEvent.LOW, f"{100.0 * (sight.height_m - self._leg_m):.0f} cm over the pad"
        return None

    def minimum_height_m(self, now_s: float) -> float:
        """What the controller may not go below; never above where the reference is."""
        return max(0.0, min(self._leg_m + _FLOOR_M, -self._generator.at(now_s).position_m[2] - 0.05))

    def _fly_blind(
        self, pad: Motion, goal_m: float, likely: Motion, lowest_down_m: float, now_s: float
    ) -> None:
        """On level over the pad's likely place.

        A climb to goal_m that was under way is completed, to the height that the last sighting gave.
        """
        if self._generator.origin == "pad":
            self._generator.change_frame("local", pad, now_s)
            # the goal, if that is higher than here, by no more than a retry climbs
            here_m = self._generator.at(now_s).position_m[2]
            self._blind_down_m = max(pad.position_m[2] - goal_m, here_m - self._config.retry_height_m)
            if here_m - self._blind_down_m > NOTICE_THRESHOLD_M:
                self._generator.rise(now_s)  # at once: how far below the unseen pad is, is soon a guess
        climb_m = self._generator.fly_level(likely, min(lowest_down_m, self._blind_down_m), now_s)
        if climb_m > NOTICE_THRESHOLD_M:
            self._say("climb", f"climbing {climb_m:.1f} m while the pad is unseen", now_s, "warning")

    def _chase(self, sight: PadState, now_s: float) -> None:
        """Say that a climb after a pad that gets away begins: the controller keeps the cone."""
        (x, y, _), (vx, vy, _) = sight.relative_position_ned_m, sight.relative_velocity_ned_m_s
        soon_m = math.hypot(x + _CHASES_S * vx, y + _CHASES_S * vy)
        cone = self.cone
        # what is outside already comes back in without a climb
        here_m = max(cone.radius_m + cone.slope * (sight.height_m - cone.apex_height_m), sight.lateral_m)
        climb_m = (soon_m - here_m) / cone.slope
        if climb_m > _CHASED_M and not self._chasing:
            words = f"climbing to keep the pad in view, {soon_m:.1f} m aside"
            self._say("climb", words, now_s, "warning")
        self._chasing = climb_m > _CHASED_M or (self._chasing and self._paused)

    def _go(self, height_m: float, now_s: float) -> None:
        self._generator.fly_to(Motion((0.0, 0.0, -height_m)), now_s)

    def _inside(self, sight: PadState, share: float = 1.0) -> bool:
        above_m = max(0.0, sight.height_m - self._leg_m)
        return sight.lateral_m <= share * max(self._config.cone_floor_m, self._config.cone_slope * above_m)
