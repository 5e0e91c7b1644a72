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
from itertools import pairwise
from typing import Any, Final, NamedTuple

from companion.geometry import Quaternion

WINDOW_S: Final = 2.4
MEAN_SHARE: Final = 0.2  # of a new field in its fading mean: some 5 samples
DRIFT_UT: Final = 0.8  # over the window: 2.2 degrees of heading in Europe, 1.5 at the equator
STEADY_SHARE: Final = 0.1  # of the drift, in each quarter of the window
JUMP_UT: Final = 0.5  # between two entries of the history, 0.1 s apart
ENTRY_S: Final = 0.1
TURN_RAD: Final = math.radians(25.0)  # turned further, a drift may be the vehicle's own iron
FIX_SHARE: Final = 0.35  # of a new fix in the fading mean
FIX_BOUND: Final = 3.0  # normalised innovation squared a degree of freedom; 1 when all is well


class BiasWatch(NamedTuple):
    """What was seen lately. `history`: (time, field square to the heading in µT, attitude), oldest first.

    The field is taken against the gyroscope alone: what other sensors have turned the heading by since,
    `corrected_ut` of field, is taken out.
    """

    field_ut: float = 0.0
    corrected_ut: float = 0.0
    history: tuple[tuple[float, float, Quaternion], ...] = ()
    fix_excess: float = 1.0

    @classmethod
    def restored(cls, values: list[Any]) -> BiasWatch:
        """The watch from its fields as plain lists (JSON's)."""
        field_ut, corrected_ut, history, fix_excess = values
        return cls(field_ut, corrected_ut, tuple((t, ut, tuple(q)) for t, ut, q in history), fix_excess)

    def after_correction(self, turned_ut: float) -> BiasWatch:
        """The watch after an update has turned the heading by so much of field (µT)."""
        return self._replace(corrected_ut=self.corrected_ut + turned_ut)

    def after_field(self, time_s: float, across_ut: float, attitude: Quaternion) -> BiasWatch:
        """The watch with one more innovation of the field, square to it and level (µT)."""
        value = across_ut - self.corrected_ut
        mean = self.field_ut + MEAN_SHARE * (value - self.field_ut)
        if not self.history:
            return self._replace(field_ut=value, history=((time_s, value, attitude),))
        last_s, last_ut, _ = self.history[-1]
        if time_s - last_s < ENTRY_S:
            return self._replace(field_ut=mean)
        if abs(mean - last_ut) > JUMP_UT or time_s - last_s > 5 * ENTRY_S:
            # begin anew behind a jump or a gap
            return self._replace(field_ut=value, history=())
        recent = tuple(entry for entry in self.history if time_s - entry[0] <= WINDOW_S + 0.5 * ENTRY_S)
        return self._replace(field_ut=mean, history=(*recent, (time_s, mean, attitude)))

    def after_fix(self, normalised_innovation_squared: float) -> BiasWatch:
        """The watch with one more test of a fix's velocity, a degree of freedom; a wild one counts as 10."""
        bounded = min(normalised_innovation_squared, 10.0)
        return self._replace(fix_excess=self.fix_excess + FIX_SHARE * (bounded - self.fix_excess))

    @property
    def drift_ut(self) -> float | None:
        """How far the field has drifted over the window, if far, steadily and while the vehicle hardly turned."""
        history = self.history
        if len(history) < 5 or history[-1][0] - history[0][0] < 0.9 * WINDOW_S:
            return None
        drift = history[-1][1] - history[0][1]
        if abs(drift) < DRIFT_UT:
            return None
        marks = [history[round(0.25 * k * (len(history) - 1))][1] for k in range(5)]
        steps = [(after - before) / drift for before, after in pairwise(marks)]
        cosine = abs(sum(a * b for a, b in zip(history[0][2], history[-1][2], strict=True)))
        turned = 2.0 * math.acos(min(cosine, 1.0)) > TURN_RAD
        return None if turned or min(steps) < STEADY_SHARE else drift

    @property
    def velocity_drifts(self) -> bool:
        """Whether fix after fix has disagreed with the predicted velocity."""
        return self.fix_excess > FIX_BOUND
