"""The closed loop in which controllers are compared and tuned."""

from dataclasses import replace

import numpy as np
import pytest

from companion.base.messages import Setpoint
from companion.config import ControlConfig
from experiments import tune_flight_pid
from experiments.tune_flight_pid import CASES, TrackingLoop, _streamed


def test_the_app_s_controller_tracks_in_the_simulated_world_and_repeats() -> None:
    first, again = (TrackingLoop(ControlConfig(), CASES[2], 3).fly(4.0) for _ in range(2))
    np.testing.assert_array_equal(first.error_m, again.error_m)
    assert first.error_m[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert max(first.rmse_m()) < 0.15
    assert np.abs(first.error_m).max() > 1e-3


def test_another_seed_is_another_flight() -> None:
    one, other = (TrackingLoop(ControlConfig(), CASES[0], seed).fly(1.0) for seed in (1, 2))
    assert not np.array_equal(one.error_m, other.error_m)


def test_gains_are_of_the_third_order_polynomial() -> None:
    gains = tune_flight_pid.gains_of(np.array([2.0, 0.75, 0.25]))
    assert gains.position_gain_1_s2 == 4.0
    assert gains.velocity_gain_1_s == 3.0
    assert gains.integral_gain_1_s3 == 2.0


def test_training_and_held_out_seeds_do_not_meet() -> None:
    assert not set(tune_flight_pid.TRAINING_SEEDS) & set(tune_flight_pid.HELD_OUT_SEEDS)


def test_the_autopilot_hears_the_velocity_only_as_far_as_it_is_sent() -> None:
    sent = Setpoint(0.0, velocity_ned_m_s=(1.0, 2.0, 3.0), holds_horizontal_velocity=False)
    north, east, down = _streamed(sent).velocity_ned_m_s
    assert np.isnan([north, east]).all()
    assert down == 3.0
    assert _streamed(replace(sent, holds_horizontal_velocity=True)).velocity_ned_m_s == (1.0, 2.0, 3.0)
