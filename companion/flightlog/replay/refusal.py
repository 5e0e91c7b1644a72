"""Why the estimators never aligned over a log, in words: the IMU's rate, its gaps, no rest. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

from companion.base.messages import ImuSample, MagSample
from companion.config import AlignmentConfig
from companion.estimate.ahrs.alignment import BLOCK_S, StillnessDetector
from companion.estimate.vehicle.vehicle_estimator import LOST_S
from companion.flightlog.replay.flight_record import RecordedEvent

LEAST_IMU_HZ: Final = 3.0 / BLOCK_S  # a block of the stillness detector holds three samples at least


def why_unaligned(events: Sequence[RecordedEvent], alignment: AlignmentConfig) -> str:
    """The reasons that hold, separated by semicolons; what was expected with each."""
    imu = [event.item for event in events if isinstance(event.item, ImuSample)]
    fields = sum(isinstance(event.item, MagSample) for event in events)
    times = [sample.time_s for sample in imu]
    if len(times) < 2 or not fields:
        return f"{len(times)} samples of the IMU and {fields} of the magnetometer; expected a stream of each"
    span_s = max(times) - min(times)
    rate_hz = (len(times) - 1) / span_s if span_s > 0.0 else 0.0
    gap_s, gap_at_s = max((b - a, a) for a, b in itertools.pairwise(times))
    rest_s, moving_s = _longest_rest_s(imu, alignment), alignment.timeout_s + alignment.still_s
    reasons = []
    if rate_hz < LEAST_IMU_HZ:
        reasons.append(f"the IMU comes at {rate_hz:.0f} Hz; expected at least {LEAST_IMU_HZ:.0f}")
    if gap_s > LOST_S:
        reasons.append(
            f"the IMU is silent for {gap_s:.1f} s, {gap_at_s - times[0]:.1f} s after its start; "
            f"expected no gap beyond {LOST_S:g} s"
        )
    if rest_s < alignment.still_s:
        reasons.append(
            f"it is at rest for {rest_s:.1f} s at most and {span_s:.1f} s long; expected "
            f"{alignment.still_s:g} s at rest, or more than {moving_s:g} s in motion"
        )
    return "; ".join(reasons) or "the accelerometer or the magnetometer measures nothing (zeros)"


def _longest_rest_s(imu: Sequence[ImuSample], alignment: AlignmentConfig) -> float:
    detector, rest, longest = StillnessDetector(alignment), 0, 0
    for sample in imu:
        block = detector.add(sample.time_s, sample.rate_body_rad_s, sample.specific_force_body_m_s2)
        if block is not None:
            rest = rest + 1 if block.still else 0
            longest = max(longest, rest)
    return longest * BLOCK_S
