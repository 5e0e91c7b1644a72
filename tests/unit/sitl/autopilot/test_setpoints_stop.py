"""What the autopilots do when the setpoints stop: which mode, whether they come down, and disarm."""

from __future__ import annotations

import math

import pytest

from companion.base.geometry import tilt_from_quat
from sitl.autopilot import CommandResult, MotionSetpoint
from tests.unit.sitl.autopilot.autopilot_flight import STAND_STILL, in_the_air, velocity


def test_px4_leaves_offboard_when_setpoints_stop_and_comes_back_with_them() -> None:
    flight = in_the_air("px4")
    flight.run(2.0, velocity(1.0))
    flight.run(0.9)
    assert flight.autopilot.mode == "OFFBOARD"
    flight.run(0.4)
    assert flight.autopilot.mode == "POSCTL"
    assert flight.autopilot.in_failsafe
    assert any("offboard" in text for text in flight.texts)
    flight.run(3.0)  # nobody at the sticks: level, and down at MPC_LAND_SPEED
    assert tilt_from_quat(flight.vehicle.attitude) < math.radians(1.0)
    assert flight.vehicle.velocity[2] == pytest.approx(0.7, abs=0.05)
    flight.run(0.2, STAND_STILL)
    assert flight.autopilot.mode == "OFFBOARD"


@pytest.mark.parametrize(
    ("action", "mode"), [(0, "POSCTL"), (3, "AUTO_RTL"), (4, "AUTO_LAND"), (5, "AUTO_LOITER")]
)
def test_px4_does_what_its_parameter_says_when_setpoints_stop(action: int, mode: str) -> None:
    flight = in_the_air("px4")
    flight.autopilot.parameters.set("COM_OBL_RC_ACT", float(action))
    flight.run(2.0, velocity(1.0))
    flight.run(1.3)
    assert flight.autopilot.mode == mode
    assert flight.autopilot.in_failsafe
    flight.run(3.0)
    if action in (4, 5):  # neither goes on with the speed over ground that it had
        assert math.hypot(*flight.vehicle.velocity[:2]) < 0.1


@pytest.mark.parametrize("action", [0, 4])
def test_px4_disarms_what_its_failsafe_has_landed_while_setpoints_stay_away(action: int) -> None:
    flight = in_the_air("px4")
    flight.autopilot.parameters.set("COM_OBL_RC_ACT", float(action))
    flight.run(1.0, STAND_STILL)
    flight.run(25.0)
    assert flight.texts[-2:] == ["Landing detected", "Disarmed by landing"]
    assert not flight.autopilot.armed


@pytest.mark.parametrize("action", [6, 7])
def test_px4_stops_its_motors_in_the_air_where_its_parameter_says_so(action: int) -> None:
    flight = in_the_air("px4")
    flight.autopilot.parameters.set("COM_OBL_RC_ACT", float(action))
    flight.run(0.5, STAND_STILL)
    assert flight.autopilot.armed
    flight.run(1.3)
    assert not flight.autopilot.armed


def test_a_mode_command_ends_the_failsafe_for_good() -> None:
    flight = in_the_air("px4")
    flight.run(1.5)
    assert flight.autopilot.set_mode_named("AUTO_LOITER") is CommandResult.ACCEPTED
    flight.run(1.0, STAND_STILL)
    assert flight.autopilot.mode == "AUTO_LOITER"


def test_ardupilot_keeps_flying_for_three_seconds_then_stops_within_guided() -> None:
    flight = in_the_air("ardupilot")
    flight.run(3.0, velocity(1.0))
    samples = flight.run(6.0)
    assert samples[int(2.8 * 50)].velocity[0] == pytest.approx(1.0, abs=0.1)
    assert samples[-1].velocity[0] == pytest.approx(0.0, abs=0.1)
    assert flight.autopilot.mode == "GUIDED"


def test_an_ardupilot_position_does_not_time_out() -> None:
    flight = in_the_air("ardupilot")
    x, y, z = flight.autopilot.estimate.position_ned_m
    flight.autopilot.stream(MotionSetpoint(position_ned_m=(x + 20.0, y, z)), flight.now_s)
    flight.run(12.0)
    assert flight.vehicle.position[0] == pytest.approx(x + 20.0, abs=0.3)
