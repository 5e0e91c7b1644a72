"""Flying by hand: RC override and joystick, in the modes that sticks fly, and when they are lost."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import tilt_from_quat, yaw_from_quat
from tests.unit.sitl.autopilot.missions.mission_desk import Station

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
VELOCITY_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}
ANGLE_MODE = {"px4": "ALTCTL", "ardupilot": "ALT_HOLD"}
THRUST_MODE = {"px4": "STABILIZED", "ardupilot": "STABILIZE"}
RETURN_MODE = {"px4": "AUTO_RTL", "ardupilot": "RTL"}


def joystick(x: int = 0, y: int = 0, z: int = 500, r: int = 0) -> Any:
    return mavlink.MAVLink_manual_control_message(1, x, y, z, r, 0)


def override(*channels: int) -> Any:
    return mavlink.MAVLink_rc_channels_override_message(1, 1, *channels, *(0,) * (8 - len(channels)))


def hold(station: Station, message: Any, seconds: float) -> None:
    """Keep sending, as a ground station does."""
    for _ in range(round(seconds * 10)):
        station.send(message)
        station.run(0.1)


def hovering(autopilot_kind: AutopilotKind, mode: dict[str, str]) -> Station:
    station = Station(autopilot_kind)
    station.flight.take_off(8.0)
    hold(station, joystick(), 0.3)
    assert station.flight.autopilot.set_mode_named(mode[autopilot_kind]) == 0
    return station


@BOTH
def test_sticks_fly_velocities_and_letting_go_holds(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, joystick(x=300, y=-300, z=600), 4.0)
    vx, vy, vz = station.flight.vehicle.velocity
    assert vx > 1.0
    assert vy < -1.0
    assert vz < -0.1
    hold(station, joystick(), 5.0)
    assert math.dist(station.flight.vehicle.velocity, (0.0, 0.0, 0.0)) < 0.15


@BOTH
def test_sticks_tilt_the_vehicle_and_turn_it_while_its_height_is_held(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, ANGLE_MODE)
    height = station.flight.vehicle.height_m
    hold(station, joystick(y=300), 1.5)
    assert tilt_from_quat(station.flight.vehicle.attitude) > math.radians(6.0)
    assert station.flight.vehicle.velocity[1] > 0.5
    hold(station, joystick(r=500), 2.0)
    assert yaw_from_quat(station.flight.vehicle.attitude) > 0.5
    assert station.flight.vehicle.height_m == pytest.approx(height, abs=0.5)


@BOTH
def test_the_throttle_is_thrust_in_the_simplest_mode(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, THRUST_MODE)
    hold(station, joystick(z=700), 1.5)
    assert station.flight.vehicle.velocity[2] < -1.0
    hold(station, joystick(z=300), 3.0)
    assert station.flight.vehicle.velocity[2] > 0.5


@BOTH
def test_channels_fly_as_the_joystick_does_and_are_reported(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    forward = 1300 if autopilot_kind == "ardupilot" else 1700
    hold(station, override(1500, forward, 1500, 1500), 3.0)
    assert station.flight.vehicle.velocity[0] > 1.0
    told = [m for m in station.run(1.0) if m.get_type() == "RC_CHANNELS"][-1]
    assert (told.chan1_raw, told.chan2_raw, told.chancount) == (1500, forward, 18)


@BOTH
def test_nobody_at_the_sticks_from_the_start_triggers_nothing(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.flight.take_off(3.0)
    station.flight.autopilot.set_mode_named(VELOCITY_MODE[autopilot_kind])
    station.run(12.0)
    assert station.flight.autopilot.mode == VELOCITY_MODE[autopilot_kind]
    assert {m.chancount for m in station.heard if m.get_type() == "RC_CHANNELS"} == {0}
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


@BOTH
def test_sticks_that_fall_silent_bring_it_home_once(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, override(1500, 1500, 1500, 1500), 1.0)
    station.run(0.4)
    assert station.flight.autopilot.mode == VELOCITY_MODE[autopilot_kind]
    station.run(6.0)
    assert station.flight.autopilot.mode == RETURN_MODE[autopilot_kind]
    assert any("Manual control lost" in t or "Radio Failsafe" in t for t in station.texts)
    # a mode chosen after that is the pilot's own business
    station.flight.autopilot.set_mode_named(station.flight.autopilot.profile.hold_mode)
    station.run(8.0)
    assert station.flight.autopilot.mode == station.flight.autopilot.profile.hold_mode


@BOTH
def test_released_channels_are_no_loss(autopilot_kind: AutopilotKind) -> None:
    station = hovering(autopilot_kind, VELOCITY_MODE)
    hold(station, override(1500, 1500, 1500, 1500), 0.5)
    station.send(override(0, 0, 0, 0))
    station.run(8.0)
    assert station.flight.autopilot.mode == VELOCITY_MODE[autopilot_kind]


def test_exceptions_keep_a_mode_without_sticks() -> None:
    station = hovering("px4", {"px4": "AUTO_LOITER"})
    station.flight.autopilot.parameters.set("COM_RCL_EXCEPT", 2)
    station.run(8.0)
    assert station.flight.autopilot.mode == "AUTO_LOITER"
    station.flight.autopilot.parameters.set("COM_RCL_EXCEPT", 0)
    station.run(6.0)
    assert station.flight.autopilot.mode == "AUTO_RTL"


def heard(station: Station) -> bool:
    return station.flight.autopilot.rc_input.channels is not None


def test_ardupilot_heeds_its_own_ground_station_alone_and_does_not_arm_with_the_throttle_up() -> None:
    station = Station("ardupilot")
    station.us.srcSystem = 42
    station.send(joystick(z=900))
    assert not heard(station)
    station.us.srcSystem = 255
    station.send(joystick(z=900))
    assert heard(station)
    station.run(0.1)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_FAILED


@BOTH
def test_the_throttle_lifts_it_off_and_a_pushed_down_one_lands_it(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    hold(station, joystick(), 0.3)
    station.flight.autopilot.set_mode_named(VELOCITY_MODE[autopilot_kind])
    assert station.flight.autopilot.arm() == 0
    hold(station, joystick(), 1.0)
    assert station.flight.vehicle.height_m == 0.0
    hold(station, joystick(z=900), 4.0)
    assert station.flight.vehicle.height_m > 2.0
    hold(station, joystick(z=200), 12.0)
    assert station.flight.vehicle.height_m == 0.0
