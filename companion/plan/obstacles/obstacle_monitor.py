"""Places the surveyed obstacles in the EKF's frame, and announces what concerns them.

Obstacles are surveyed from the take-off place. The app's own estimate at take-off gives this place in the
EKF's NED (m): two GPS receivers disagree by metres, while one receiver drifts little during a flight.
"""

import math
from typing import Final

from companion.base.geometry import Vector3, add
from companion.base.messages import VehicleState
from companion.plan.landing.height_above_ground import HeightAboveGround
from companion.plan.landing.relative_state import PadTrack
from companion.plan.notices import NoticeSink
from companion.plan.obstacles.avoidance import Avoidance
from companion.plan.trajectory.reference_generator import ReferenceGenerator

_TELL_AGAIN_S: Final = 2.0
_WORDS: Final = {
    "blocked": "no clear path past the obstacles: holding",
    "waiting_over": "pad too near to an obstacle: waiting over it",
    "detour": "obstacle ahead: flying round it",
    "clear": "clear of the obstacles again",
}


class ObstacleMonitor:
    """Home's position among the obstacles, and the notices about them."""

    def __init__(self, generator: ReferenceGenerator, ground: HeightAboveGround, say: NoticeSink) -> None:
        self._generator, self._ground, self._say = generator, ground, say
        self._stood_ned_m: Vector3 | None = None
        self._reported_way, self._reported_s = "clear", -math.inf
        self.home_ned_m: Vector3 | None = None

    def stands_here(self, vehicle: VehicleState | None) -> None:
        """Remember where the vehicle stands: it is about to take off."""
        self._stood_ned_m = None if vehicle is None else vehicle.position_ned_m

    def update(self, pad: PadTrack) -> None:
        """Take in where home and the pad are now; home's height is that over which the vehicle flies."""
        down_m = self._ground.home_down_m
        if self._stood_ned_m is not None and down_m is not None:
            self.home_ned_m = (*self._stood_ned_m[:2], down_m)
        self._generator.see(self.home_ned_m, pad.motion)

    @property
    def lost(self) -> bool:
        """Whether obstacles are known, but not where they are: none of them would be kept clear of."""
        return self._generator.avoidance.any and self.home_ned_m is None

    def straight_clear(self, here_ned_m: Vector3, goal_from_home_m: Vector3) -> bool:
        """Whether a straight line to a place that counts from home keeps clear."""
        home = self.home_ned_m
        return home is None or self._generator.avoidance.straight_clear(
            here_ned_m, add(goal_from_home_m, home)
        )

    def tell(self, now_s: float) -> None:
        """Announce a detour, that there is none, and when the path is straight again."""
        way = _way(self._generator.avoidance)
        if way == self._reported_way or now_s - self._reported_s < _TELL_AGAIN_S:
            return
        self._say(way, _WORDS[way], now_s, "warning" if way in {"blocked", "waiting_over"} else "info")
        self._reported_way, self._reported_s = way, now_s


def _way(avoidance: Avoidance) -> str:
    if avoidance.blocked:
        return "blocked"
    if avoidance.waiting:
        return "waiting_over"
    return "detour" if avoidance.detouring else "clear"
