"""The ultrasonic's gate: spikes stay out, what is good passes at once."""

import math

import numpy as np
import pytest

from companion.base.messages import RangeSample
from companion.config import RangeConfig
from companion.sense.range.spike_filter import MARGIN_M, MARGIN_SHARE, SpikeFilter
from sitl.sensors.sensors import RangeErrors, RangeSensor

PERIOD_S = 0.08


def passed(distances_m: list[float | None], config: RangeConfig | None = None) -> list[float | None]:
    """What the gate makes of pings in a row; None is no echo."""
    gate = SpikeFilter(config or RangeConfig())
    out: list[float | None] = []
    for k, distance_m in enumerate(distances_m):
        sample = None if distance_m is None else gate.step(RangeSample(PERIOD_S * k, distance_m))
        out.append(None if sample is None else sample.distance_m)
    return out


def test_a_spike_alone_is_dropped_and_the_next_sample_passes_as_it_is() -> None:
    assert passed([2.0, 2.0, 2.0, 0.7, 2.0, 2.01]) == [None, 2.0, 2.0, None, 2.0, 2.01]


def test_two_different_spikes_in_a_row_are_dropped() -> None:
    assert passed([2.0, 2.0, 0.4, 1.2, 2.0]) == [None, 2.0, None, None, 2.0]


def test_a_step_that_stays_costs_one_sample() -> None:
    """Over the pad's edge."""
    assert passed([2.0, 2.0, 1.4, 1.41, 1.4]) == [None, 2.0, None, 1.41, 1.4]


def test_echoes_that_are_lost_in_between_cost_nothing_more() -> None:
    assert passed([2.0, 2.0, None, None, 2.05, None, 2.1]) == [None, 2.0, None, None, 2.05, None, 2.1]


def test_after_a_long_silence_two_have_to_agree_again() -> None:
    assert passed([2.0, 2.0, *[None] * 20, 1.0, 1.0]) == [None, 2.0, *[None] * 20, None, 1.0]


@pytest.mark.parametrize("speed_m_s", [0.3, 1.0, 2.0, 2.9])
@pytest.mark.parametrize("direction", [-1, 1])
def test_good_data_at_any_speed_of_flight_passes_without_lag(speed_m_s: float, direction: int) -> None:
    start_m = 4.0 if direction < 0 else 0.1
    steps = int(3.5 / (speed_m_s * PERIOD_S))
    path: list[float | None] = [start_m + direction * speed_m_s * PERIOD_S * k for k in range(steps)]
    assert passed(path)[1:] == path[1:]


def test_with_a_sensors_own_noise_hardly_a_good_sample_is_held_back() -> None:
    sensor = RangeSensor(RangeErrors(lost=0.0, spikes=0.0), np.random.default_rng(2))
    path = [sensor.sample(3.0 - 1.0 * PERIOD_S * k) for k in range(35)] * 20
    held = sum(value is None for value in passed(path))
    assert held <= 0.05 * len(path) + 20  # each of the twenty runs begins with a step


@pytest.mark.parametrize("spikes", [0.01, 0.05, 0.15])
def test_of_many_spikes_few_pass_and_those_are_small(spikes: float) -> None:
    """GIVEN a descent from 4 m THEN nothing that passes is farther off than the gate is wide.

    Two spikes in a row that agree are believed; at a share p of spikes, evenly spread, that is about p² times
    the gate's width over the distance. The estimator's innovation gate has the rest.
    """
    rng = np.random.default_rng(3)
    sensor = RangeSensor(RangeErrors(spikes=spikes), rng)
    worse = total = 0
    for _ in range(40):
        truth = [4.0 - 0.6 * PERIOD_S * k for k in range(75)]
        for value, true in zip(passed([sensor.sample(d) for d in truth]), truth, strict=True):
            if value is None:
                continue
            total += 1
            allowed = 3.0 * 2 * PERIOD_S + MARGIN_M + MARGIN_SHARE * true + 0.05
            worse += abs(value - true) > allowed
    assert total > 40 * 75 * (1.0 - 2.0 * spikes - 0.1)
    assert worse / total < spikes * spikes + 1e-9


def test_without_the_gate_spikes_reach_the_estimator() -> None:
    """What the gate is there for: the simulated sensor does have them."""
    sensor = RangeSensor(RangeErrors(spikes=0.05), np.random.default_rng(3))
    wild = [d for d in (sensor.sample(3.0) for _ in range(1000)) if d is not None and abs(d - 3.0) > 0.5]
    assert len(wild) == pytest.approx(40, abs=20)


@pytest.mark.parametrize("speed_m_s", [1.0, 5.0])
def test_the_setting_is_the_fastest_change_that_is_believed(speed_m_s: float) -> None:
    config = RangeConfig(maximum_speed_m_s=speed_m_s)
    margin = MARGIN_M + MARGIN_SHARE * 2.0
    for factor, believed in ((0.99, True), (1.01, False)):
        jump = factor * (speed_m_s * PERIOD_S + margin)
        result = passed([2.0, 2.0, 2.0 - jump], config)[-1]
        assert (result is not None) == believed
        assert result is None or math.isclose(result, 2.0 - jump)
