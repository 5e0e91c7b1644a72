"""The observer of what pushes: it finds a force, a wrong mass and a torque, and bounds what it says."""

from __future__ import annotations

import numpy as np
import pytest

from companion.control.full_mpc import load_full
from companion.control.nominal import push_effect
from companion.control.push import PushObserver, stationary_gain
from companion.control.quadrotor import STATES, load_quadrotor
from companion.geometry import FloatArray

MODEL = load_quadrotor("x500")
CONFIG = load_full("full").push
PERIOD_S = 0.02


def observed(push: FloatArray, steps: int = 150, thrust_share: float = 1.0) -> FloatArray:
    """What is estimated of a vehicle that hovers by its inputs and is pushed."""
    observer, state = PushObserver(CONFIG, MODEL, PERIOD_S), np.zeros(STATES)
    for _ in range(steps):
        observer.step(state, MODEL.hover)
        state = MODEL.advance(state, thrust_share * MODEL.hover, PERIOD_S) + push_effect(push, PERIOD_S)
        state[6:] = 0.0 if not push[3:].any() else state[6:]
    return observer.push


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
    quick, slow = (stationary_gain(PERIOD_S, 0.04, 0.02, walk) for walk in (2.0, 0.2))
    assert 0.0 < slow[0] < quick[0] < 1.0
    assert 0.0 < slow[1] < quick[1]
