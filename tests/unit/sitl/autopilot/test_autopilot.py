"""The simulated flight controller keeps the real ones' rules: arming, modes, failsafes."""

import math
from math import nan

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import custom_mode
from companion.base.geometry import quat_from_euler, tilt_from_quat, wrap_angle, yaw_from_quat
from companion.base.messages import LandedState
from sitl.autopilot.control.setpoints import LocalFrame, MotionSetpoint, StreamedMotion
from sitl.autopilot.flight.modes import CommandResult
from sitl.mavlink.telemetry import current_mode
from tests.unit.sitl.autopilot.autopilot_flight import (
    HOME,
    PX4_OFFBOARD,
    STAND_STILL,
    ZERO,
    AutopilotFlight,
    in_the_air,
    landed_state,
    ready,
    set_down,
    velocity,
)

# ---------------------------------------------------------------- arming and taking off


def test_it_refuses_to_arm_before_its_estimator_is_aligned_and_disarms_unless_it_is_flown(
    flight: AutopilotFlight,
) -> None:
    flight.run(1.0)
    assert not ready(flight)
    refused = flight.autopilot.arm() in (CommandResult.TEMPORARILY_REJECTED, CommandResult.FAILED)
    assert (refused, flight.autopilot.armed) == (True, False)
    flight.run(0.1)
    assert any(text.startswith(("Arming denied", "Arm: Need Position")) for text in flight.texts)
    flight.run(5.0)
    assert ready(flight)
    assert flight.autopilot.arm() is CommandResult.ACCEPTED
    flight.run(9.5)
    assert flight.autopilot.armed
    flight.run(1.0)
    assert not flight.autopilot.armed


