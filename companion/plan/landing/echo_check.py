"""Whether the rangefinder's near echoes follow the vehicle's own way up and down, as two others tell it.

A transducer with ice or a leaf on it gives the same few centimetres for ever: taken for the ground, they kept
the vehicle up for good. What stands below gives echoes that grow as the vehicle climbs. m, s; up is positive.
"""

from __future__ import annotations

import math
from typing import Final

from companion.base.messages import RangeSample
from companion.plan.landing.height_above_ground import NEAR_ECHO_M

# The others have moved so far, and alike, within so long, and the echo has not: nothing is there.
_MOVED_M: Final = 0.5
_ALIKE_M: Final = 0.3
_WITHIN_S: Final = 5.0
_STILL_M: Final = 0.1


class EchoCheck:
    """Call `update` in every cycle in which the vehicle does not go by a pad that may heave below it."""

    def __init__(self) -> None:
        self.stuck = False
        self._heard_s = -math.inf
        self._from: tuple[float, float, float, float] | None = None

    def pause(self) -> None:
        """A cycle that tells nothing: what comes after it is not compared with what was before."""
        self._from = None

    def update(
        self, echo: RangeSample | None, ours_m: float | None, theirs_m: float | None, now_s: float
    ) -> bool:
        """Take in a cycle; whether the echo is found to be stuck in it.

        `ours_m`, `theirs_m`: the vehicle's height by our estimate and by the autopilot, from anywhere.
        """
        if echo is None or echo.time_s <= self._heard_s or ours_m is None or theirs_m is None:
            return False  # the last echo, of where it was then, contradicts nothing
        self._heard_s = echo.time_s
        if self._from is not None and now_s - self._from[0] > _WITHIN_S:
            self._from = None
        echo_m = echo.distance_m
        start = self._from or (now_s, echo_m, ours_m, theirs_m)
        moved_m, ours_moved_m, theirs_moved_m = echo_m - start[1], ours_m - start[2], theirs_m - start[3]
        # farther echoes keep nothing up (see `HeightAboveGround.above`)
        if abs(moved_m) > _STILL_M or echo_m > NEAR_ECHO_M:
            self.stuck, self._from = False, (now_s, echo_m, ours_m, theirs_m)
            return False
        alike = abs(ours_moved_m - theirs_moved_m) <= _ALIKE_M
        found = alike and min(abs(ours_moved_m), abs(theirs_moved_m)) >= _MOVED_M and not self.stuck
        self.stuck = self.stuck or found
        self._from = start
        return found
