"""A hold by the app's own setpoints: the vehicle comes to rest; just over the pad it first climbs clear.

The pad may move or heave beneath a vehicle that stays low. Once the vehicle is at rest and clear, the
autopilot's own hold takes over. If the EKF's position steps, the held position steps with it, so that the
vehicle stays where it is. EKF's NED; m, s.
"""

import math
from typing import Final

from companion.base.geometry import Vector3, norm, subtract, yaw_from_quat
from companion.base.messages import VehicleState
from companion.base.motion import Motion
from companion.config import PlanConfig
from companion.plan.events import NOTICE_THRESHOLD_M, DetectedEvent, MissionEvent
from companion.plan.landing.relative_state import vehicle_motion
from companion.plan.mission.shared import Shared

# At rest (m, m/s), as far as gusts let it be: what the autopilot's hold takes over without a swing.
_AT_REST: Final = 0.3


class Hold:
    """Steers the reference to rest; `begin` at each hold, `step` in each of its cycles."""

    def __init__(self, config: PlanConfig, leg_m: float, shared: Shared) -> None:
        self._clear_m = leg_m + config.landing.retry_height_m
        self._ceiling_m = config.mission.ceiling_m
        self._generator, self._pad = shared.generator, shared.pad
        self._ground, self._say = shared.ground, shared.say
        self._held: tuple[Vector3, bool] | None = None  # the place, and whether it climbs there

    def stand_still(self, vehicle: VehicleState, now_s: float) -> None:
        """Come to rest, from the reference's own motion when there is one."""
        if not self._generator.active:
            self._generator.heading_rad = yaw_from_quat(vehicle.attitude)
            self._generator.start("local", vehicle_motion(vehicle), now_s)
            return
        if self._pad.motion is not None:
            self._generator.change_frame("local", self._pad.motion, now_s)
        self._generator.rest(self._generator.at(now_s), now_s)

    def begin(self, vehicle: VehicleState, now_s: float, *, over_pad: bool) -> tuple[Vector3, bool]:
        """Come to rest, from just `over_pad` by a climb first; returns where, and whether it climbs."""
        climb_m = self._climb_m() if over_pad else 0.0
        self.stand_still(vehicle, now_s)
        x, y, z = self._generator.resting_place_m()
        climbs = climb_m > NOTICE_THRESHOLD_M
        self._held = held = (x, y, z - climb_m if climbs else z), climbs
        if climbs:
            self._say("climb", f"climbing {climb_m:.1f} m clear of the pad", now_s, "warning")
        return held

    def end(self) -> None:
        self._held = None

    def step(
        self, vehicle: VehicleState | None, step_m: Vector3 | None, now_s: float
    ) -> DetectedEvent | None:
        """Go on; detects that the vehicle is at rest where it holds. `step_m`: of the EKF's position."""
        if vehicle is None or not self._generator.active:
            return None
        # what has not begun yet has left the pad first
        place, climbs = self._held or self.begin(vehicle, now_s, over_pad=True)
        actual = vehicle_motion(vehicle)
        if step_m is not None and self._generator.keep_near(actual, now_s) > 0.0:
            # at rest from here, as high as was meant
            x, y, z = self._generator.resting_place_m()
            self._say("strayed", f"position reset by {norm(step_m):.1f} m: holding here", now_s, "warning")
            place = (x, y, place[2] + step_m[2] if climbs else z)
            self._held = place, climbs
        if climbs:
            # the climb by itself: to come to rest from a pad that drove fast takes longer
            self._generator.fly_level(Motion(place), place[2], now_s)
        near = norm(subtract(actual.position_m, place)) <= _AT_REST
        if near and norm(actual.velocity_m_s) <= _AT_REST:
            return MissionEvent.CLEAR, "clear of the pad, at rest" if climbs else "at rest"
        return None

    def _climb_m(self) -> float:
        """How far (m) up it is clear of the pad; never beyond the ceiling."""
        # a pad that is unseen for long is not believed to be above
        height_m = max(0.0, self._pad.sight.height_m) if self._pad.sight is not None else math.inf
        over_home_m = self._ground.over_home_m
        room_m = math.inf if over_home_m is None else self._ceiling_m - over_home_m
        return max(0.0, min(self._clear_m - height_m, room_m))
