"""The polytope of the MPC's inputs: all within every limit, and hardly anything of that given away."""

import math

import numpy as np
import pytest

from companion.base.geometry import GRAVITY_M_S2, FloatArray, tilt_from_quat, vector3
from companion.base.messages import Setpoint
from companion.config import LimitsConfig
from companion.control.attitude import attitude_from_acceleration, thrust_from_acceleration
from companion.control.limits import LimitsGate
from companion.control.mpc.input_bounds import input_bounds, input_rows, shrunk

LIMITS = LimitsConfig()


def _allowed(limits: LimitsConfig, hover_thrust: float, count: int = 3000) -> FloatArray:
    """Inputs on the polytope's surface, in directions from everywhere."""
    rows, (lower, upper) = input_rows(limits), input_bounds(limits, hover_thrust)
    directions = np.random.default_rng(1).normal(size=(count, 3))
    return np.array([shrunk(1e3 * each, rows, lower, upper) for each in directions])


@pytest.mark.parametrize("tilt_deg", [10.0, 25.0, 45.0])
@pytest.mark.parametrize("hover_thrust", [0.3, 0.5, 0.75])
def test_the_gate_cuts_nothing_that_is_allowed(tilt_deg: float, hover_thrust: float) -> None:
    limits = LimitsConfig(
        tilt_deg=tilt_deg, horizontal_acceleration_m_s2=10.0, vertical_acceleration_m_s2=8.0
    )
    for u in _allowed(limits, hover_thrust, 400):
        wanted = vector3(u.tolist())
        setpoint = Setpoint(
            0.0,
            acceleration_ned_m_s2=wanted,
            attitude=attitude_from_acceleration(wanted, 0.0),
            thrust=thrust_from_acceleration(wanted, hover_thrust),
        )
        assert LimitsGate(limits).apply(setpoint, 0.0)[1] == ()
        assert tilt_from_quat(attitude_from_acceleration(wanted, 0.0)) <= math.radians(tilt_deg) + 1e-9


def test_hardly_anything_is_given_away() -> None:
    u = _allowed(LIMITS, 0.5)
    assert np.abs(u[:, 2]).max() == pytest.approx(LIMITS.vertical_acceleration_m_s2)
    assert np.hypot(u[:, 0], u[:, 1]).max() > 0.98 * LIMITS.horizontal_acceleration_m_s2
    strong = LimitsConfig(vertical_acceleration_m_s2=8.0)
    force = np.linalg.norm(_allowed(strong, 0.75) - [0.0, 0.0, GRAVITY_M_S2], axis=1)
    most = strong.maximum_thrust / 0.75 * GRAVITY_M_S2
    assert 0.97 * most < force.max() <= most


def test_a_vehicle_that_lets_itself_fall_may_push_less_to_the_side() -> None:
    rows, (lower, upper) = input_rows(LIMITS), input_bounds(LIMITS, 0.5)
    level, falling = (shrunk(np.array([8.0, 0.0, z]), rows, lower, upper) for z in (0.0, 5.0))
    assert level[0] == pytest.approx(LIMITS.horizontal_acceleration_m_s2 * math.cos(math.pi / 8))
    tilt = math.degrees(math.atan(falling[0] / (GRAVITY_M_S2 - falling[2])))
    assert 0.9 * LIMITS.tilt_deg < tilt < LIMITS.tilt_deg


@pytest.mark.parametrize("hover_thrust", [0.05, 0.1, 0.9, 1.3])
def test_whatever_was_learnt_hovering_is_allowed(hover_thrust: float) -> None:
    lower, upper = input_bounds(LimitsConfig(minimum_thrust=0.5, maximum_thrust=0.6), hover_thrust)
    assert (upper > 0.0).all()
    assert (lower < 0.0).all()


def test_planes_that_others_imply_are_left_out() -> None:
    assert np.isinf(input_bounds(LIMITS, 0.5)[1][13:]).all()  # 0.9 of full thrust is out of reach
    assert np.isfinite(input_bounds(LIMITS, 0.8)[1][13:]).all()
