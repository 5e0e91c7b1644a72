"""What a replay came to that cannot be, and what its log lacks, in words for its reader. Pure."""

import itertools
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from companion.base.geometry import Vector3, norm
from companion.base.messages import ImuSample, MagSample, VehicleState
from companion.config import AlignmentConfig
from companion.estimate.ahrs.alignment import BLOCK_S, LARGEST_BIAS_RAD_S, StillnessDetector
from companion.estimate.vehicle.vehicle_estimator import LOST_S
from companion.flightlog.replay.flight_record import RecordedEvent, RecordedReference, Source

# zero-g output of the MPU9250 (80 mg, and 1.5 mg/K over 40 K), of ICM and BMI parts less
LARGEST_ACCEL_BIAS_M_S2: Final = 1.4
LARGEST_SPEED_M_S: Final = 80.0  # beyond the fastest multirotors, and any wind they survive
REFUSED_SHARE: Final = (
    0.5  # of the magnetometer: more often than not the heading had nothing but the gyroscope
)
APART_M: Final = 100.0  # two origins on one flight; an altitude of 0 for one over the sea is the usual cause
_REFUSALS: Final = ("field_gate", "mag_gate")


def implausible(
    last: VehicleState | None,
    fastest_m_s: float,
    samples: Mapping[str, int],
    refused: Mapping[str, int],
    references: Mapping[Source, RecordedReference],
    origin: Vector3 | None,
) -> list[str]:
    """One line for each thing that cannot be.

    Args:
        last: the estimate at the end.
        fastest_m_s: the largest speed on the way.
        samples: how many went in, by kind.
        refused: how many of them were not used, by kind.
        references: what the replay is held against.
        origin: latitude, longitude (deg) and altitude (m) of our position's zero.
    """
    return [
        *([] if last is None else _biases(last)),
        *_speed(fastest_m_s),
        *_magnetometer(samples, refused),
        *([] if origin is None else _origins(references, origin)),
    ]


def _biases(last: VehicleState) -> Iterator[str]:
    if (bias := norm(last.accel_bias_m_s2)) > LARGEST_ACCEL_BIAS_M_S2:
        yield (
            f"accelerometer bias {bias:.1f} m/s² at the end; no accelerometer has more than "
            f"{LARGEST_ACCEL_BIAS_M_S2:g}: clipping, a wrong scale or axis, or a wrong GPS velocity"
        )
    if (bias := norm(last.gyro_bias_rad_s)) > LARGEST_BIAS_RAD_S:
        yield (
            f"gyroscope bias {math.degrees(bias):.1f}°/s at the end; no gyroscope has more than "
            f"{math.degrees(LARGEST_BIAS_RAD_S):g}: clipping, or a wrong scale or axis"
        )


def _speed(fastest_m_s: float) -> Iterator[str]:
    if fastest_m_s > LARGEST_SPEED_M_S:
        limit = f"{LARGEST_SPEED_M_S:g}"
        yield f"speed {fastest_m_s:.0f} m/s; no multirotor flies faster than {limit}: it ran away"


def _magnetometer(samples: Mapping[str, int], refused: Mapping[str, int]) -> Iterator[str]:
    number = samples.get("mag", 0)
    share = sum(refused.get(kind, 0) for kind in _REFUSALS) / number if number else 0.0
    if share > REFUSED_SHARE:
        yield (
            f"{share:.0%} of the magnetometer's samples were refused: size, dip or direction are not the "
            "field's there; the heading is the gyroscope's, and may be off by tens of degrees"
        )


def _origins(references: Mapping[Source, RecordedReference], origin: Vector3) -> Iterator[str]:
    for source, reference in references.items():
        apart_m = 0.0 if reference.origin is None else abs(reference.origin[2] - origin[2])
        if reference.origin is not None and apart_m > APART_M:
            yield (
                f"the origin of the log's {'truth' if source == 'truth' else 'position'} is at "
                f"{reference.origin[2]:.0f} m, the GPS's at {origin[2]:.0f} m: the position's error contains "
                f"{apart_m:.0f} m of that"
            )


# ---------------------------------------------------------------- what the log lacks
# Why the estimators never aligned over it. What a log needs is documented in docs/how-to/replay.md: the IMU's
# rate, no gaps in it, a rest.

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
