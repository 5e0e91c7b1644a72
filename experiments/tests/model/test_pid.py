"""The cascade: feed-forward, integral and its bounds, axes and signs, on the paper's model."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, ZERO3, FloatArray
from companion.base.motion import Motion
from companion.config import ConfigError
from experiments.model.pid import (
    AttitudePid,
    AxisGains,
    CascadedPid,
    PositionPid,
    load_gains,
)
from experiments.model.quadrotor import PHI, POSITION, PSI, THETA, VELOCITY, Z, load_quadrotor

GAINS = load_gains("pid")
MODEL = load_quadrotor("x500")
AXIS = AxisGains(position_1_s=2.0, velocity_1_s=3.0, integral_1_s2=1.0)
TILT_RAD = math.radians(30.0)


def outer(largest_m_s2: float = 4.0) -> PositionPid:
    return PositionPid(AXIS, AXIS, largest_m_s2)


def test_on_the_reference_only_its_acceleration_is_asked_for() -> None:
    target = Motion((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.5, -0.5, 0.25))
    assert outer().step(target.position_m, target.velocity_m_s, target, 0.02) == target.acceleration_m_s2


def test_an_error_pulls_through_position_velocity_and_integral() -> None:
    asked = outer().step((0.0, 0.0, 0.0), ZERO3, Motion((0.1, 0.0, 0.0)), 0.02)
    wanted = 2.0 * 0.1
    assert asked == pytest.approx((3.0 * wanted + 1.0 * wanted * 0.02, 0.0, 0.0))


def test_the_integral_is_bounded_and_forgotten() -> None:
    pid = outer(largest_m_s2=0.5)
    for _ in range(1000):
        pid.step(ZERO3, ZERO3, Motion((1.0, -1.0, 0.0)), 0.02)
    assert pid.integral_m_s2 == [0.5, -0.5, 0.0]
    pid.reset()
    assert pid.integral_m_s2 == [0.0, 0.0, 0.0]


def test_the_integral_does_not_grow_towards_what_was_cut() -> None:
    pid, target = outer(), Motion((1.0, 1.0, 0.0))
    asked = pid.step(ZERO3, ZERO3, target, 0.02)
    held = pid.integral_m_s2.copy()
    pid.clipped(asked, (asked[0] - 1.0, asked[1], asked[2]))
    pid.step(ZERO3, ZERO3, target, 0.02)
    assert pid.integral_m_s2[0] == held[0]
    assert pid.integral_m_s2[1] > held[1]
    pid.step(ZERO3, ZERO3, Motion((-1.0, 1.0, 0.0)), 0.02)
    assert pid.integral_m_s2[0] < held[0]


def test_limits_keep_what_carries_the_vehicle() -> None:
    inner = AttitudePid(GAINS, MODEL, TILT_RAD)
    ax, ay, az = inner.limited((30.0, 40.0, 1.0))
    assert az == 1.0
    assert math.hypot(ax, ay) == pytest.approx(math.tan(TILT_RAD) * (GRAVITY_M_S2 + 1.0))
    assert ay / ax == pytest.approx(4.0 / 3.0)
    assert inner.limited((0.0, 0.0, -50.0))[2] == pytest.approx(-0.7 * GRAVITY_M_S2)
    assert inner.limited((0.0, 0.0, 50.0))[2] < 0.95 * 4.0 * MODEL.full_rotor_thrust_n / MODEL.mass_kg


@pytest.mark.parametrize("heading_rad", [0.0, math.pi / 2.0, math.pi, -2.0])
def test_the_wanted_tilt_pushes_where_it_was_asked(heading_rad: float) -> None:
    """In closed loop with the model: after a second it accelerates as asked, whatever its heading."""
    inner, state = AttitudePid(GAINS, MODEL, TILT_RAD), np.zeros(12)
    state[PSI] = heading_rad
    asked = (1.5, -0.8, 0.4)
    for _ in range(100):
        state = MODEL.advance(state, inner.step(state, asked, heading_rad, 0.01), 0.01)
    slope = MODEL.derivative(state, inner.step(state, asked, heading_rad, 0.01))
    assert np.allclose(slope[VELOCITY], asked, atol=0.1)
    assert abs(state[PHI]) < TILT_RAD
    assert abs(state[THETA]) < TILT_RAD


def flown(push: FloatArray, seconds: float) -> FloatArray:
    pid, state = CascadedPid(GAINS, MODEL, TILT_RAD), np.zeros(12)
    state[Z] = 5.0
    for _ in range(round(seconds / 0.02)):
        inputs = pid.step(state, Motion((1.0, -1.0, 5.5)), 0.0, 0.02)
        state = MODEL.advance(state, inputs, 0.02)
        state[VELOCITY] += push * 0.02
    return state


def test_a_step_settles_and_a_lasting_push_leaves_nothing() -> None:
    state = flown(np.array([0.8, -0.5, -0.6]), 20.0)
    assert np.allclose(state[POSITION], (1.0, -1.0, 5.5), atol=0.03)


def test_gains_out_of_range_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "gains.yaml"
    path.write_text("horizontal: {position_1_s: -1.0, velocity_1_s: 3.0, integral_1_s2: 1.0}\n")
    with pytest.raises(ConfigError, match=r"horizontal\.position_1_s: expected"):
        load_gains(path)
