"""What the drivers read of a simulated vehicle with faults."""

from typing import Any

import numpy as np

START_S, END_S, SECONDS = 6.0, 8.0, 10.0
TIMES: dict[str, Any] = {"start_s": START_S, "duration_s": END_S - START_S}
SETTLE_S = 0.05  # the filters' delay, and samples that are averages


def during(samples: list[Any]) -> list[Any]:
    return [sample for sample in samples if START_S + SETTLE_S < sample.time_s < END_S - SETTLE_S]


def elsewhere(samples: list[Any]) -> list[Any]:
    """Before the fault, and after it."""
    return [s for s in samples if s.time_s < START_S - SETTLE_S or s.time_s > END_S + SETTLE_S]


def mean(samples: list[Any], name: str) -> Any:
    return np.mean([getattr(sample, name) for sample in samples], axis=0)
