"""Commands and modes, in bytes: what each autopilot does, and how it refuses what it does not do."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import yaw_from_quat
from tests.unit.sitl.autopilot.autopilot_flight import HOME
from tests.unit.sitl.autopilot.missions.mission_desk import Station

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)


def flying(autopilot_kind: AutopilotKind, height_m: float = 4.0) -> Station:
    station = Station(autopilot_kind)
    station.flight.take_off(height_m)
    return station


def set_mode(station: Station, main: int, sub: int = 0) -> int:
    return station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, main, sub)


# ---------------------------------------------------------------- modes

PX4_MODES = {
    (1, 0): "MANUAL", (2, 0): "ALTCTL", (3, 0): "POSCTL", (4, 2): "AUTO_TAKEOFF", (4, 3): "AUTO_LOITER",
    (4, 5): "AUTO_RTL", (4, 6): "AUTO_LAND", (4, 9): "AUTO_PRECLAND", (7, 0): "STABILIZED",
}  # fmt: skip
ARDUPILOT_MODES = {
    0: "STABILIZE",
    2: "ALT_HOLD",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    9: "LAND",
    16: "POSHOLD",
}


def test_the_modes_on_offer_are_entered() -> None:
    station = Station("px4")
    for (main, sub), name in PX4_MODES.items():
        assert set_mode(station, main, sub) == ACCEPTED
        assert station.flight.autopilot.mode == name
        assert station.flight.autopilot.mode_numbers[1] == main << 16 | sub << 24
    station = Station("ardupilot")
    for main, name in ARDUPILOT_MODES.items():
        assert set_mode(station, main) == ACCEPTED
        assert station.flight.autopilot.mode == name


@pytest.mark.parametrize(
    ("autopilot_kind", "mode", "result", "text"),
    [
        ("px4", (5, 0), REJECTED, "Switching to mode 'Acro'"),
        ("px4", (6, 0), REJECTED, "Switching to mode 'Offboard'"),
        ("px4", (4, 4), REJECTED, "Switching to mode 'Mission'"),
        ("px4", (4, 8), REJECTED, ""),
        ("px4", (99, 0), REJECTED, ""),
        ("ardupilot", (3, 0), FAILED, "Mode change to AUTO failed"),
        ("ardupilot", (21, 0), FAILED, "Mode change to SMART_RTL failed"),
        ("ardupilot", (77, 0), FAILED, "No such mode 77"),
    ],
)
def test_other_modes_are_refused_with_a_text(
    autopilot_kind: AutopilotKind, mode: tuple[int, int], result: int, text: str
) -> None:
    station = Station(autopilot_kind)
    before = station.flight.autopilot.mode
    assert set_mode(station, *mode) == result
    station.run(0.1)
    assert station.flight.autopilot.mode == before
    assert not text or any(text in said for said in station.texts)


def test_flown_by_hand_alone_is_refused_in_flight_without_sticks() -> None:
    assert set_mode(flying("px4"), 7) == REJECTED
    assert set_mode(flying("ardupilot"), 0) == FAILED


# ---------------------------------------------------------------- arming


@BOTH
def test_arming_takes_0_and_1_alone(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    for value in (2.0, 0.5, math.nan, math.inf):
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, value) == UNSUPPORTED
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED


@BOTH
def test_modes_that_land_are_not_armed_in(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.flight.autopilot.set_mode_named(station.flight.autopilot.profile.land_mode)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) in (REJECTED, FAILED)


@BOTH
def test_termination_stops_the_motors_in_flight(autopilot_kind: AutopilotKind) -> None:
    station = flying(autopilot_kind)
    assert station.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 0) == DENIED
    assert station.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1) == ACCEPTED
    assert not station.flight.autopilot.armed


# ---------------------------------------------------------------- going places


def reposition(frame: int, north_m: float, altitude_m: float, speed: float = -1.0) -> Any:
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, speed, 1, 0, math.nan,
        round((HOME[0] + north_m / 111_170.0) * 1e7), round(HOME[1] * 1e7), altitude_m,
    )  # fmt: skip


@BOTH
@pytest.mark.parametrize(
    ("frame", "altitude_m"), [(5, HOME[2] + 5.18), (6, 5.0), (0, HOME[2] + 5.18), (3, 5.0)]
)
def test_repositioning_takes_both_altitudes(
    autopilot_kind: AutopilotKind, frame: int, altitude_m: float
) -> None:
    station = flying(autopilot_kind)
    assert station.result(reposition(frame, 10.0, altitude_m)) == ACCEPTED
    station.run(9.0)
    assert math.dist(station.flight.vehicle.position, (10.0, 0.0, -5.18)) < 0.3


@BOTH
def test_places_that_are_none_are_denied(autopilot_kind: AutopilotKind) -> None:
    station = flying(autopilot_kind)
    assert station.result(reposition(1, 10.0, 5.0)) == DENIED
    assert station.result(reposition(6, 10.0, 1e30)) == DENIED
    far = station.command(mavlink.MAV_CMD_DO_REPOSITION, -1, 1, 0, math.nan, 500.0, 8.0, 405.0)
    assert far == DENIED


@BOTH
def test_speeds_are_changed_and_forgotten_after_the_flight(autopilot_kind: AutopilotKind) -> None:
    station = flying(autopilot_kind)
    station.send(reposition(6, 60.0, 4.0))
    assert station.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 2.0) == ACCEPTED
    station.run(6.0)
    assert station.flight.vehicle.velocity[0] == pytest.approx(2.0, abs=0.15)
    for kind, speed in ((7, 2.0), (1, -5.0), (1, math.nan), (1, 1e9)):
        assert station.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, kind, speed) == DENIED


def test_ardupilot_turns_by_command_and_px4_does_not() -> None:
    station = flying("ardupilot")
    station.run(1.0)
    assert station.command(mavlink.MAV_CMD_CONDITION_YAW, 90, 20, 1, 0) == ACCEPTED
    station.run(4.0)
    assert yaw_from_quat(station.flight.vehicle.attitude) == pytest.approx(math.pi / 2, abs=0.05)
    assert station.command(mavlink.MAV_CMD_CONDITION_YAW, 45, 20, -1, 1) == ACCEPTED
    station.run(3.0)
    assert yaw_from_quat(station.flight.vehicle.attitude) == pytest.approx(math.pi / 4, abs=0.05)
    assert station.command(mavlink.MAV_CMD_CONDITION_YAW, math.nan) == FAILED
    assert flying("px4").command(mavlink.MAV_CMD_CONDITION_YAW, 90, 20, 1, 0) == UNSUPPORTED


@BOTH
def test_a_home_that_is_set_stays_and_is_returned_to(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    for name, value in (("RTL_RETURN_ALT", 4.0), ("RTL_ALT", 400.0)):
        station.flight.autopilot.parameters.set(name, value)
    home = (HOME[0] + 6.0 / 111_170.0, HOME[1], HOME[2] + 0.18)
    assert station.command(mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, *home) == ACCEPTED
    assert station.command(mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 95.0, 8.0, 0.0) == DENIED
    station.flight.take_off(4.0)
    assert station.flight.autopilot.home_ned_m[0] == pytest.approx(6.0, abs=0.1)
    assert station.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    station.run(30.0)
    assert station.flight.vehicle.position[0] == pytest.approx(6.0, abs=1.0)
    assert not station.flight.autopilot.armed


# ---------------------------------------------------------------- nonsense


@BOTH
@pytest.mark.parametrize("yaw", [math.inf, -math.inf, math.nan])
def test_a_heading_that_is_no_number_is_the_present_one(autopilot_kind: AutopilotKind, yaw: float) -> None:
    station = flying(autopilot_kind)
    message = reposition(6, 10.0, 5.0)
    message.param4 = yaw
    assert station.result(message) == ACCEPTED
    station.run(9.0)
    assert math.dist(station.flight.vehicle.position, (10.0, 0.0, -5.18)) < 0.3


@BOTH
def test_homes_upon_homes_stay_within_what_a_message_holds(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    higher = mavlink.MAVLink_command_int_message(
        1, 1, 6, mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0.0, 0.0, 0.0, 0.0,
        round(HOME[0] * 1e7), round(HOME[1] * 1e7), 9000.0,
    )  # fmt: skip
    results = [station.result(higher) for _ in range(40)]
    assert results == [ACCEPTED] * 3 + [DENIED] * 37
    beyond_the_horizon = station.command(mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, -47.0, -172.0, 0.0)
    assert beyond_the_horizon == DENIED
    told = next(m for m in reversed(station.run(2.0)) if m.get_type() == "GLOBAL_POSITION_INT")
    assert told.relative_alt == pytest.approx(-27_000_000, abs=500_000)


@BOTH
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e38, -1e38, 2.0**31])
def test_commands_full_of_huge_numbers_do_no_harm(autopilot_kind: AutopilotKind, value: float) -> None:
    station = flying(autopilot_kind)
    avoided = {mavlink.MAV_CMD_DO_FLIGHTTERMINATION}
    for number in (*range(600), 2000, 2500, 42_000):
        if number in avoided:
            continue
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *(value,) * 7)
        station.endpoint.receive(bytes(message.pack(station.us)), station.flight.now_s)
        whole = mavlink.MAVLink_command_int_message(
            1, 1, 6, number, 0, 0, *(value,) * 4, -(2**31), 2**31 - 1, value
        )
        station.endpoint.receive(bytes(whole.pack(station.us)), station.flight.now_s)
    station.run(1.0)
    assert all(map(math.isfinite, (*station.flight.vehicle.position, *station.flight.vehicle.attitude)))
