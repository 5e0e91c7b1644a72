"""The disturbance observer finds what pushes, and is not fooled by a biased accelerometer."""

import math

import numpy as np
import pytest

from companion.control.disturbance import DisturbanceObserver, ThrustScale, stationary_gain
from companion.control.flight_model import advance_axis
from companion.geometry import Vector3

PERIOD_S = 1.0 / 30.0
TAU_S = 0.18


def _observe(push: Vector3, bias: float, seconds: float, bound: float = 3.0) -> DisturbanceObserver:
    observer = DisturbanceObserver(PERIOD_S, TAU_S, bound)
    observer.start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    axes = [(0.0, 0.0, 0.0)] * 3
    for k in range(round(seconds / PERIOD_S)):
        u = (math.sin(0.2 * k), 0.5, 0.0)
        axes = [advance_axis(axes[i], u[i] + push[i], PERIOD_S, TAU_S) for i in range(3)]
        observer.predict(u, PERIOD_S)
        observer.correct(
            (axes[0][1], axes[1][1], axes[2][1]), (axes[0][2] + bias, axes[1][2] + bias, axes[2][2] + bias)
        )
    return observer


def test_finds_a_constant_push_on_each_axis() -> None:
    observer = _observe((1.0, -0.5, 0.2), 0.0, 4.0)
    assert observer.disturbance_ned_m_s2 == pytest.approx((1.0, -0.5, 0.2), abs=0.02)


def test_a_gust_is_mostly_found_within_half_a_second() -> None:
    assert _observe((1.0, 0.0, 0.0), 0.0, 0.5).disturbance_ned_m_s2[0] > 0.6


def test_a_biased_acceleration_is_not_taken_for_a_push() -> None:
    observer = _observe((0.4, 0.4, 0.4), 0.15, 12.0)
    assert observer.disturbance_ned_m_s2 == pytest.approx((0.4, 0.4, 0.4), abs=0.03)


def test_stays_within_its_bound() -> None:
    observer = _observe((5.0, -5.0, 0.0), 0.0, 3.0, bound=2.0)
    assert observer.disturbance_ned_m_s2[:2] == (2.0, -2.0)


def test_a_jump_of_the_estimate_hardly_disturbs() -> None:
    observer = DisturbanceObserver(PERIOD_S, TAU_S, 3.0)
    observer.start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    observer.correct((5.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert abs(observer.disturbance_ned_m_s2[0]) < 1.0
    observer.predict((0.0, 0.0, 0.0), PERIOD_S)
    observer.correct((5.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert observer.velocity_ned_m_s[0] == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_passes_over_a_measurement_that_is_not_finite(bad: float) -> None:
    observer = DisturbanceObserver(PERIOD_S, TAU_S, 3.0)
    observer.start((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    observer.correct((bad, 0.0, 0.0), (0.0, 0.0, 0.0))
    observer.correct((0.0, 0.0, 0.0), (0.0, bad, 0.0))
    assert observer.velocity_ned_m_s == (1.0, 0.0, 0.0)
    assert observer.disturbance_ned_m_s2 == (0.3, 0.0, 0.0)


def test_the_observers_errors_die_away() -> None:
    gain = stationary_gain(PERIOD_S, TAU_S)
    F = np.eye(4)
    for column in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[column] = 1.0
        _, v, a = advance_axis((0.0, unit[0], unit[1]), unit[2], PERIOD_S, TAU_S)
        F[:2, column] = v, a
    H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    assert np.abs(np.linalg.eigvals((np.eye(4) - gain @ H) @ F)).max() < 0.995


def test_thrust_scale_takes_over_a_lasting_vertical_push() -> None:
    scale, weak, push = ThrustScale(), 0.9, 0.0
    for _ in range(600):
        # the observer's estimate is what the scale has not covered yet
        push = 9.80665 * (1.0 - weak * scale.factor)
        scale.learn(push, PERIOD_S)
    assert scale.factor == pytest.approx(1.0 / weak, rel=0.01)
    assert abs(push) < 0.05


def test_thrust_scale_is_bounded_and_covers_only_what_it_took() -> None:
    scale = ThrustScale()
    for _ in range(2000):
        covered = scale.learn(3.0, PERIOD_S)
    assert scale.factor == ThrustScale.BOUNDS[1]
    assert covered == 0.0
