"""The simulated flight controller at its limits: nothing winds up there that would be flown afterwards."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import IDENTITY, ZERO3
from companion.base.messages import LandedState
from sitl.autopilot.control.cascade import Cascade
from sitl.autopilot.control.estimator import NO_ERRORS, SimulatedEstimator
from sitl.autopilot.control.setpoints import AttitudeSetpoint, MotionSetpoint
from sitl.autopilot.flight.autopilot import PROFILES
from sitl.autopilot.flight.modes import CommandResult
from tests.unit.sitl.autopilot.autopilot_flight import (
    STAND_STILL,
    AutopilotFlight,
    frame_450,
    landed_state,
    set_down,
    velocity,
)

HOVER = 0.36
STEP_S = 0.01


def test_it_stops_soon_however_long_it_could_not_fly_as_fast_as_asked(airborne: AutopilotFlight) -> None:
    airborne.vehicle.wind_ned_m_s = (-18.0, 0.0, 0.0)
    reached = airborne.run(15.0, velocity(14.0))[-1]
    assert reached.velocity[0] < 13.0  # the tilt is at its limit
    stopped = airborne.run(12.0, STAND_STILL)
    furthest = max(stopped, key=lambda sample: sample.position[0])
    assert furthest.position[0] - reached.position[0] < 20.0
    assert furthest.time_s - reached.time_s < 6.0
    assert math.dist(stopped[-1].velocity, ZERO3) < 0.3


def test_ardupilots_tilt_goes_on_at_its_limit_and_is_reported() -> None:
    control: Any = PROFILES["ardupilot"].position_control(HOVER)
    told = []
    for _ in range(300):  # held back by whatever it is
        control.step((ZERO3, ZERO3, ZERO3), velocity(10.0), STEP_S)
        told.append(control.saturated)
    assert not told[0]
    assert all(told[200:])


@pytest.mark.parametrize("pressed_s", [1.0, 6.0])
def test_a_climb_raises_the_thrust_as_soon_however_long_it_stood_pressed_down(
    autopilot_kind: AutopilotKind, pressed_s: float
) -> None:
    control = PROFILES[autopilot_kind].position_control(HOVER)

    def hold(wanted: MotionSetpoint) -> None:
        control.step((ZERO3, ZERO3, ZERO3), dataclasses.replace(wanted, streamed=True), STEP_S)

    for _ in range(round(pressed_s / STEP_S)):
        hold(velocity(0.0, 0.0, 1.0))
    needed = 0
    while control.thrust < 1.01 * HOVER:
        hold(velocity(0.0, 0.0, -1.0))
        needed += 1
    # ArduPilot's path turns round at WPNAV_ACCEL_Z, 1 m/s²
    assert needed * STEP_S < (0.1 if autopilot_kind == "px4" else 1.8)


@pytest.mark.parametrize("stood_s", [0.4, 0.8])
def test_a_commanded_climb_ends_the_suspicion_of_the_ground(
    airborne: AutopilotFlight, stood_s: float
) -> None:
    set_down(airborne)
    airborne.run(stood_s, velocity(0.0, 0.0, 1.0))
    assert landed_state(airborne) is not LandedState.ON_GROUND
    for _ in range(40):
        airborne.run(0.1, velocity(0.0, 0.0, -1.0))
        assert landed_state(airborne) is not LandedState.ON_GROUND
    assert airborne.vehicle.height_m > 0.5


def test_while_the_motors_spool_up_a_climb_by_the_sticks_integrates_no_more_than_one_by_velocity(
    autopilot_kind: AutopilotKind,
) -> None:
    thrusts = []
    for wanted in (AttitudeSetpoint(IDENTITY, 0.6), MotionSetpoint(velocity_ned_m_s=(0.0, 0.0, -0.5))):
        estimate = SimulatedEstimator(NO_ERRORS, np.random.default_rng(1))
        cascade = Cascade(PROFILES[autopilot_kind], frame_450())
        cascade.lift_off()
        while not cascade.airborne:
            cascade.outer(wanted, estimate, True, 0.25, STEP_S)
        thrusts.append(cascade.thrust)
    by_sticks, by_velocity = thrusts
    assert by_sticks == pytest.approx(by_velocity)


def test_disarmed_and_armed_again_within_one_step_it_starts_from_the_ground(
    airborne: AutopilotFlight,
) -> None:
    assert airborne.autopilot.disarm(force=True) is CommandResult.ACCEPTED
    assert airborne.autopilot.arm(force=True) is CommandResult.ACCEPTED
    airborne.run(0.2, STAND_STILL)
    assert airborne.autopilot.armed
    assert landed_state(airborne) is LandedState.ON_GROUND
    assert airborne.autopilot.thrust == 0.0
    assert airborne.vehicle.velocity[2] > 1.0
