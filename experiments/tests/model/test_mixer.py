"""U to motors: what is flown is what was asked, the range is kept, the lag is made up for."""

import math

import numpy as np
import pytest

from companion.base.geometry import FloatArray
from experiments.model.quadrotor import ThrustMixer, load_quadrotor

MODEL = load_quadrotor("x500")
PERIOD_S = 0.02


def settled(inputs: FloatArray, lead: float = 0.3) -> ThrustMixer:
    mixer = ThrustMixer(MODEL, PERIOD_S, lead)
    for _ in range(100):
        mixer.step(inputs)
    return mixer


def test_hover_is_each_rotors_share_of_the_weight() -> None:
    shares = ThrustMixer(MODEL, PERIOD_S, 0.3).step(MODEL.hover)
    assert np.allclose(shares, MODEL.hover[0] / (4.0 * MODEL.full_rotor_thrust_n))


def test_what_lasts_is_flown() -> None:
    inputs = np.add(MODEL.hover, (1.0, 0.1, -0.2, 0.02))
    assert np.allclose(settled(inputs).flown, inputs)


@pytest.mark.parametrize("lead", [0.0, 0.5, 1.0])
def test_the_lead_makes_up_for_the_lag(lead: float) -> None:
    """With all of it the motors are there after one period, with none they go as they do."""
    mixer, more = ThrustMixer(MODEL, PERIOD_S, lead), np.add(MODEL.hover, (2.0, 0.0, 0.0, 0.0))
    mixer.step(more)
    mixer.step(more)  # the mean over this period begins where the first ended
    left = math.exp(-PERIOD_S / MODEL.config.motor_time_constant_s)
    reached = (mixer.flown[0] - MODEL.hover[0]) / 2.0
    assert reached == pytest.approx(1.0, abs=1e-9) if lead == 1.0 else 1.0 - left < reached < 1.0


def test_tilting_goes_before_height() -> None:
    """Full climb and a roll: the thrust of all gives way, the torque stays."""
    inputs = np.array([4.0 * MODEL.full_rotor_thrust_n, 0.5, 0.0, 0.0])
    flown = settled(inputs).flown
    assert flown[1] == pytest.approx(0.5)
    assert flown[0] < inputs[0]


def test_what_no_shift_can_give_is_clipped() -> None:
    shares = ThrustMixer(MODEL, PERIOD_S, 0.0).step(np.add(MODEL.hover, (0.0, 50.0, 0.0, 0.0)))
    assert all(0.0 <= share <= 1.0 for share in shares)
