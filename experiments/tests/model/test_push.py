"""The observer of what pushes: it finds a force, a wrong mass and a torque, and bounds what it says."""

import numpy as np
import pytest

from companion.base.geometry import FloatArray
from experiments.model.disturbance_filter import DisturbanceFilter, disturbance_effect, stationary_gain
from experiments.model.full_mpc import load_full
from experiments.model.quadrotor import PSI, STATES, load_quadrotor

MODEL = load_quadrotor("x500")
CONFIG = load_full("full").push
PERIOD_S = 0.02


def observed(disturbance: FloatArray, steps: int = 150, thrust_share: float = 1.0) -> FloatArray:
    """What is estimated of a vehicle that hovers by its inputs and is pushed."""
    observer, state = DisturbanceFilter(CONFIG, MODEL, PERIOD_S), np.zeros(STATES)
    for _ in range(steps):
        observer.step(state, MODEL.hover)
        state = MODEL.advance(state, thrust_share * MODEL.hover, PERIOD_S) + disturbance_effect(
            disturbance, PERIOD_S
        )
        state[6:] = 0.0 if not disturbance[3:].any() else state[6:]
    return observer.disturbance


def test_a_force_is_found() -> None:
    assert np.allclose(
        observed(np.array([1.0, -2.0, 0.5, 0.0, 0.0, 0.0])), [1.0, -2.0, 0.5, 0, 0, 0], atol=0.05
    )


def test_a_mass_that_is_off_is_found_as_the_acceleration_it_takes() -> None:
    found = observed(np.zeros(6), thrust_share=0.9)
    assert found[2] == pytest.approx(-0.1 * 9.80665, abs=0.03)


def test_a_torque_is_found_slowly() -> None:
    found = observed(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.05]), steps=400)
    assert found[5] == pytest.approx(0.05, abs=0.01)


def test_what_it_says_is_bounded() -> None:
    found = observed(np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert found[0] == CONFIG.largest_force_m_s2


def test_the_gain_follows_the_walk() -> None:
    quick, slow = (stationary_gain(PERIOD_S, (0.02, 0.04), (0.02, walk)) for walk in (2.0, 0.2))
    assert (slow[0] > 0.0).all()
    assert (slow[1:, 1] < quick[1:, 1]).all()
    assert (quick[:2, :] < 1.0).all()


def test_noise_is_filtered_and_a_half_turn_is_no_innovation() -> None:
    rng = np.random.default_rng(5)
    std = np.zeros(STATES)
    std[[0, 2, 4]], std[[1, 3, 5]] = CONFIG.position_noise_m, CONFIG.velocity_noise_m_s
    std[[6, 8, 10]], std[[7, 9, 11]] = CONFIG.angle_noise_rad, CONFIG.rate_noise_rad_s
    truth = np.zeros(STATES)
    truth[PSI] = np.pi
    observer, off = DisturbanceFilter(CONFIG, MODEL, PERIOD_S), []
    for _ in range(500):
        measured = truth + std * rng.standard_normal(STATES)
        measured[PSI] = np.arctan2(np.sin(measured[PSI]), np.cos(measured[PSI]))
        error = observer.step(measured, MODEL.hover) - truth
        error[PSI] = np.arctan2(np.sin(error[PSI]), np.cos(error[PSI]))
        off.append(error)
    left = np.std(off[100:], axis=0) / std
    assert left.max() < 0.75, left
