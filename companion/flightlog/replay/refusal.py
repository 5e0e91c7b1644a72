"""What a log lacks for a replay, and why the estimators never aligned over one, in words. Pure.

What a log needs is documented in docs/how-to/replay.md: the IMU's rate, no gaps in it, a rest.
"""

import itertools
import statistics
from collections.abc import Sequence
from typing import Final

from companion.base.messages import ImuSample, MagSample
from companion.config import AlignmentConfig
from companion.estimate.ahrs.alignment import BLOCK_S, StillnessDetector
from companion.estimate.vehicle.vehicle_estimator import LOST_S
from companion.flightlog.replay.flight_record import RecordedEvent

RATE_TOLERANCE: Final = 0.02  # an oscillator's, and rounded stamps
LEAST_IMU_HZ: Final = 3.0 / BLOCK_S  # a block of the stillness detector holds three samples at least


def why_unaligned(events: Sequence[RecordedEvent], alignment: AlignmentConfig) -> str:
    """The reasons that hold, separated by semicolons; what was expected with each."""
    imu = [event.item for event in events if isinstance(event.item, ImuSample)]
    fields = sum(isinstance(event.item, MagSample) for event in events)
    times = [sample.time_s for sample in imu]
    if len(times) < 2 or not fields:
        return f"{len(times)} samples of the IMU and {fields} of the magnetometer; expected a stream of each"
    span_s = max(times) - min(times)
    rest_s, moving_s = _longest_rest_s(imu, alignment), alignment.still_s + BLOCK_S
    reasons = shortcomings(events)
    if rest_s < alignment.still_s:
        reasons.append(
            f"it is at rest for {rest_s:.1f} s at most and {span_s:.1f} s long; expected "
            f"{alignment.still_s:g} s at rest, or {moving_s:g} s in motion"
        )
    return "; ".join(reasons) or "the accelerometer or the magnetometer measures nothing (zeros)"


def shortcomings(events: Sequence[RecordedEvent]) -> list[str]:
    """In what the log's IMU falls short of what a replay needs; what was expected with each."""
    times = [event.item.time_s for event in events if isinstance(event.item, ImuSample)]
    steps = [(b - a, a - times[0]) for a, b in itertools.pairwise(times)]
    if not steps:
        return []
    found = []
    typical_s = statistics.median(step_s for step_s, _ in steps)  # a gap is not a rate
    if typical_s * LEAST_IMU_HZ > 1.0 + RATE_TOLERANCE:
        found.append(f"the IMU comes at {1.0 / typical_s:.0f} Hz; expected at least {LEAST_IMU_HZ:.0f}")
    gaps = [step for step in steps if step[0] > LOST_S]
    if gaps:
        gap_s, at_s = max(gaps)
        more = "" if len(gaps) == 1 else f", and {len(gaps) - 1} more of its gaps are too long"
        found.append(
            f"the IMU is silent for {gap_s:.1f} s, {at_s:.1f} s after its start{more}; "
            f"expected no gap beyond {LOST_S:g} s"
        )
    return found


def _longest_rest_s(imu: Sequence[ImuSample], alignment: AlignmentConfig) -> float:
    detector, rest, longest = StillnessDetector(alignment), 0, 0
    for sample in imu:
        block = detector.add(sample.time_s, sample.rate_body_rad_s, sample.specific_force_body_m_s2)
        if block is not None:
            rest = rest + 1 if block.still else 0
            longest = max(longest, rest)
    return longest * BLOCK_S
