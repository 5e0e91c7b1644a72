"""The 31-state models' analytic Jacobians against finite differences, and their physics."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import (
    GRAVITY_M_S2,
    FloatArray,
    Quaternion,
    matrix_from_quat,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    vector3,
)
from companion.estimate.vehicle import ekf_model as model

ANTENNA = (0.1, -0.2, -0.3)
Measurement = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
MODELS: dict[str, Measurement] = {
    "mag": model.mag_model,
    "gps_position": lambda x: model.gps_position_model(x, ANTENNA),
    "gps_velocity": lambda x: model.gps_velocity_model(x, ANTENNA),
}


def left_matrix(q: Quaternion) -> FloatArray:
    """L(q), (4, 4), with q * p = L(q) p."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def some_state(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=model.STATES)
    x[model.QUATERNION] /= np.linalg.norm(x[model.QUATERNION])
    x[model.FIELD] = (20.9, 0.6, 42.9)
    return x


def differences(f: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    columns = []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-6
        columns.append((f(x + step) - f(x - step)) / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(4))
def test_measurement_jacobian_matches_differences(name: str, seed: int) -> None:
    x, measure = some_state(seed), MODELS[name]
    assert measure(x)[1] == pytest.approx(differences(lambda s: measure(s)[0], x), abs=2e-7)


@pytest.mark.parametrize("dt_s", [0.0005, 0.01, 0.3])
@pytest.mark.parametrize("seed", range(4))
def test_transition_jacobian_matches_differences(seed: int, dt_s: float) -> None:
    x = some_state(seed)
    rng = np.random.default_rng(seed + 10)
    u = (vector3(3.0 * rng.normal(size=3)), vector3(10.0 * rng.normal(size=3)))
    n, m = model.MOVING, model.COUPLED
    numeric = differences(lambda s: model.transition(s, u, dt_s)[0], x)
    # along the quaternion's length, which stays 1, there is nothing to compare
    tangent = np.zeros((m, m - 1))
    tangent[:4, :3] = left_matrix(model.quaternion_of(x))[:, 1:]
    tangent[4:, 3:] = np.eye(m - 4)
    A = model.transition(x, u, dt_s)[1]
    assert A @ tangent == pytest.approx(numeric[:n, :m] @ tangent, abs=2e-6)
    # what A leaves out: nothing depends on field and magnetometer bias, which with the biases stay
    assert np.array_equal(numeric[:n, m:], np.zeros((n, model.STATES - m)))
    assert numeric[n:] == pytest.approx(np.eye(model.STATES)[n:], abs=1e-8)


def test_transition_keeps_the_euler_angles_those_of_the_quaternion() -> None:
    x = some_state(2)
    u = ((0.5, -1.0, 2.0), (0.3, -0.2, -9.8))
    after, _ = model.transition(x, u, 0.1)
    expected = quat_from_euler(*after[model.EULER])
    assert abs(np.dot(expected, after[model.QUATERNION])) == pytest.approx(1.0)


def test_rate_and_acceleration_are_what_the_imu_shows_less_its_biases_and_gravity() -> None:
    x = some_state(5)
    x[model.QUATERNION] = quat_from_euler(0.0, 0.0, math.pi / 2)
    x[model.GYRO_BIAS] = (0.1, 0.2, 0.3)
    x[model.ACCEL_BIAS] = (0.01, 0.02, 0.03)
    u = ((0.1, 0.2, 0.5), (2.01, 0.02, 0.03 - GRAVITY_M_S2))
    after, _ = model.transition(x, u, 1e-6)
    assert after[model.RATE] == pytest.approx([0.0, 0.0, 0.2])
    assert after[model.ACCELERATION] == pytest.approx([0.0, 2.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_field_seen_by_the_body_turns_with_it(yaw_deg: int) -> None:
    x = np.zeros(model.STATES)
    x[model.QUATERNION] = quat_from_euler(0.2, -0.3, math.radians(yaw_deg))
    x[model.FIELD] = (20.9, 0.6, 42.9)
    expected, _ = model.mag_model(x)
    assert quat_rotate(model.quaternion_of(x), tuple(expected)) == pytest.approx((20.9, 0.6, 42.9))


def test_quaternion_products_as_matrices() -> None:
    p, q = quat_from_euler(0.1, 0.2, 0.3), quat_from_euler(-0.5, 0.4, 2.0)
    assert left_matrix(p) @ q == pytest.approx(quat_multiply(p, q))
    assert model.right_matrix(q) @ p == pytest.approx(quat_multiply(p, q))


def test_small_turn_and_its_series_agree_where_they_meet() -> None:
    below, above = (0.9999e-3, 0.0, 0.0), (1.0001e-3, 0.0, 0.0)
    for rotation in (below, above):
        turn, derivatives = model.turn_and_derivatives(rotation)
        jacobian = np.transpose(derivatives)
        assert turn == pytest.approx(quat_from_rotation_vector(rotation), abs=1e-14)
        assert jacobian[1:] == pytest.approx(0.5 * np.eye(3), abs=1e-6)


def test_attitude_covariance_and_back() -> None:
    q = quat_from_euler(0.3, -0.2, 1.2)
    rotation = np.diag([1e-4, 2e-4, 3e-4])
    covariance = model.attitude_covariance(q, rotation)
    assert model.rotation_covariance(q, covariance) == pytest.approx(rotation)


def test_covariance_about_ned_axes_is_about_ned_axes() -> None:
    q = quat_from_euler(0.3, -0.2, 1.2)
    turned = quat_multiply(quat_from_rotation_vector((0.0, 0.0, 1e-4)), q)
    direction = (np.array(turned) - q) / 1e-4
    assert model.attitude_covariance(q, np.diag([0.0, 0.0, 1.0])) == pytest.approx(
        np.outer(direction, direction), abs=1e-4
    )


def test_euler_jacobian_stays_bounded_at_gimbal_lock() -> None:
    assert np.abs(model.euler_jacobian(quat_from_euler(0.3, math.pi / 2, 0.1))).max() < 1e5


def test_rotation_jacobian_uses_the_rotation_of_geometry() -> None:
    q = quat_from_euler(0.3, -0.2, 1.2)
    # R is homogeneous of degree two in (w, r) up to |q|: along q the derivative is 2 (R v - v)
    v = (1.0, 2.0, 3.0)
    along = model.rotation_jacobian(q, v) @ q
    assert along == pytest.approx(2.0 * (matrix_from_quat(q) @ v - v))
