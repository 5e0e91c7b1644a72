"""What the sensors have measured lately, by kind and in order: all that the check over the pad looks at.

Body axes are FRD, units SI, field µT; times are of measurement. Stands where the estimator stands in flight
(`companion.app.sensing.Estimates`): the check wants the sensors as they are, not what a filter makes of them.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, TypeVar

from companion.base.messages import (
    AutopilotAttitude,
    GpsFix,
    ImuSample,
    MagSample,
    PadPrior,
    PadSighting,
    RangeSample,
)

MEMORY_S: Final = 120.0  # longer than a move may take
Sample = TypeVar("Sample", ImuSample, MagSample, PadSighting, RangeSample)


class RecentSamples:
    """Takes samples, forgets old ones, and hands out those of a time."""

    def __init__(self) -> None:
        self.imu: deque[ImuSample] = deque()
        self.mag: deque[MagSample] = deque()
        self.range: deque[RangeSample] = deque()
        self.sightings: deque[PadSighting] = deque()

    def add_imu(self, sample: ImuSample, received_s: float = math.inf) -> None:
        """One of gyroscope and accelerometer."""
        _keep(self.imu, sample)

    def add_mag(self, sample: MagSample) -> None:
        """One of the magnetometer."""
        _keep(self.mag, sample)

    def add_range(self, sample: RangeSample) -> None:
        """One echo."""
        _keep(self.range, sample)

    def add_sighting(self, sighting: PadSighting) -> None:
        """The pad in one frame."""
        _keep(self.sightings, sighting)

    def add_gps(self, fix: GpsFix) -> None:
        """Says nothing of what is checked here."""

    def add_autopilot_attitude(self, sample: AutopilotAttitude) -> None:
        """Nor does this."""

    def pad_prior(self, time_s: float) -> PadPrior | None:
        """Nothing is expected: gravity by a sensor that may be mounted wrongly must not guide vision."""
        return None


def within(samples: deque[Sample], start_s: float, end_s: float) -> list[Sample]:
    """Those measured from start to end, oldest first."""
    found = []
    for sample in reversed(samples):
        if sample.time_s < start_s:
            break
        if sample.time_s <= end_s:
            found.append(sample)
    return found[::-1]


def _keep(samples: deque[Sample], sample: Sample) -> None:
    samples.append(sample)
    while samples[0].time_s < sample.time_s - MEMORY_S:
        samples.popleft()
