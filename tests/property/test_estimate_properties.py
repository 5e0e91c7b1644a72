"""Properties of the estimators that hold for any input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.geometry import (
    GRAVITY_M_S2,
    Quaternion,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate_inverse,
    rotation_vector_from_quat,
    vector3,
)
from companion.config import EkfConfig
from companion.estimate.ahrs.complementary import blend
from companion.estimate.ahrs.madgwick import align
from companion.estimate.gating import Timeline
from companion.estimate.vehicle import ekf_model as model
from companion.estimate.vehicle.ekf import VehicleEkf
from companion.estimate.vehicle.ekf_inputs import EkfInput, GpsStep, ImuStep
from companion.estimate.vehicle.ekf_start import InitialState
from companion.estimate.vehicle.ekf_state import EkfSnapshot

FIELD = (20.9, 0.6, 42.9)
angles = st.floats(-math.pi, math.pi)
pitches = st.floats(-1.5, 1.5)
attitudes = st.builds(quat_from_euler, angles, pitches, angles)


def angle(a: Quaternion, b: Quaternion) -> float:
    return float(np.linalg.norm(rotation_vector_from_quat(quat_multiply(a, quat_conjugate(b)))))


@given(attitudes, attitudes, st.floats(0.0, 10.0), st.floats(0.0, 0.1))
@settings(max_examples=60, deadline=None)
def test_blend_lies_between_and_has_unit_length(
    q: Quaternion, r: Quaternion, error_rate: float, dt_s: float
) -> None:
    mixed = blend(q, r, error_rate, dt_s)
    assert math.fsum(value * value for value in mixed) == pytest.approx(1.0)
    assert angle(mixed, q) <= angle(r, q) + 1e-6
    assert angle(mixed, r) <= angle(r, q) + 1e-6


@given(angles, pitches, angles)
@settings(max_examples=60, deadline=None)
def test_alignment_inverts_the_sensors(roll: float, pitch: float, yaw: float) -> None:
    q = quat_from_euler(roll, pitch, yaw)
    force = quat_rotate_inverse(q, (0.0, 0.0, -GRAVITY_M_S2))
    found = align(force, quat_rotate_inverse(q, FIELD), math.atan2(FIELD[1], FIELD[0]))
    assert angle(found, q) < 1e-5


def inputs(seed: int) -> list[tuple[float, EkfInput]]:
    rng = np.random.default_rng(seed)
    made: list[tuple[float, EkfInput]] = [
        (
            0.01 * k,
            ImuStep(
                vector3(0.2 * rng.normal(size=3)), vector3(rng.normal(size=3) - np.array([0, 0, 9.8])), 2
            ),
        )
        for k in range(1, 30)
    ]
    for k in range(3):
        position, speed = vector3(rng.normal(size=3)), vector3(0.1 * rng.normal(size=3))
        made.append((0.045 + 0.1 * k, GpsStep(position, speed, (3.0, 3.0, 4.0), (0.1, 0.1, 0.2))))
    return sorted(made, key=lambda item: item[0])


_MOTION = [*range(model.STATES)[model.VELOCITY], *range(model.STATES)[model.POSITION]]


@given(st.integers(0, 1000), st.randoms(use_true_random=False))
@settings(max_examples=15, deadline=None)
def test_ekf_gives_the_same_for_any_order_of_arrival(seed: int, random: object) -> None:
    ordered = inputs(seed)
    shuffled = ordered[1:]
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    results = []
    for sequence in (ordered, [ordered[0], *shuffled]):
        start = InitialState(0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), FIELD, 0.03, 0.06, 1e-3)
        ekf = VehicleEkf(EkfConfig(), (0.1, 0.0, 0.0), start)
        timeline: Timeline[EkfSnapshot, EkfInput] = Timeline(ekf, 1.0)
        for time_s, item in sequence:
            assert timeline.add(time_s, item)
        results.append((ekf.attitude, ekf.x[_MOTION], ekf.motion_covariance()))
    # a late fix is carried forward by the transition and not by going through all again: right to first
    # order, which is far within what the filter itself states
    (before, at, P), (after, late, late_P) = results
    turned = rotation_vector_from_quat(quat_multiply(after, quat_conjugate(before)))
    stated = np.sqrt(np.diag(P))
    assert np.all(np.abs([*turned, *(late - at)]) <= 0.03 * stated)
    assert np.all(np.abs(late_P - P) <= 0.02 * np.outer(stated, stated))


@given(attitudes, st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.floats(1e-4, 0.5))
@settings(max_examples=60, deadline=None)
def test_transition_keeps_the_quaternions_length(q: Quaternion, rate: list[float], dt_s: float) -> None:
    x = np.zeros(model.STATES)
    x[model.QUATERNION] = q
    u = model.InertialInput(vector3(rate), (0.3, -0.2, -9.8))
    after, _ = model.transition(x, u, dt_s)
    assert np.linalg.norm(after[model.QUATERNION]) == pytest.approx(1.0, abs=1e-12)
