"""Keeps spikes from the estimator without delaying what is good, whichever way the echoes come.

A spike (a rotor's noise, a second way of the sound, the shell's ringing) stands alone; a real step, as at the
pad's edge, stays. So a distance that could not have been reached from the last good one at
`maximum_speed_m_s` waits for the next: when that agrees with it, both were true and the newer is taken. What
fits is passed on at once, as it is: no filter, no lag. Spikes that last are the estimator's to refuse, which
knows more than one sensor.
"""

from typing import Final

from companion.base.messages import RangeSample
from companion.config import RangeConfig

MARGIN_M: Final = 0.03
MARGIN_SHARE: Final = 0.03  # three standard deviations of 1 %
REMEMBER_S: Final = 1.0  # after so long the last distance says nothing any more


class SpikeFilter:
    """The filter of one sensor."""

    def __init__(self, config: RangeConfig) -> None:
        self._speed_m_s = config.maximum_speed_m_s
        self._good: RangeSample | None = None
        self._doubted: RangeSample | None = None

    def step(self, sample: RangeSample) -> RangeSample | None:
        """The sample, or None while it has to be taken for a spike."""
        if self._follows(self._good, sample) or self._follows(self._doubted, sample):
            self._good, self._doubted = sample, None
            return sample
        self._doubted = sample
        return None

    def _follows(self, before: RangeSample | None, sample: RangeSample) -> bool:
        if before is None:
            return False
        elapsed_s = abs(sample.time_s - before.time_s)
        farther_m = max(before.distance_m, sample.distance_m)
        allowed_m = self._speed_m_s * elapsed_s + MARGIN_M + MARGIN_SHARE * farther_m
        return elapsed_s <= REMEMBER_S and abs(sample.distance_m - before.distance_m) <= allowed_m
