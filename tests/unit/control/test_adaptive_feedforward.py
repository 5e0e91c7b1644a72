"""What the vehicle does not fly of the pad's acceleration is learnt from the feedback; nothing else is."""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from companion.base.geometry import ZERO3, Vector3
from companion.base.messages import Setpoint
from companion.config import ControlConfig
from companion.control.adaptive_feedforward import (
    FASTEST_TURN_SHARE,
    LARGEST_EFFORT_M_S2,
    LARGEST_SHARE,
    AdaptiveFeedforward,
    learning_s,
)
from companion.control.attitude import attitude_from_acceleration
from companion.control.response.fitting import loop_rad_s
from tests.unit.control.control_plants import Loop, Motion3, controller, line, still
from tests.unit.control.control_vehicles import PointMass, SwayingAutopilot

WEIGHTS = ControlConfig().horizontal
SPEED_M_S, RATE_RAD_S, PERIOD_S = 1.5, 0.7, 1.0 / 30.0
GAIN = 1.25


@dataclass
class TooKeen(SwayingAutopilot):
    """Tilts further than it is asked to, as ArduCopter does."""

    def force(self, vehicle: PointMass, setpoint: Setpoint, time_s: float, dt_s: float) -> Vector3:
        x, y, down = super().force(vehicle, setpoint, time_s, dt_s)
        vehicle.attitude = attitude_from_acceleration((GAIN * x, GAIN * y, 0.0), 0.0)
        return (GAIN * x, GAIN * y, down)


def turning(time_s: float, rate_rad_s: float = RATE_RAD_S) -> tuple[Vector3, Vector3]:
    """Velocity and acceleration of a pad on a circle."""
    v = SPEED_M_S * cmath.exp(1j * rate_rad_s * time_s)
    a = 1j * rate_rad_s * v
    return (v.real, v.imag, 0.0), (a.real, a.imag, 0.0)


def tight_circle(time_s: float) -> Motion3:
    """The same with its place."""
    radius_m = SPEED_M_S / RATE_RAD_S
    c, s = math.cos(RATE_RAD_S * time_s), math.sin(RATE_RAD_S * time_s)
    return (radius_m * s, radius_m * (1.0 - c), 0.0), *turning(time_s)


def taught(
    missing: Callable[[complex], complex], *, rate_rad_s: float = RATE_RAD_S, duration_s: float = 30.0
) -> AdaptiveFeedforward:
    """After feedback that makes up for what is missing of the pad's acceleration and is not fed forward."""
    learner = AdaptiveFeedforward(WEIGHTS)
    for k in range(round(duration_s / PERIOD_S)):
        velocity, acceleration = turning(k * PERIOD_S, rate_rad_s)
        fed = learner.missing_m_s2(acceleration)
        left = missing(complex(*acceleration[:2])) - complex(*fed[:2])
        learner.learn((left.real, left.imag, 0.3), velocity, acceleration, PERIOD_S)
    return learner


@pytest.mark.parametrize("share", [0.1, -0.15, 0.12j, 0.1 - 0.1j])
def test_a_scale_and_a_lag_are_learnt_to_the_full(share: complex) -> None:
    assert taught(lambda a: share * a).share == pytest.approx(share, abs=2e-3)


def test_it_takes_as_long_as_the_margins_are_computed_with() -> None:
    noise_costs = 1.0 / (1.0 + (0.3 / (SPEED_M_S * RATE_RAD_S)) ** 2)
    after = taught(lambda a: 0.1 * a, duration_s=learning_s(WEIGHTS)).share
    assert after.real == pytest.approx(0.1 * (1.0 - math.exp(-noise_costs)), rel=0.02)


def test_it_learns_no_more_than_a_quarter() -> None:
    assert abs(taught(lambda a: 0.5 * a).share) == pytest.approx(LARGEST_SHARE)


def test_a_pad_that_turns_too_fast_for_the_loop_teaches_nothing() -> None:
    fastest_rad_s = FASTEST_TURN_SHARE * loop_rad_s(WEIGHTS)
    assert taught(lambda a: 0.1 * a, rate_rad_s=1.01 * fastest_rad_s).share == 0j
    assert taught(lambda a: 0.1 * a, rate_rad_s=0.99 * fastest_rad_s).share != 0j


@pytest.mark.parametrize("effort", [(1.01 * LARGEST_EFFORT_M_S2, 0.0, 0.0), (math.nan, 0.0, 0.0)])
def test_the_way_back_to_the_reference_teaches_nothing(effort: Vector3) -> None:
    learner = AdaptiveFeedforward(WEIGHTS)
    learner.learn(effort, *turning(0.0), PERIOD_S)
    assert learner.share == 0j


def test_a_pad_that_does_not_accelerate_teaches_nothing() -> None:
    learner = AdaptiveFeedforward(WEIGHTS)
    learner.learn((0.5, -0.3, 0.0), (2.0, 0.0, 0.0), ZERO3, PERIOD_S)
    assert learner.share == 0j
    assert learner.missing_m_s2((1.0, 2.0, 3.0)) == ZERO3


def test_a_vehicle_that_tilts_too_far_stays_over_a_pad_on_a_circle() -> None:
    loop = Loop(controller(setpoint="attitude"), TooKeen(), tight_circle, still, noise=0.0)
    loop.velocity_bias = loop.acceleration_bias = ZERO3
    flight = loop.fly(25.0)
    assert flight.lateral_error_m(1.5) > 0.015
    assert flight.lateral_error_m(20.0) < 0.008


def test_over_a_pad_that_drives_straight_on_it_is_as_ever() -> None:
    flying = controller(setpoint="attitude")
    Loop(flying, TooKeen(), line, still, noise=0.0).fly(4.0)
    assert flying._feedforward.share == 0j
