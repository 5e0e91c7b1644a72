"""The disturbance observer finds what pushes, and is not fooled by a biased accelerometer."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from companion.control.disturbance import DisturbanceObserver, ThrustScale, stationary_gain, transition
from companion.control.flight_model import advance_axis
from companion.geometry import Vector3

PERIOD_S = 1.0 / 30.0
TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
SENSOR_LAG_S = 0.035


def _observe(push: Vector3, bias: float, seconds: float, bound: float = 3.0) -> DisturbanceObserver:
    """Fly the model itself under a push, and measure its acceleration late and with a bias."""
    observer = DisturbanceObserver(PERIOD_S, LAGS_S, SENSOR_LAG_S, bound)
    observer.start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    axes, shown = [(0.0, 0.0, 0.0)] * 3, [0.0, 0.0, 0.0]
    for k in range(round(seconds / PERIOD_S)):
        u = (math.sin(0.2 * k), 0.5, 0.0)
        for _ in range(20):
            axes = [advance_axis(axes[i], u[i] + push[i], PERIOD_S / 20, LAGS_S[i]) for i in range(3)]
            shown = [
                s + (axis[2] - s) * PERIOD_S / 20 / SENSOR_LAG_S for s, axis in zip(shown, axes, strict=True)
            ]
        observer.predict(u, PERIOD_S)
        measured = (shown[0] + bias, shown[1] + bias, shown[2] + bias)
        observer.correct((axes[0][1], axes[1][1], axes[2][1]), measured)
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
    observer = DisturbanceObserver(PERIOD_S, LAGS_S, SENSOR_LAG_S, 3.0)
    observer.start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    observer.correct((5.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert abs(observer.disturbance_ned_m_s2[0]) < 1.0
    observer.predict((0.0, 0.0, 0.0), PERIOD_S)
    observer.correct((5.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert observer.velocity_ned_m_s[0] == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_passes_over_a_measurement_that_is_not_finite(bad: float) -> None:
    observer = DisturbanceObserver(PERIOD_S, LAGS_S, SENSOR_LAG_S, 3.0)
    observer.start((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    observer.correct((bad, 0.0, 0.0), (0.0, 0.0, 0.0))
    observer.correct((0.0, 0.0, 0.0), (0.0, bad, 0.0))
    assert observer.velocity_ned_m_s == (1.0, 0.0, 0.0)
    assert observer.disturbance_ned_m_s2 == (0.3, 0.0, 0.0)


def test_the_observers_errors_die_away() -> None:
    for lag_s in LAGS_S:
        F, gain = (
            transition(PERIOD_S, lag_s, SENSOR_LAG_S),
            stationary_gain(PERIOD_S, lag_s, SENSOR_LAG_S),
        )
        H = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 1.0]])
        assert np.abs(np.linalg.eigvals((np.eye(5) - gain @ H) @ F)).max() < 0.995


def test_transition_is_the_lagged_answer_and_the_late_sensor() -> None:
    F = transition(0.005, TAU_S, SENSOR_LAG_S)
    continuous = np.zeros((5, 5))
    continuous[0, 1] = 1.0
    continuous[1, 1], continuous[1, 2] = -1.0 / TAU_S, 1.0 / TAU_S
    continuous[4, 1], continuous[4, 4] = 1.0 / SENSOR_LAG_S, -1.0 / SENSOR_LAG_S
    np.testing.assert_allclose(F, expm(0.005 * continuous), atol=2e-3)


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
