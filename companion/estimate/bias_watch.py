"""Has the gyroscope's bias stepped? What a filter that has long been sure of its bias would not ask.

A step of 2 deg/s (a shock, a supply that sags) turns the attitude away faster than slow, sceptical
corrections mend it. It shows in two ways:

- heading: the field drifts against the prediction while the vehicle hardly turns. A magnet passing makes
  a jump, and iron on board a change only as the vehicle turns: neither counts.
- tilt: the velocity of fix after fix differs from the prediction by more than its noise.

Immutable: a filter keeps one in its snapshots and replaces it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.geometry import Quaternion

WINDOW_S: Final = 2.0
MEAN_SHARE: Final = 0.2  # of a new field in its fading mean: some 5 samples
DRIFT_UT: Final = 0.7  # over the window: 2 degrees of heading in Europe, 1.3 at the equator
JUMP_UT: Final = 0.5  # between two entries of the history, 0.1 s apart
ENTRY_S: Final = 0.1
TURN_RAD: Final = math.radians(
    25.0
)  # turned further within the window, a drift may be the vehicle's own iron
FIX_SHARE: Final = 0.35  # of a new fix in the fading mean
FIX_BOUND: Final = 3.0  # normalised innovation squared a degree of freedom; 1 when all is well


class BiasWatch(NamedTuple):
    """What was seen lately. `history` holds (time, field across the heading in µT, attitude), oldest first."""

    field_ut: float = 0.0
    history: tuple[tuple[float, float, Quaternion], ...] = ()
    fix_excess: float = 1.0

    def after_field(self, time_s: float, across_ut: float, attitude: Quaternion) -> BiasWatch:
        """The watch with one more innovation of the field, square to it and level (µT)."""
        mean = self.field_ut + MEAN_SHARE * (across_ut - self.field_ut)
        if self.history and time_s - self.history[-1][0] < ENTRY_S:
            return self._replace(field_ut=mean)
        if self.history and (
            abs(mean - self.history[-1][1]) > JUMP_UT or time_s - self.history[-1][0] > 5 * ENTRY_S
        ):
            # begin anew behind a jump or a gap
            return self._replace(field_ut=across_ut, history=())
        recent = tuple(entry for entry in self.history if time_s - entry[0] <= WINDOW_S + 0.5 * ENTRY_S)
        return self._replace(field_ut=mean, history=(*recent, (time_s, mean, attitude)))

    def after_fix(self, normalised_innovation_squared: float) -> BiasWatch:
        """The watch with one more test of a fix's velocity, a degree of freedom; a wild one counts as 10."""
        bounded = min(normalised_innovation_squared, 10.0)
        return self._replace(fix_excess=self.fix_excess + FIX_SHARE * (bounded - self.fix_excess))

    @property
    def heading_drifts(self) -> bool:
        """Whether the field has drifted over the window while the vehicle hardly turned."""
        if len(self.history) < 2 or self.history[-1][0] - self.history[0][0] < 0.5 * WINDOW_S:
            return False
        (_, before_ut, before), (_, now_ut, now) = self.history[0], self.history[-1]
        if abs(now_ut - before_ut) < DRIFT_UT:
            return False
        cosine = abs(sum(a * b for a, b in zip(before, now, strict=True)))
        return 2.0 * math.acos(min(cosine, 1.0)) < TURN_RAD

    @property
    def velocity_drifts(self) -> bool:
        """Whether fix after fix has disagreed with the predicted velocity."""
        return self.fix_excess > FIX_BOUND
