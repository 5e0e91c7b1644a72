"""What stands around, for the phases: where obstacles count from, and what is told of them.

Obstacles were measured from where the vehicle takes off. Where that is in the EKF's NED (m) our own estimate
says, from the moment of the take-off: two GPS receivers disagree by metres, one over a flight by little.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Literal

from companion.base.geometry import Vector3, add
from companion.base.messages import VehicleState
from companion.plan.landing.ground_contact import Ground
from companion.plan.landing.relative_state import PadKnowledge
from companion.plan.obstacles.avoidance import Avoidance
from companion.plan.trajectory.guidance import Guide

_TELL_AGAIN_S: Final = 2.0
_WORDS: Final = {
    "blocked": "no way that keeps clear of the obstacles: holding",
    "waiting_over": "the pad is too near to an obstacle: waiting over it",
    "detour": "an obstacle is in the way: flying round it",
    "clear": "clear of the obstacles again",
}

Severity = Literal["info", "warning", "error"]
Say = Callable[[str, str, float, Severity], None]


class Surroundings:
    """Home's place among the obstacles, and the words about them."""

    def __init__(self, guide: Guide, ground: Ground, say: Say) -> None:
        self._guide, self._ground, self._say = guide, ground, say
        self._stood_ned_m: Vector3 | None = None
        self._told_of, self._told_s = "clear", -math.inf
        self.home_ned_m: Vector3 | None = None

    def stands_here(self, vehicle: VehicleState | None) -> None:
        """Remember where the vehicle stands: it is about to take off."""
        self._stood_ned_m = None if vehicle is None else vehicle.position_ned_m

    def update(self, pad: PadKnowledge) -> None:
        """Take in where home and the pad are now; home's height is that over which the vehicle flies."""
        down_m = self._ground.home_down_m
        if self._stood_ned_m is not None and down_m is not None:
            self.home_ned_m = (*self._stood_ned_m[:2], down_m)
        self._guide.see(self.home_ned_m, pad.motion)

    @property
    def lost(self) -> bool:
        """Whether obstacles are known, but not where they are: none of them would be kept clear of."""
        return self._guide.avoidance.any and self.home_ned_m is None

    def straight_clear(self, here_ned_m: Vector3, goal_from_home_m: Vector3) -> bool:
        """Whether a straight line to a place that counts from home keeps clear."""
        home = self.home_ned_m
        return home is None or self._guide.avoidance.straight_clear(here_ned_m, add(goal_from_home_m, home))

    def tell(self, now_s: float) -> None:
        """Say when the way leads round obstacles, when there is none, and when it is straight again."""
        way = _way(self._guide.avoidance)
        if way == self._told_of or now_s - self._told_s < _TELL_AGAIN_S:
            return
        self._say(way, _WORDS[way], now_s, "warning" if way in {"blocked", "waiting_over"} else "info")
        self._told_of, self._told_s = way, now_s


def _way(avoidance: Avoidance) -> str:
    if avoidance.blocked:
        return "blocked"
    if avoidance.waiting:
        return "waiting_over"
    return "detour" if avoidance.detouring else "clear"
