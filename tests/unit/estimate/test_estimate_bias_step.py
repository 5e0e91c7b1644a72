"""A gyroscope whose bias steps in flight, through the whole stage with the autopilot's attitude beside."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from companion.base.geometry import (
    Vector3,
    add,
    norm,
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    rotation_vector_from_quat,
    subtract,
    vector3,
)
from companion.base.messages import AutopilotAttitude, ImuSample
from tests.unit.estimate.estimate_flight import EstimateFlight, circle, feed, hover, new_estimator

STEP_S = 14.0
CHANGE = tuple(math.radians(value) for value in (1.15, 1.15, 1.15))
FLIGHTS = {
    "hover": EstimateFlight(hover, seed=21, duration_s=22.0, sensors=frozenset({"imu", "mag", "gps"})),
    "circle": EstimateFlight(
        circle(4.0, 1.5), seed=22, duration_s=22.0, sensors=frozenset({"imu", "mag", "gps"})
    ),
}


@dataclass(frozen=True)
class BiasStepRun:
    time_s: list[float]
    error_deg: list[float]
    gyro_bias_rad_s: list[Vector3]


@lru_cache
def flown(name: str, change: Vector3 = CHANGE, told: bool = True, delay_s: float = 0.0) -> BiasStepRun:  # type: ignore[assignment]
    """The stage's attitude errors; the autopilot has a heading and a horizon of its own."""
    flight, estimator, run = FLIGHTS[name], new_estimator(), BiasStepRun([], [], [])
    rng, own = np.random.default_rng(4), quat_from_euler(0.02, -0.02, 0.4)
    for k, (arrival_s, sample) in enumerate(flight.samples):
        if isinstance(sample, ImuSample) and sample.time_s >= STEP_S:
            sample = replace(sample, rate_body_rad_s=add(sample.rate_body_rad_s, change))  # noqa: PLW2901
        feed(estimator, sample)
        if told and k % 10 == 0:
            off = quat_from_rotation_vector(vector3(0.001 * rng.normal(size=3)))
            attitude = quat_multiply(quat_multiply(own, flight.attitude(arrival_s - 0.02 - delay_s)), off)
            estimator.add_autopilot_attitude(AutopilotAttitude(arrival_s - 0.02, attitude))
        state = estimator.vehicle(arrival_s)
        if k % 10 == 0 and state is not None and arrival_s > 12.0:
            apart = quat_multiply(quat_conjugate(flight.attitude(arrival_s)), state.attitude)
            run.time_s.append(arrival_s)
            run.error_deg.append(math.degrees(norm(rotation_vector_from_quat(apart))))
            run.gyro_bias_rad_s.append(state.gyro_bias_rad_s)
    return run


@pytest.mark.parametrize("name", FLIGHTS)
def test_attitude_stays_within_five_degrees_and_is_back_within_five_seconds(name: str) -> None:
    run = flown(name)
    before = [e for t, e in zip(run.time_s, run.error_deg, strict=True) if t < STEP_S]
    after = [e for t, e in zip(run.time_s, run.error_deg, strict=True) if t > STEP_S + 5.0]
    assert max(run.error_deg) < 5.0
    assert max(after) < max(before) + 1.5


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_new_bias_is_known_within_two_seconds(name: str) -> None:
    run, true_bias = flown(name), add(FLIGHTS[name].gyro_bias_rad_s, CHANGE)  # type: ignore[arg-type]
    later = [b for t, b in zip(run.time_s, run.gyro_bias_rad_s, strict=True) if t > STEP_S + 2.0]
    assert max(norm(subtract(bias, true_bias)) for bias in later) < math.radians(0.7)


def test_without_the_autopilot_the_attitude_is_turned_further_away() -> None:
    assert max(flown("hover", told=False).error_deg) > max(flown("hover").error_deg) + 1.0


@pytest.mark.parametrize("delay_s", [0.0, 0.05])
def test_without_a_step_the_autopilots_attitude_changes_nothing(delay_s: float) -> None:
    none = (0.0, 0.0, 0.0)
    assert flown("circle", none, True, delay_s) == flown("circle", none, False)
