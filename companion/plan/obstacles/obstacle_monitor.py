"""Announces what the surveyed obstacles make of the path."""

import math
from typing import Final

from companion.plan.events import NoticeSink
from companion.plan.obstacles.avoidance import Avoidance

_TELL_AGAIN_S: Final = 2.0
_WORDS: Final = {
    "blocked": "no clear path past the obstacles: holding",
    "waiting_over": "pad too near to an obstacle: waiting over it",
    "detour": "obstacle ahead: flying round it",
    "clear": "clear of the obstacles again",
}


class ObstacleMonitor:
    """The notices about the obstacles; call `tell` in every cycle."""

    def __init__(self, avoidance: Avoidance, say: NoticeSink) -> None:
        self._avoidance, self._say = avoidance, say
        self._reported, self._reported_s = "clear", -math.inf

    def tell(self, now_s: float) -> None:
        """Announce a detour, that there is none, and when the path is straight again."""
        way = self._avoidance.situation
        if way == self._reported or now_s - self._reported_s < _TELL_AGAIN_S:
            return
        self._say(way, _WORDS[way], now_s, "warning" if way in {"blocked", "waiting_over"} else "info")
        self._reported, self._reported_s = way, now_s
