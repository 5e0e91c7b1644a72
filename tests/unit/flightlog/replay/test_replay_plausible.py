"""What no vehicle can have is named in the notes of a replay; what it can have is not."""

from dataclasses import replace

import pytest

from companion.base.geometry import IDENTITY, ZERO3, Vector3
from companion.base.messages import VehicleState
from companion.flightlog.replay.flight_record import RecordedReference, Source
from companion.flightlog.replay.plausible import implausible

PLACE: Vector3 = (47.3, 8.5, 488.0)
WELL = VehicleState(
    time_s=9.0,
    attitude=IDENTITY,
    rate_body_rad_s=ZERO3,
    position_ned_m=ZERO3,
    velocity_ned_m_s=ZERO3,
    acceleration_ned_m_s2=ZERO3,
    gyro_bias_rad_s=(0.01, 0.0, -0.02),
    accel_bias_m_s2=(0.2, -0.1, 0.3),
    attitude_std_rad=0.02,
    velocity_std_m_s=0.1,
    position_std_m=1.0,
    aligned=True,
    has_gps=True,
    origin=PLACE,
)


def notes(
    state: VehicleState = WELL,
    fastest_m_s: float = 15.0,
    refused: dict[str, int] | None = None,
    truth: Vector3 = PLACE,
) -> list[str]:
    references: dict[Source, RecordedReference] = {"truth": RecordedReference({}, truth)}
    return implausible(state, fastest_m_s, {"mag": 1000}, refused or {"field_gate": 100}, references, PLACE)


def test_a_flight_as_flights_are_has_no_note() -> None:
    assert notes() == []


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (notes(replace(WELL, accel_bias_m_s2=(2.0, 0.0, 0.0))), "accelerometer bias 2.0 m/s²"),
        (notes(replace(WELL, gyro_bias_rad_s=(0.0, 0.4, 0.0))), "gyroscope bias 22.9°/s"),
        (notes(fastest_m_s=240.0), "speed 240 m/s"),
        (notes(refused={"field_gate": 570, "mag_gate": 300}), "87% of the magnetometer's samples"),
        (notes(truth=(47.3, 8.5, 0.0)), "the origin of the log's truth is at 0 m, the GPS's at 488 m"),
    ],
)
def test_what_cannot_be_is_said_once(found: list[str], words: str) -> None:
    (line,) = found
    assert words in line


def test_a_log_without_gps_or_magnetometer_is_judged_by_the_rest() -> None:
    assert implausible(None, 0.0, {}, {}, {}, None) == []
