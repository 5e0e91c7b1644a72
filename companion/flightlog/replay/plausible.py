"""What a replay came to that no vehicle, sensor or place can have, in words for its reader. Pure."""

import math
from collections.abc import Mapping
from typing import Final

from companion.base.geometry import Vector3, norm
from companion.base.messages import VehicleState
from companion.estimate.ahrs.alignment import LARGEST_BIAS_RAD_S
from companion.flightlog.replay.flight_record import RecordedReference, Source

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


def _biases(last: VehicleState) -> list[str]:
    found = []
    if (bias := norm(last.accel_bias_m_s2)) > LARGEST_ACCEL_BIAS_M_S2:
        found.append(
            f"accelerometer bias {bias:.1f} m/s² at the end; no accelerometer has more than "
            f"{LARGEST_ACCEL_BIAS_M_S2:g}: clipping, a wrong scale or axis, or a wrong GPS velocity"
        )
    if (bias := norm(last.gyro_bias_rad_s)) > LARGEST_BIAS_RAD_S:
        found.append(
            f"gyroscope bias {math.degrees(bias):.1f}°/s at the end; no gyroscope has more than "
            f"{math.degrees(LARGEST_BIAS_RAD_S):g}: clipping, or a wrong scale or axis"
        )
    return found


def _speed(fastest_m_s: float) -> list[str]:
    if fastest_m_s <= LARGEST_SPEED_M_S:
        return []
    return [
        f"speed {fastest_m_s:.0f} m/s; no multirotor flies faster than {LARGEST_SPEED_M_S:g}: it ran away"
    ]


def _magnetometer(samples: Mapping[str, int], refused: Mapping[str, int]) -> list[str]:
    number = samples.get("mag", 0)
    share = sum(refused.get(kind, 0) for kind in _REFUSALS) / number if number else 0.0
    if share <= REFUSED_SHARE:
        return []
    return [
        f"{share:.0%} of the magnetometer's samples were refused: size, dip or direction are not the "
        "field's there; the heading is the gyroscope's, and may be off by tens of degrees"
    ]


def _origins(references: Mapping[Source, RecordedReference], origin: Vector3) -> list[str]:
    found = []
    for source, reference in references.items():
        apart_m = 0.0 if reference.origin is None else abs(reference.origin[2] - origin[2])
        if reference.origin is not None and apart_m > APART_M:
            found.append(
                f"the origin of the log's {'truth' if source == 'truth' else 'position'} is at "
                f"{reference.origin[2]:.0f} m, the GPS's at {origin[2]:.0f} m: the position's error contains "
                f"{apart_m:.0f} m of that"
            )
    return found
