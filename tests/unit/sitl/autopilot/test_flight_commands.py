"""Commands and modes, in bytes: what each autopilot does, and how it refuses what it does not do."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import yaw_from_quat
from tests.unit.sitl.autopilot.autopilot_flight import HOME
from tests.unit.sitl.autopilot.missions.mission_desk import Station

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)


@pytest.fixture
def aloft(station: Station) -> Station:
    station.flight.take_off(4.0)
    return station


def set_mode(station: Station, main: int, sub: int = 0) -> int:
    return station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, main, sub)


MODES: dict[str, dict[tuple[int, int], str]] = {
    "px4": {
        (1, 0): "MANUAL", (2, 0): "ALTCTL", (3, 0): "POSCTL", (4, 2): "AUTO_TAKEOFF", (4, 3): "AUTO_LOITER",
        (4, 5): "AUTO_RTL", (4, 6): "AUTO_LAND", (4, 9): "AUTO_PRECLAND", (7, 0): "STABILIZED",
    },
    "ardupilot": {
        (0, 0): "STABILIZE", (2, 0): "ALT_HOLD", (4, 0): "GUIDED", (5, 0): "LOITER", (6, 0): "RTL",
        (9, 0): "LAND", (16, 0): "POSHOLD",
    },
}  # fmt: skip


def test_the_modes_on_offer_are_entered(station: Station) -> None:
    autopilot = station.flight.autopilot
    for (main, sub), name in MODES[station.autopilot_kind].items():
        assert set_mode(station, main, sub) == ACCEPTED
        assert autopilot.mode == name
        assert station.autopilot_kind == "ardupilot" or autopilot.mode_numbers[1] == main << 16 | sub << 24


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


def test_flown_by_hand_alone_is_refused_in_flight_without_sticks(aloft: Station) -> None:
    mode, refusal = (7, REJECTED) if aloft.autopilot_kind == "px4" else (0, FAILED)
    assert set_mode(aloft, mode) == refusal


def test_arming_takes_0_and_1_alone_and_no_mode_that_lands(station: Station) -> None:
    autopilot = station.flight.autopilot
    before = autopilot.mode
    autopilot.set_mode_named(autopilot.profile.land_mode)
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) in (REJECTED, FAILED)
    autopilot.set_mode_named(before)
    for value in (2.0, 0.5, math.nan, math.inf):
        assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, value) == UNSUPPORTED
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED


def reposition(frame: int, north_m: float, altitude_m: float) -> Any:
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1, 0, math.nan,
        round((HOME[0] + north_m / 111_170.0) * 1e7), round(HOME[1] * 1e7), altitude_m,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("frame", "altitude_m", "yaw"),
    [(5, HOME[2] + 5.18, math.inf), (6, 5.0, -math.inf), (0, HOME[2] + 5.18, math.nan), (3, 5.0, math.nan)],
)
def test_repositioning_takes_both_altitudes_and_keeps_the_heading_when_given_none(
    aloft: Station, frame: int, altitude_m: float, yaw: float
) -> None:
    message = reposition(frame, 10.0, altitude_m)
    message.param4 = yaw
    assert aloft.result(message) == ACCEPTED
    aloft.run(9.0)
    assert math.dist(aloft.flight.vehicle.position, (10.0, 0.0, -5.18)) < 0.3


def test_nonsense_is_denied_and_a_termination_stops_the_motors(aloft: Station) -> None:
    for frame, altitude_m in ((1, 5.0), (6, 1e30)):
        assert aloft.result(reposition(frame, 10.0, altitude_m)) == DENIED
    far = (-1, 1, 0, math.nan, 500.0, 8.0, 405.0)
    assert aloft.command(mavlink.MAV_CMD_DO_REPOSITION, *far) == DENIED
    assert aloft.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 0) == DENIED
    assert aloft.flight.autopilot.armed
    assert aloft.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1) == ACCEPTED
    assert not aloft.flight.autopilot.armed


def test_speeds_are_changed_and_forgotten_after_the_flight(aloft: Station) -> None:
    aloft.send(reposition(6, 60.0, 4.0))
    assert aloft.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 2.0) == ACCEPTED
    aloft.run(6.0)
    assert aloft.flight.vehicle.velocity[0] == pytest.approx(2.0, abs=0.15)
    for kind, speed in ((7, 2.0), (1, -5.0), (1, math.nan), (1, 1e9)):
        assert aloft.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, kind, speed) == DENIED


def test_ardupilot_turns_by_command_and_px4_does_not(aloft: Station) -> None:
    aloft.run(1.0)
    if aloft.autopilot_kind == "px4":
        assert aloft.command(mavlink.MAV_CMD_CONDITION_YAW, 90, 20, 1, 0) == UNSUPPORTED
        return
    for turn, yaw_rad in (((90, 20, 1, 0), math.pi / 2), ((45, 20, -1, 1), math.pi / 4)):
        assert aloft.command(mavlink.MAV_CMD_CONDITION_YAW, *turn) == ACCEPTED
        aloft.run(4.0)
        assert yaw_from_quat(aloft.flight.vehicle.attitude) == pytest.approx(yaw_rad, abs=0.05)
    assert aloft.command(mavlink.MAV_CMD_CONDITION_YAW, math.nan) == FAILED


def test_a_home_that_is_set_stays_and_is_returned_to(station: Station) -> None:
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


def test_homes_upon_homes_stay_within_what_a_message_holds(station: Station) -> None:
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


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e38, -1e38, 2.0**31])
def test_commands_full_of_huge_numbers_do_no_harm(aloft: Station, value: float) -> None:
    extreme = (*(value,) * 4, -(2**31), 2**31 - 1, value)
    for number in {*range(600), 2000, 2500, 42_000} - {mavlink.MAV_CMD_DO_FLIGHTTERMINATION}:
        for message in (
            mavlink.MAVLink_command_long_message(1, 1, number, 0, *(value,) * 7),
            mavlink.MAVLink_command_int_message(1, 1, 6, number, 0, 0, *extreme),
        ):
            aloft.endpoint.receive(bytes(message.pack(aloft.us)), aloft.flight.now_s)
    aloft.run(1.0)
    assert all(map(math.isfinite, (*aloft.flight.vehicle.position, *aloft.flight.vehicle.attitude)))
