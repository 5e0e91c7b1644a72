"""Madgwick's filter and the first alignment (eq. 13), in NED and FRD."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.base.geometry import (
    IDENTITY,
    Quaternion,
    Vector3,
    matrix_from_quat,
    quat_from_euler,
    quat_integrate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
    vector3,
)
from companion.estimate.ahrs.madgwick import MadgwickFilter, align, field_gradient, tilt_gradient
from tests.attitudes import between_deg
from tests.unit.estimate.at_rest import DOWN_FORCE, FIELD

DECLINATION = math.atan2(FIELD[1], FIELD[0])


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 0), (20, 0), (0, -15), (-30, 25)])
def test_alignment_finds_the_attitude_at_rest(yaw_deg: int, roll_deg: int, pitch_deg: int) -> None:
    q = quat_from_euler(*(math.radians(angle) for angle in (roll_deg, pitch_deg, yaw_deg)))
    found = align(quat_rotate_inverse(q, DOWN_FORCE), quat_rotate_inverse(q, FIELD), DECLINATION)
    assert between_deg(found, q) < 1e-6


def test_alignment_without_gravity_or_north_is_an_error() -> None:
    with pytest.raises(ValueError, match="free fall"):
        align((0.0, 0.0, 0.0), FIELD, 0.0)
    with pytest.raises(ValueError, match="north"):
        align(DOWN_FORCE, (0.0, 0.0, 40.0), 0.0)


def numeric_gradient(f: Callable[[Quaternion], float], q: Quaternion) -> list[float]:
    gradient = []
    for i in range(4):
        high, low = list(q), list(q)
        high[i] += 1e-6
        low[i] -= 1e-6
        gradient.append((f((*high,)) - f((*low,))) / 2e-6)  # type: ignore[arg-type]
    return gradient


@pytest.mark.parametrize("seed", range(5))
def test_gradients_are_those_of_the_objectives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = quat_normalise((*rng.normal(size=4).tolist(),))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    m = vector3(direction)
    hx, hy, hz = quat_rotate(q, m)
    horizontal = math.hypot(hx, hy)
    reference = np.array([horizontal * math.cos(0.4), horizontal * math.sin(0.4), hz])

    def tilt(p: Quaternion) -> float:
        return 0.5 * float(np.sum((matrix_from_quat(p).T @ [0.0, 0.0, -1.0] - direction) ** 2))

    def north(p: Quaternion) -> float:
        return 0.5 * float(np.sum((matrix_from_quat(p).T @ reference - direction) ** 2))

    assert tilt_gradient(q, m) == pytest.approx(numeric_gradient(tilt, q), abs=1e-7)
    assert field_gradient(q, m, 0.4) == pytest.approx(numeric_gradient(north, q), abs=1e-7)


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_filter_converges_from_a_wrong_start(yaw_deg: int) -> None:
    q = quat_from_euler(0.2, -0.1, math.radians(yaw_deg))
    start = quat_multiply(quat_from_euler(-0.3, 0.3, 0.5), q)
    force, field = quat_rotate_inverse(q, DOWN_FORCE), quat_rotate_inverse(q, FIELD)
    estimate = MadgwickFilter(0.2, DECLINATION, start)
    for _ in range(3000):
        estimate.update_imu((0.0, 0.0, 0.0), force, 0.005)
        estimate.update_mag(field, 0.005)
    assert between_deg(estimate.attitude, q) < 0.3


def test_filter_follows_a_turn_by_the_gyroscope() -> None:
    q, estimate = IDENTITY, MadgwickFilter(0.05, DECLINATION, IDENTITY)
    rate: Vector3 = (0.3, -0.2, 0.8)
    for _ in range(2000):
        q = quat_integrate(q, rate, 0.005)
        estimate.update_imu(rate, quat_rotate_inverse(q, DOWN_FORCE), 0.005)
        estimate.update_mag(quat_rotate_inverse(q, FIELD), 0.005)
    assert between_deg(estimate.attitude, q) < 0.2


def test_vertical_field_error_does_not_tilt() -> None:
    estimate = MadgwickFilter(0.2, DECLINATION, IDENTITY)
    for _ in range(2000):
        estimate.update_imu((0.0, 0.0, 0.0), DOWN_FORCE, 0.005)
        estimate.update_mag((FIELD[0], FIELD[1], FIELD[2] + 15.0), 0.005)
    assert between_deg(estimate.attitude, IDENTITY) < 0.2


def test_nothing_measured_changes_nothing() -> None:
    estimate = MadgwickFilter(0.2, DECLINATION, quat_from_euler(0.1, 0.2, 0.3))
    before = estimate.attitude
    estimate.update_imu((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.005)
    estimate.update_mag((0.0, 0.0, 0.0), 0.005)
    assert estimate.attitude == pytest.approx(before, abs=1e-15)
