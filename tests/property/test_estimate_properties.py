"""Properties of the estimators that hold for any input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base import geometry as g
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
from tests.attitudes import between_rad
from tests.unit.estimate.at_rest import FIELD

angles = st.floats(-math.pi, math.pi)
pitches = st.floats(-1.5, 1.5)
attitudes = st.builds(quat_from_euler, angles, pitches, angles)


@given(attitudes, attitudes, st.floats(0.0, 10.0), st.floats(0.0, 0.1))
@settings(max_examples=60, deadline=None)
def test_blend_lies_between_and_has_unit_length(
    q: Quaternion, r: Quaternion, error_rate: float, dt_s: float
) -> None:
    mixed = blend(q, r, error_rate, dt_s)
    assert math.fsum(value * value for value in mixed) == pytest.approx(1.0)
    assert between_rad(mixed, q) <= between_rad(r, q) + 1e-6
    assert between_rad(mixed, r) <= between_rad(r, q) + 1e-6


@given(attitudes)
@settings(max_examples=60, deadline=None)
def test_the_down_axis_turns_as_any_vector(q: Quaternion) -> None:
    assert g.down_axis(q) == g.quat_rotate(q, (0.0, 0.0, 1.0))
    assert g.down_in_body(q) == quat_rotate_inverse(q, (0.0, 0.0, 1.0))


@given(angles, pitches, angles)
@settings(max_examples=60, deadline=None)
def test_alignment_inverts_the_sensors(roll: float, pitch: float, yaw: float) -> None:
    q = quat_from_euler(roll, pitch, yaw)
    force = quat_rotate_inverse(q, (0.0, 0.0, -GRAVITY_M_S2))
    found = align(force, quat_rotate_inverse(q, FIELD), math.atan2(FIELD[1], FIELD[0]))
    assert between_rad(found, q) < 1e-5


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
        timeline: Timeline[EkfSnapshot, EkfInput] = Timeline(ekf, 1.0, ekf.carried)
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
    u = (vector3(rate), (0.3, -0.2, -9.8))
    after, _ = model.transition(x, u, dt_s)
    assert np.linalg.norm(after[model.QUATERNION]) == pytest.approx(1.0, abs=1e-12)


# ---------------- Rotations: what must hold for every attitude

components = st.floats(-100.0, 100.0)
vectors = st.tuples(components, components, components)
any_attitudes = st.tuples(angles, st.floats(-1.5, 1.5), angles).map(lambda rpy: g.quat_from_euler(*rpy))


def close(a: tuple[float, ...], b: tuple[float, ...], tolerance: float = 1e-9) -> bool:
    return all(abs(x - y) <= tolerance * max(1.0, abs(x)) for x, y in zip(a, b, strict=True))


@given(any_attitudes, vectors)
def test_rotating_there_and_back_changes_nothing(q: g.Quaternion, v: g.Vector3) -> None:
    assert close(g.quat_rotate_inverse(q, g.quat_rotate(q, v)), v, 1e-7)


@given(any_attitudes, vectors)
def test_quaternion_and_matrix_turn_alike(q: g.Quaternion, v: g.Vector3) -> None:
    assert np.allclose(g.matrix_from_quat(q) @ np.array(v), g.quat_rotate(q, v), atol=1e-9)


@given(any_attitudes, any_attitudes, vectors)
def test_a_product_turns_by_the_right_factor_first(p: g.Quaternion, q: g.Quaternion, v: g.Vector3) -> None:
    assert close(g.quat_rotate(g.quat_multiply(p, q), v), g.quat_rotate(p, g.quat_rotate(q, v)), 1e-7)


@given(any_attitudes)
def test_matrix_and_back_is_the_same_rotation(q: g.Quaternion) -> None:
    back = g.quat_from_matrix(g.matrix_from_quat(q))
    assert abs(sum(a * b for a, b in zip(q, back, strict=True))) == pytest.approx(1.0, abs=1e-9)


@given(any_attitudes)
def test_angles_and_back_is_the_same_rotation(q: g.Quaternion) -> None:
    back = g.quat_from_euler(*g.euler_from_quat(q))
    assert abs(sum(a * b for a, b in zip(q, back, strict=True))) == pytest.approx(1.0, abs=1e-9)


@given(st.tuples(*[st.floats(-1.5, 1.5)] * 3))
def test_rotation_vector_and_back_is_the_same(rotation: g.Vector3) -> None:
    assert close(g.rotation_vector_from_quat(g.quat_from_rotation_vector(rotation)), rotation, 1e-7)


@given(st.floats(-1e4, 1e4))
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = g.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)


@pytest.mark.parametrize(
    ("yaw_deg", "north_east"), [(0, (1, 0)), (90, (0, 1)), (180, (-1, 0)), (270, (0, -1))]
)
def test_the_nose_points_where_the_heading_says(yaw_deg: float, north_east: tuple[float, float]) -> None:
    q = g.quat_from_euler(0.0, 0.0, math.radians(yaw_deg))
    assert close(g.quat_rotate(q, (1.0, 0.0, 0.0)), (*map(float, north_east), 0.0))
    assert close(g.rotate_yaw((1.0, 0.0, 0.0), math.radians(yaw_deg)), (*map(float, north_east), 0.0))
    assert math.cos(g.yaw_from_quat(q)) == pytest.approx(math.cos(math.radians(yaw_deg)))


def test_positive_roll_is_right_side_down_and_positive_pitch_is_nose_up() -> None:
    rolled = g.quat_rotate(g.quat_from_euler(0.1, 0.0, 0.0), (0.0, 1.0, 0.0))
    pitched = g.quat_rotate(g.quat_from_euler(0.0, 0.1, 0.0), (1.0, 0.0, 0.0))
    assert rolled[2] > 0.0
    assert pitched[2] < 0.0


def test_integrating_a_yaw_rate_turns_clockwise_from_above() -> None:
    q = g.quat_integrate(g.IDENTITY, (0.0, 0.0, 0.2), 0.5)
    assert g.yaw_from_quat(q) == pytest.approx(0.1)


def test_the_downward_camera_sees_forward_at_the_top_and_right_at_the_right() -> None:
    q = g.BODY_FROM_DOWNWARD_CAMERA
    assert close(g.quat_rotate(q, (0.0, -1.0, 0.0)), (1.0, 0.0, 0.0))
    assert close(g.quat_rotate(q, (1.0, 0.0, 0.0)), (0.0, 1.0, 0.0))
    assert close(g.quat_rotate(q, (0.0, 0.0, 1.0)), (0.0, 0.0, 1.0))


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(-100, 100))
def test_geodetic_and_back_is_within_a_millimetre(north: float, east: float, down: float) -> None:
    origin = (47.0, 8.0, 400.0)
    back = g.ned_from_geodetic(*g.geodetic_from_ned((north, east, down), origin), origin)
    assert close(back, (north, east, down), 1e-3)
