"""Rotations: what must hold for every attitude."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base import geometry as g

angles = st.floats(-math.pi, math.pi)
components = st.floats(-100.0, 100.0)
vectors = st.tuples(components, components, components)
attitudes = st.tuples(angles, st.floats(-1.5, 1.5), angles).map(lambda rpy: g.quat_from_euler(*rpy))


def close(a: tuple[float, ...], b: tuple[float, ...], tolerance: float = 1e-9) -> bool:
    return all(abs(x - y) <= tolerance * max(1.0, abs(x)) for x, y in zip(a, b, strict=True))


@given(attitudes, vectors)
def test_rotating_there_and_back_changes_nothing(q: g.Quaternion, v: g.Vector3) -> None:
    assert close(g.quat_rotate_inverse(q, g.quat_rotate(q, v)), v, 1e-7)


@given(attitudes, vectors)
def test_quaternion_and_matrix_turn_alike(q: g.Quaternion, v: g.Vector3) -> None:
    assert np.allclose(g.matrix_from_quat(q) @ np.array(v), g.quat_rotate(q, v), atol=1e-9)


@given(attitudes, attitudes, vectors)
def test_a_product_turns_by_the_right_factor_first(p: g.Quaternion, q: g.Quaternion, v: g.Vector3) -> None:
    assert close(g.quat_rotate(g.quat_multiply(p, q), v), g.quat_rotate(p, g.quat_rotate(q, v)), 1e-7)


@given(attitudes)
def test_matrix_and_back_is_the_same_rotation(q: g.Quaternion) -> None:
    back = g.quat_from_matrix(g.matrix_from_quat(q))
    assert abs(sum(a * b for a, b in zip(q, back, strict=True))) == pytest.approx(1.0, abs=1e-9)


@given(attitudes)
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
