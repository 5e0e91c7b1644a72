"""What lasts between command and thrust is found, slowly; a biased accelerometer is not taken for it."""

import math

import pytest

from companion.base.geometry import GRAVITY_M_S2, Vector3
from companion.control.disturbance_observer import SlowDisturbanceObserver
from companion.control.response.flight_model import advance_axis

PERIOD_S = 1.0 / 30.0
TAU_S = 0.11
LAGS_S = (TAU_S, TAU_S, 0.04)
SENSOR_LAG_S = 0.035
BANDWIDTHS_RAD_S = (0.5, 0.5, 2.0)


def _observe(lasting: Vector3, bias: float, seconds: float, bound: float = 3.0) -> SlowDisturbanceObserver:
    """Fly the model itself with something on top, and measure its acceleration late and with a bias."""
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, bound, BANDWIDTHS_RAD_S)
    axes, shown = [(0.0, 0.0, 0.0)] * 3, [0.0, 0.0, 0.0]
    for k in range(round(seconds / PERIOD_S)):
        u = (math.sin(0.2 * k), 0.5, 0.0)
        for _ in range(20):
            axes = [advance_axis(axes[i], u[i] + lasting[i], PERIOD_S / 20, LAGS_S[i]) for i in range(3)]
            shown = [
                s + (axis[2] - s) * PERIOD_S / 20 / SENSOR_LAG_S for s, axis in zip(shown, axes, strict=True)
            ]
        observer.predict(u, PERIOD_S)
        measured = (shown[0] + bias, shown[1] + bias, shown[2] + bias)
        observer.correct((axes[0][1], axes[1][1], axes[2][1]), measured, measured, PERIOD_S)
    return observer


def test_finds_what_lasts_on_each_axis() -> None:
    assert _observe((1.0, -0.5, 0.2), 0.0, 20.0).lasting_ned_m_s2 == pytest.approx((1.0, -0.5, 0.2), abs=0.03)


def test_it_is_believed_as_fast_as_reported_and_no_faster() -> None:
    x, _, z = _observe((1.0, 0.0, 1.0), 0.0, 1.0).lasting_ned_m_s2
    assert x == pytest.approx(1.0 - math.exp(-0.5), abs=0.1)
    assert z == pytest.approx(1.0 - math.exp(-2.0), abs=0.1)


def test_a_biased_acceleration_is_reported_by_the_velocity() -> None:
    observer = _observe((0.4, 0.4, 0.4), 0.15, 25.0)
    assert observer.lasting_ned_m_s2 == pytest.approx((0.4, 0.4, 0.4), abs=0.03)
    assert observer.bias_ned_m_s2 == pytest.approx((0.15, 0.15, 0.15), abs=0.01)


def test_stays_within_its_bound() -> None:
    assert _observe((5.0, -5.0, 0.0), 0.0, 20.0, bound=2.0).lasting_ned_m_s2[:2] == (2.0, -2.0)


def test_a_jump_of_the_estimate_hardly_disturbs() -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    still = (0.0, 0.0, 0.0)
    for _ in range(30):
        observer.correct((5.0, 0.0, 0.0), still, still, PERIOD_S)
    assert abs(observer.lasting_ned_m_s2[0]) < 0.05


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_passes_over_a_measurement_that_is_not_finite(bad: float) -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    observer.start((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    still = (0.0, 0.0, 0.0)
    observer.correct((bad, 0.0, 0.0), still, still, PERIOD_S)
    observer.correct(still, (0.0, bad, 0.0), still, PERIOD_S)
    observer.correct(still, still, (0.0, bad, 0.0), PERIOD_S)
    assert observer.lasting_ned_m_s2 == (0.3, 0.0, 0.0)


def test_what_thrust_makes_is_known_anew_once_thrust_is_worth_more() -> None:
    observer = SlowDisturbanceObserver(LAGS_S, SENSOR_LAG_S, 3.0, BANDWIDTHS_RAD_S)
    observer.start((0.0, 0.0, 0.0), (1.0, 0.0, -GRAVITY_M_S2))  # twice the weight, tilted
    observer.scale_thrust(1.1)
    assert observer.made_ned_m_s2 == pytest.approx((1.1, 0.0, -1.2 * GRAVITY_M_S2))
    assert observer.delayed_response_down_m_s2 == pytest.approx(-1.2 * GRAVITY_M_S2)
