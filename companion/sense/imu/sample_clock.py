"""When the samples of a FIFO were taken, from nothing but the times at which it was read.

The sensor runs on its own oscillator (MPU9250: +-1 %), the reader is woken late now and then, and no
sample carries a time. What is known: sample k was taken at t0 + k T, and at a read the newest sample is
between 0 and T old, T/2 in the mean. So a straight line (t0, T) is fitted through `read time - T/2`,
recursively: the gains are those of the least-squares line through all reads so far (expanding-memory
filter), held constant once they are small. An error counts as one period at most: a late wake-up hardly
bends the time scale.
"""

from typing import Final

FIRST_READS: Final = 20  # what the nominal period is worth, in reads
MOST_READS: Final = 800  # the memory: 16 s of polls at 50 Hz
OSCILLATOR_TOLERANCE: Final = 0.03
LOST_PERIODS: Final = 6.0
LOST_READS: Final = 10


class SampleClock:
    """Gives every sample of a FIFO its time. Restart it whenever the FIFO was emptied or reset."""

    def __init__(self, period_s: float) -> None:
        self._nominal_s = period_s
        self.restart()

    def restart(self) -> None:
        """Forget the time scale; the next read starts a new one."""
        self._period_s = self._nominal_s
        self._newest_s: float | None = None
        self._reads = FIRST_READS
        self._far_reads = 0

    @property
    def period_s(self) -> float:
        """The sensor's sample period (s) as learnt so far."""
        return self._period_s

    def stamp(self, read_s: float, count: int) -> list[float]:
        """Times (s, rising) of `count` >= 1 samples that were read at `read_s`, oldest first."""
        expected_s = read_s - 0.5 * self._period_s
        if self._newest_s is None:
            newest_s = expected_s
        else:
            newest_s = self._newest_s + count * self._period_s
            newest_s += self._correction(expected_s - newest_s, count)
        oldest_s = newest_s - (count - 1) * self._period_s
        self._newest_s = newest_s
        return [oldest_s + k * self._period_s for k in range(count)]

    def stamp_newest(self, read_s: float) -> float:
        """Time (s) of one sample that was read at `read_s`, when those before it may have been missed."""
        count = 1
        if self._newest_s is not None:
            since_s = read_s - 0.5 * self._period_s - self._newest_s
            count = max(1, round(since_s / self._period_s))
        return self.stamp(read_s, count)[-1]

    def _correction(self, error_s: float, count: int) -> float:
        period = self._period_s
        self._far_reads = self._far_reads + 1 if abs(error_s) > LOST_PERIODS * period else 0
        if self._far_reads >= LOST_READS:
            # samples were lost without a trace, or a count was too large: start again from here
            self._far_reads = 0
            self._reads = FIRST_READS
            return error_s
        clamped_s = max(-period, min(period, error_s))
        n = self._reads
        self._reads = min(n + 1, MOST_READS)
        share = 1.0 / ((n + 1) * (n + 2))
        learnt_s = period + 6.0 * share * clamped_s / count
        low, high = 1.0 - OSCILLATOR_TOLERANCE, 1.0 + OSCILLATOR_TOLERANCE
        self._period_s = max(low * self._nominal_s, min(high * self._nominal_s, learnt_s))
        return (4 * n + 2) * share * clamped_s
