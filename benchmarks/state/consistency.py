"""Whether a filter's covariance tells the truth about its errors, and how an error recovers; pure numbers.

Normalised estimation error squared (NEES): e' P^-1 e, chi-square distributed with as many degrees of freedom
as the error has components, when the covariance is right. Averaged over N independent flights it lies in
chi2(N d) / N; below the band a filter is too modest, above it too sure (Bar-Shalom, Li, Kirubarajan 2001,
section 5.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import chi2

from companion.base.geometry import FloatArray

SHARE: Final = 0.95


def nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """e' P^-1 e of errors (n, d) with covariances (n, d, d); NaN where an error is not finite."""
    values = np.full(len(errors), np.nan)
    known = np.isfinite(errors).all(axis=1)
    solved = np.linalg.solve(covariances[known], errors[known, :, None])[:, :, 0]
    values[known] = np.sum(errors[known] * solved, axis=1)
    return values


def band(dimension: int, count: Any, share: float = SHARE) -> tuple[Any, Any]:
    """Bounds that hold that share of the mean NEES of `count` flights; a number or an array."""
    tail, freedom = 0.5 * (1.0 - share), np.asarray(count) * dimension
    return chi2.ppf(tail, freedom) / count, chi2.ppf(1.0 - tail, freedom) / count


@dataclass(frozen=True)
class Consistency:
    """The NEES of one kind of error over several flights."""

    dimension: int
    flights: int
    mean: float  # over flights and time
    low: float  # the band of a mean over all flights
    high: float
    share_inside: float  # of the time at which the mean over the flights lies in its band
    time_s: FloatArray  # (k,) since each flight's own start
    by_time: FloatArray  # (k,) mean over the flights
    count: FloatArray  # (k,) flights that are in it

    @property
    def holds(self) -> bool:
        """Whether the mean lies in the band."""
        return bool(self.low <= self.mean <= self.high)


def consistency(
    dimension: int, flights: Sequence[tuple[FloatArray, FloatArray]], period_s: float = 0.1
) -> Consistency:
    """Put the NEES of flights together.

    Args:
        dimension: of the error.
        flights: times (n,) since the flight's start and NEES (n,) of each; the lengths may differ.
        period_s: of the grid of time on which flights are averaged.
    """
    kept = [(t[np.isfinite(v)], v[np.isfinite(v)]) for t, v in flights]
    kept = [(t, v) for t, v in kept if len(v)]
    low, high = band(dimension, max(len(kept), 1))
    mean = float(np.mean([v.mean() for _, v in kept])) if kept else float("nan")
    rows = [np.round(t / period_s).astype(int) for t, _ in kept]
    length = max((int(row.max()) + 1 for row in rows), default=0)
    total: FloatArray = np.zeros(length)
    count: FloatArray = np.zeros(length)
    for row, (_, values) in zip(rows, kept, strict=True):
        first = np.unique(row, return_index=True)[1]  # one sample of a flight in each slot
        total[row[first]] += values[first]
        count[row[first]] += 1
    # towards the end only the longest flights are left, which says little of all
    used = count > 0.5 * len(kept)
    time_s: FloatArray = np.flatnonzero(used) * np.float64(period_s)
    by_time, count = total[used] / count[used], count[used]
    lows, highs = band(dimension, count) if len(count) else (np.zeros(0), np.zeros(0))
    inside = float(np.mean((by_time >= lows) & (by_time <= highs))) if len(count) else float("nan")
    return Consistency(dimension, len(kept), mean, float(low), float(high), inside, time_s, by_time, count)


def recovery_s(
    times_s: FloatArray, errors: FloatArray, level: float, from_s: float, calm_s: float = 2.0
) -> float:
    """Time from `from_s` until the errors (n,) are below a level, to stay there for `calm_s` at least.

    0 when they never left; infinite when they do not come back, or when the flight ends before that is sure.
    """
    after = times_s >= from_s
    times, high = times_s[after], ~(errors[after] <= level)
    if not high.any():
        return 0.0 if len(times) else float("inf")
    for time_s in times[~high & (times <= times[-1] - calm_s)]:
        if not high[(times >= time_s) & (times <= time_s + calm_s)].any():
            return float(time_s - from_s) if high[: np.searchsorted(times, time_s)].any() else 0.0
    return float("inf")
