"""What one step of each filter costs on this machine, measured over a recorded flight in one process."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any

from benchmarks.state.streams import INPUTS, Stream, feed, new_estimator
from companion.base.clock import wall_clock_s
from companion.config import CompanionConfig
from companion.estimate.pad.pad_filter import PadFilter, PadMeasurement
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import ImuStep


@dataclass(frozen=True)
class Costs:
    """Medians in µs of one call, by kind; `all_ms_per_s`: all inputs of a second of flight, in ms."""

    median_us: dict[str, float]
    calls: dict[str, int]
    all_ms_per_s: float


def measure(stream: Stream, config: CompanionConfig, passes: int = 3) -> Costs:
    """Run the estimator over the stream with its filters' steps timed."""
    spent_s: defaultdict[str, list[float]] = defaultdict(list)
    inputs = [event for event in stream.events if event.topic in INPUTS]
    seconds = inputs[-1].arrival_s - inputs[0].arrival_s
    totals = []
    for _ in range(passes):
        estimator = new_estimator(config)
        started_s = wall_clock_s()
        for event in inputs:
            feed(estimator, event)
        totals.append(wall_clock_s() - started_s)
    with _timed(VehicleEkf, _ekf_kind, spent_s), _timed(PadFilter, _pad_kind, spent_s):
        for _ in range(passes):
            estimator = new_estimator(config)
            for event in inputs:
                feed(estimator, event)
    return Costs(
        median_us={kind: 1e6 * median(values) for kind, values in sorted(spent_s.items())},
        calls={kind: len(values) // passes for kind, values in spent_s.items()},
        all_ms_per_s=1e3 * median(totals) / seconds,
    )


def _ekf_kind(item: Any) -> str:
    if not isinstance(item, ImuStep):
        return "EKF: predict + GPS update"
    if item.still or item.at_rest:
        return "EKF: predict + IMU update, standing"
    if item.field_body_ut is None and item.attitude is None:
        return "EKF: predict + IMU update"
    return "EKF: predict + IMU, magnetometer or orientation update"


def _pad_kind(item: Any) -> str:
    return f"pad filter: predict + {'sighting' if isinstance(item, PadMeasurement) else 'echo'}"


@contextmanager
def _timed(
    owner: type[Any], kind_of: Callable[[Any], str], spent_s: dict[str, list[float]]
) -> Iterator[None]:
    """While inside, each `apply(time_s, item)` of the class is timed."""
    apply: Callable[..., None] = owner.apply

    def timed(self: Any, time_s: float, item: Any) -> None:
        started_s = wall_clock_s()
        apply(self, time_s, item)
        spent_s[kind_of(item)].append(wall_clock_s() - started_s)

    owner.apply = timed
    try:
        yield
    finally:
        owner.apply = apply
