"""Checks whether the attitude still fits the orientation pre-filter, by normalised innovations over a window.

The gate for a single innovation uses a large noise, since this noise is correlated for seconds: an attitude
that is wrong by 30 deg passes it every time. The innovations of a filter that fits are white, so their mean
over a window decreases with the square root of their number; those of a wrong filter do not. Whitened by
their own covariance, the mean's square is chi-square distributed.

If it does not fit, the attitude's covariance is increased by the difference of the two, and the next
measurements decide. If it still does not fit after that, the filter restarts from the pre-filter.
Immutable, so that a snapshot may hold it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from companion.base.geometry import ZERO3, Vector3, between, dot
from companion.estimate.gating import CHI_SQUARE_999

WINDOW_S: Final = 3.0  # and a doubt has so long to have its effect
_TROUBLES: Final = (
    "attitude uncertain: biased against the orientation filter",
    "attitude uncertain: velocity biased against GPS",
    "attitude reset to the orientation filter",
)
AGAIN_S: Final = 3.0 * WINDOW_S  # a misfit so soon after a doubt: the doubt has not cured it


class InnovationWatch(NamedTuple):
    """The fading mean of the whitened innovations, and when the attitude was doubted or started again."""

    mean: Vector3 = ZERO3
    variance: float = 0.0  # of an axis of the mean, when all is well
    innovations: int = 0
    since_s: float = math.inf
    last_s: float = -math.inf
    doubted_s: float = -math.inf
    restarted_s: float = -math.inf

    def after(self, time_s: float, whitened: Vector3) -> InnovationWatch:
        """With one innovation more."""
        number = self.innovations + 1
        share = max(1.0 / number, min((time_s - self.last_s) / WINDOW_S, 1.0))
        return self._replace(
            mean=between(self.mean, whitened, share),
            variance=(1.0 - share) ** 2 * self.variance + share**2,
            innovations=number,
            since_s=min(self.since_s, time_s),
            last_s=time_s,
        )

    @property
    def misfits(self) -> bool:
        """Whether a whole window keeps to one side by more than chance explains."""
        full = self.last_s - self.since_s >= WINDOW_S
        return full and dot(self.mean, self.mean) > CHI_SQUARE_999[3] * self.variance

    @property
    def doubted_lately(self) -> bool:
        """Whether the last doubt should have cured it by now."""
        return self.last_s - self.doubted_s < AGAIN_S

    def renewed(self) -> InnovationWatch:
        """With an empty window."""
        return InnovationWatch(doubted_s=self.doubted_s, restarted_s=self.restarted_s)


class TroubleReport:
    """Puts what the filter has done about its own misfit in words, each time once."""

    def __init__(self) -> None:
        self._reported_s = (-math.inf,) * len(_TROUBLES)

    def news(self, doubted_s: float, suspected_s: float, restarted_s: float) -> tuple[str, ...]:
        """What was not said before: when the attitude was last doubted by the pre-filter, suspected by the
        fixes, and reset."""
        happened_s = (doubted_s, suspected_s, restarted_s)
        if happened_s == self._reported_s:
            return ()
        times_s = zip(happened_s, self._reported_s, _TROUBLES, strict=True)
        new = tuple(words for happened, reported, words in times_s if happened > reported)
        self._reported_s = tuple(map(max, happened_s, self._reported_s))
        return new
