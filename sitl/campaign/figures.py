"""Statistics of a campaign: success rate with its interval, errors at touchdown, the worst runs, bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import binomtest

from sitl.campaign.rows import Row

CONFIDENCE: Final = 0.95
# the worst first; a run that came down is judged by how far off it was
SEVERITY: Final = {"crashed": 0, "failed": 1, "timeout": 2, "aborted": 2, "missed": 3, "landed": 3}
MEDIAN_LATERAL_M: Final = 0.05
WORST_LATERAL_M: Final = 0.15
VERTICAL_M_S: Final = 0.4
HORIZONTAL_M_S: Final = 0.3


@dataclass(frozen=True, slots=True)
class Share:
    """A share of runs, and the interval that holds the true one with 95 % (Wilson's score interval)."""

    hits: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself."""
        return self.hits / self.of

    def __str__(self) -> str:
        return f"{100 * self.value:.0f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"


def share(hits: int, of: int) -> Share:
    """A share of `of` runs, at least one.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference" (1927). It
    is valid where the normal approximation fails: with few runs, and with all of them landed.
    """
    interval = binomtest(hits, of).proportion_ci(CONFIDENCE, method="wilson")
    return Share(hits, of, float(interval.low), float(interval.high))


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Half of the values are at most `p50`, 95 % at most `p95`, all at most `worst`."""

    p50: float
    p95: float
    worst: float


def values(rows: Sequence[Row], column: str) -> list[float]:
    """The sizes of a column's values where there are any, ascending."""
    return sorted(abs(value) for row in rows if (value := getattr(row, column)) is not None)


def spread(rows: Sequence[Row], column: str) -> Percentiles | None:
    """The percentiles of a column's sizes; None without values."""
    sizes = values(rows, column)
    if not sizes:
        return None
    p50, p95 = np.percentile(sizes, [50.0, 95.0])
    return Percentiles(float(p50), float(p95), sizes[-1])


def by_scenario(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each scenario, in the order in which these first come."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.scenario, []).append(row)
    return groups


def worst(rows: Sequence[Row], count: int) -> list[Row]:
    """The worst runs: crashes, failed runs, timeouts and aborts, then by distance from the pad's centre."""
    return sorted(
        rows,
        key=lambda row: (SEVERITY[row.outcome], -(row.touchdown_lateral_m or 0.0), row.scenario, row.seed),
    )[:count]


# ---------------------------------------------------------------- bars


@dataclass(frozen=True, slots=True)
class Bar:
    """One acceptance criterion, the measured value, and whether it holds."""

    name: str
    measured: str
    holds: bool

    def __str__(self) -> str:
        return f"{self.name} {self.measured} {'holds' if self.holds else 'FAILS'}"


def bars(rows: Sequence[Row]) -> list[Bar]:
    """The landings against the project's acceptance criteria; medians per scenario."""
    landed = sum(row.landed for row in rows)
    lateral = "touchdown_lateral_m"
    medians = [found.p50 for group in by_scenario(rows).values() if (found := spread(group, lateral))]
    measured = (
        ("lateral median", max(medians, default=None), MEDIAN_LATERAL_M, "m"),
        ("lateral worst", max(values(rows, lateral), default=None), WORST_LATERAL_M, "m"),
        ("vertical speed", max(values(rows, "vertical_speed_m_s"), default=None), VERTICAL_M_S, "m/s"),
        ("horizontal speed", max(values(rows, "horizontal_speed_m_s"), default=None), HORIZONTAL_M_S, "m/s"),
    )
    return [Bar("landed", f"{landed} of {len(rows)}", landed == len(rows) > 0)] + [
        Bar(name, f"- (<= {limit:g} {unit})", holds=False)
        if value is None
        else Bar(name, f"{value:.3f} (<= {limit:g}) {unit}", value <= limit)
        for name, value, limit, unit in measured
    ]