def test_it_climbs_to_the_height_at_a_metre_and_a_half_a_second_and_holds(
    flight: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    flight.take_off(6.0)
    assert flight.vehicle.height_m == pytest.approx(6.0, abs=0.1)
    assert math.dist(flight.vehicle.velocity, ZERO) < 0.05
    assert landed_state(flight) is LandedState.IN_AIR
    assert flight.autopilot.mode == ("AUTO_LOITER" if autopilot_kind == "px4" else "GUIDED")
    # disarming in flight needs force
    assert flight.autopilot.disarm() in (CommandResult.TEMPORARILY_REJECTED, CommandResult.FAILED)
    assert flight.autopilot.armed
    assert flight.autopilot.disarm(force=True) is CommandResult.ACCEPTED
    assert not flight.autopilot.armed


def test_the_climb_keeps_to_its_speed(flight: AutopilotFlight, autopilot_kind: AutopilotKind) -> None:
    flight.run(6.0)
    flight.autopilot.set_mode(4)
    flight.autopilot.arm()
    flight.autopilot.take_off(20.0 if autopilot_kind == "ardupilot" else HOME[2] + 20.0)
    flight.run(4.0)
    assert landed_state(flight) is LandedState.TAKEOFF
    assert -flight.vehicle.velocity[2] == pytest.approx(1.5, abs=0.1)


def test_px4_takes_its_own_height_when_none_is_given() -> None:
    flight = AutopilotFlight("px4")
    flight.run(4.0)
    flight.autopilot.parameters.set("MIS_TAKEOFF_ALT", 4.0)
    flight.autopilot.arm()
    assert flight.autopilot.take_off(nan) is CommandResult.ACCEPTED
    flight.run(8.0)
    assert flight.vehicle.height_m == pytest.approx(4.0, abs=0.2)


def test_ardupilot_takes_off_only_armed_in_guided_from_the_ground_and_by_no_setpoint() -> None:
    flight = AutopilotFlight("ardupilot")
    flight.run(6.0)
    assert flight.autopilot.take_off(5.0) is CommandResult.FAILED
    flight.autopilot.arm()
    assert flight.autopilot.take_off(5.0) is CommandResult.FAILED
    flight.autopilot.set_mode(4)
    flight.run(2.0, velocity(0.0, 0.0, -1.0))
    assert flight.vehicle.height_m == 0.0
    assert flight.autopilot.take_off(5.0) is CommandResult.ACCEPTED
    flight.run(8.0)
    assert flight.autopilot.take_off(5.0) is CommandResult.FAILED
    flight.autopilot.set_mode(5)  # outside GUIDED
    flight.run(2.0, velocity(2.0))
    assert abs(flight.vehicle.velocity[0]) < 0.1


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_it_takes_off_in_any_heading_and_keeps_it(autopilot_kind: AutopilotKind, heading: float) -> None:
    flight = AutopilotFlight(autopilot_kind, heading_rad=heading)
    flight.take_off(3.0)
    assert abs(wrap_angle(yaw_from_quat(flight.vehicle.attitude) - heading)) < 0.02
    assert math.hypot(*flight.vehicle.position[:2]) < 0.1


# ---------------------------------------------------------------- modes and failsafes


def test_px4_enters_offboard_only_on_fresh_setpoints() -> None:
    flight = AutopilotFlight("px4")
    flight.take_off()
    assert flight.autopilot.set_mode(PX4_OFFBOARD) is CommandResult.TEMPORARILY_REJECTED
    flight.run(0.1, STAND_STILL)
    assert flight.autopilot.set_mode(PX4_OFFBOARD) is CommandResult.ACCEPTED
    flight.run(0.1)
    assert "Switching to mode 'Offboard' is currently not available" in flight.texts


def test_px4_leaves_offboard_when_setpoints_stop_and_comes_back_with_them() -> None:
    flight = in_the_air("px4")
    flight.autopilot.parameters.set("COM_OBL_RC_ACT", 0.0)
    flight.run(2.0, velocity(1.0))
    flight.run(0.9)
    assert flight.autopilot.mode == "OFFBOARD"
    flight.run(3.4)  # nobody at the sticks: level, and down at MPC_LAND_SPEED
    assert flight.autopilot.commander.in_failsafe
    assert any("offboard" in text for text in flight.texts)
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
    assert flight.autopilot.commander.in_failsafe
    assert current_mode(flight.autopilot, 0.0).intended_custom_mode == custom_mode("px4", "OFFBOARD")
    flight.run(3.0)
    if action in (4, 5):  # neither goes on with the speed over ground that it had
        assert math.hypot(*flight.vehicle.velocity[:2]) < 0.1
    if action in (0, 4):  # what it has landed is disarmed, though setpoints stay away
        flight.run(22.0)
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
    flight.autopilot.parameters.set("GUID_TIMEOUT", 3)
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


def test_px4_takes_off_on_an_upward_setpoint_in_offboard_where_it_does_not_arm_without_setpoints() -> None:
    flight = AutopilotFlight("px4")
    flight.run(4.0, STAND_STILL)
    flight.autopilot.set_mode(PX4_OFFBOARD)
    flight.run(2.0)
    assert flight.autopilot.arm() is CommandResult.TEMPORARILY_REJECTED
    flight.run(0.5, STAND_STILL)
    assert flight.autopilot.arm() is CommandResult.ACCEPTED
    flight.run(1.0, STAND_STILL)
    assert flight.vehicle.height_m == 0.0
    flight.run(4.0, velocity(0.0, 0.0, -1.0))
    assert flight.vehicle.height_m > 1.5


def test_px4_does_not_take_offset_frames_and_says_so() -> None:
    flight = in_the_air("px4")
    fields = StreamedMotion(LocalFrame.BODY_OFFSET_NED, 0b110111000111, ZERO, (1.0, 0.0, 0.0), ZERO, 0.0, 0.0)
    flight.autopilot.stream_fields(fields, flight.now_s)
    flight.run(1.5)
    assert any("frame 9 unsupported" in text for text in flight.texts)
    assert flight.autopilot.mode == "AUTO_LOITER"


def test_going_to_a_place_ends_there_in_the_heading_asked_for(flight: AutopilotFlight) -> None:
    flight.take_off()
    target = flight.autopilot.geodetic((12.0, -7.0, -9.18))
    assert flight.autopilot.go_to(target, over_home=False, yaw_rad=1.0) is CommandResult.ACCEPTED
    flight.run(12.0)
    assert math.dist(flight.vehicle.position, (12.0, -7.0, -9.18)) < 0.3
    assert yaw_from_quat(flight.vehicle.attitude) == pytest.approx(1.0, abs=0.03)


def test_landing_slows_down_touches_gently_and_disarms(
    flight: AutopilotFlight, autopilot_kind: AutopilotKind
) -> None:
    flight.take_off(5.0)
    assert flight.autopilot.set_mode_named(flight.autopilot.profile.land_mode) is CommandResult.ACCEPTED
    # PX4 crawls below MPC_LAND_ALT3, ArduPilot keeps LAND_SPEED from LAND_ALT_LOW (10 m) down
    first, last = (0.7, 0.3) if autopilot_kind == "px4" else (0.5, 0.5)
    flight.run(2.0)
    assert flight.vehicle.velocity[2] == pytest.approx(first, abs=0.05)
    assert landed_state(flight) is LandedState.LANDING
    speeds = [s.velocity[2] for s in flight.run(24.0) if s.position[2] < -0.2]
    assert speeds[-1] == pytest.approx(last, abs=0.05)
    assert not flight.autopilot.armed
    assert landed_state(flight) is LandedState.ON_GROUND


def test_returning_comes_home_and_lands(airborne: AutopilotFlight) -> None:
    airborne.run(6.0, velocity(2.0, 1.0))
    airborne.autopilot.set_mode_named(airborne.autopilot.profile.return_mode)
    airborne.run(50.0)
    assert not airborne.autopilot.armed
    assert math.hypot(*airborne.vehicle.position[:2]) < 1.0


def test_ardupilot_disarms_a_vehicle_that_has_turned_over() -> None:
    flight = AutopilotFlight("ardupilot")
    flight.take_off()
    held = flight.vehicle.position
    for _ in range(230):
        flight.vehicle.attitude, flight.vehicle.rate = quat_from_euler(2.0, 0.0, 0.0), ZERO
        flight.vehicle.position, flight.vehicle.velocity = held, ZERO
        flight.run(0.01)
    assert not flight.autopilot.armed
    assert any(text.startswith("Crash") for text in flight.texts)


def test_it_says_when_it_has_landed_and_disarmed_by_itself() -> None:
    flight = in_the_air("px4")
    set_down(flight)
    flight.run(12.0, velocity(0.0, 0.0, 0.3))
    assert flight.texts.index("Landing detected") < flight.texts.index("Disarmed by landing")
    assert not flight.autopilot.armed
