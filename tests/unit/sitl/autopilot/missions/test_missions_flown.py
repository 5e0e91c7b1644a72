"""Missions that are flown as each autopilot does."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import yaw_from_quat
from tests.unit.sitl.autopilot.missions.mission_desk import Station, item, mission, plain
from tests.unit.sitl.autopilot.missions.mission_items import BOTH, LAND, RETURN, TAKE_OFF, WAYPOINT


@BOTH
def test_a_mission_is_flown_from_take_off_to_landing(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.fly(
        [
            item(TAKE_OFF, 0, 0, 5),
            item(WAYPOINT, 12, 0, 5, (2.0, 0.0, 0.0, math.nan)),
            plain(178, 1, 3, 0, 0),
            item(WAYPOINT, 12, 8, 6),
            item(LAND, 12, 8, 0),
        ]
    )
    north = [s.position[0] for _ in range(12) for s in station.flight.run(1.0)]
    assert max(north) == pytest.approx(12.0, abs=0.6)
    station.run(26.0)
    assert math.dist(station.flight.vehicle.position[:2], (12.0, 8.0)) < 0.6
    assert not station.flight.autopilot.armed
    first = 1 if autopilot_kind == "ardupilot" else 0
    assert station.reached() == list(range(first, first + 5))
    # rewound: it can be flown again
    assert station.flight.autopilot.mission.current == 0


@BOTH
def test_a_jump_is_taken_as_often_as_it_says(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    first = 1 if autopilot_kind == "ardupilot" else 0
    station.fly(
        [item(TAKE_OFF, 0, 0, 4), item(WAYPOINT, 6, 0, 4), item(WAYPOINT, 0, 0, 4), plain(177, first + 1, 2)]
    )
    station.run(50.0)
    assert station.reached().count(first + 1) == 3
    assert station.flight.autopilot.mission.finished
    assert station.flight.autopilot.armed
    assert math.dist(station.flight.vehicle.velocity, (0.0, 0.0, 0.0)) < 0.1


@BOTH
def test_jumps_that_lead_nowhere_do_no_harm(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.fly([item(TAKE_OFF, 0, 0, 3), plain(177, 2, -1), plain(177, 1, -1)])
    station.run(8.0)
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


@BOTH
def test_a_loop_with_nothing_to_fly_is_reported_of_once_a_second_at_most(
    autopilot_kind: AutopilotKind,
) -> None:
    station = Station(autopilot_kind)
    first = 1 if autopilot_kind == "ardupilot" else 0
    station.fly([item(TAKE_OFF, 0, 0, 3), item(WAYPOINT, 0, 0, 3), plain(177, first, -1)])
    station.run(6.0)
    before = len(station.heard)
    station.run(5.0)
    new = [m for m in station.heard[before:] if m.get_type() in ("MISSION_ITEM_REACHED", "STATUSTEXT")]
    assert 4 <= len(new) <= 30
    assert first + 2 not in station.reached()  # a jump is no place to be reached
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


@BOTH
def test_returning_is_an_item_too(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    for name, value in (("RTL_RETURN_ALT", 5.0), ("RTL_ALT", 500.0)):
        station.flight.autopilot.parameters.set(name, value)
    station.fly([item(TAKE_OFF, 0, 0, 4), item(WAYPOINT, 8, 0, 4), plain(RETURN)])
    station.run(40.0)
    assert not station.flight.autopilot.armed
    assert math.hypot(*station.flight.vehicle.position[:2]) < 1.0


def test_ardupilot_turns_circles_and_waits() -> None:
    station = Station("ardupilot")
    station.fly(
        [
            item(TAKE_OFF, 0, 0, 4),
            plain(115, 90, 0, 1, 0),
            plain(112, 2),
            item(18, 5, 0, 4, (1.0, 0.0, 5.0, 0.0)),
            item(17, 0, 0, 4),
        ]
    )
    station.run(7.0)
    assert yaw_from_quat(station.flight.vehicle.attitude) == pytest.approx(math.pi / 2, abs=0.1)
    samples = [s for _ in range(18) for s in station.flight.run(1.0)]
    assert max(s.position[0] for s in samples) == pytest.approx(10.0, abs=0.7)
    assert max(s.position[1] for s in samples) == pytest.approx(5.0, abs=0.7)
    assert min(s.position[1] for s in samples) == pytest.approx(-5.0, abs=0.7)


def test_px4_heads_where_a_waypoint_says_and_ardupilot_along_the_way() -> None:
    for autopilot_kind, heading in (("px4", math.pi), ("ardupilot", math.pi / 2)):
        station = Station(autopilot_kind)  # type: ignore[arg-type]
        station.fly([item(TAKE_OFF, 0, 0, 4), item(WAYPOINT, 0, 20, 4, (0.0, 0.0, 0.0, 180.0))])
        station.run(8.5)
        turned = yaw_from_quat(station.flight.vehicle.attitude)
        assert abs(math.remainder(turned - heading, 2.0 * math.pi)) < 0.15


@BOTH
def test_a_mission_can_be_left_and_gone_on_with(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.fly([item(TAKE_OFF, 0, 0, 4), item(WAYPOINT, 30, 0, 4), item(WAYPOINT, 0, 0, 4)])
    station.run(8.0)
    assert station.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0) == 0
    station.run(4.0)
    held = station.flight.vehicle.position
    assert math.dist(station.flight.vehicle.velocity, (0.0, 0.0, 0.0)) < 0.1
    assert station.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1) == 0
    station.run(3.0)
    assert station.flight.vehicle.position[0] > held[0] + 3.0
    station.flight.autopilot.set_mode_named(station.flight.autopilot.profile.hold_mode)
    station.run(4.0)
    current = station.flight.autopilot.mission.current
    assert station.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == 0
    assert station.flight.autopilot.mission.current == current


def test_without_a_mission_its_mode_is_refused() -> None:
    for autopilot_kind, mode, result in (("px4", 4 << 16 | 4 << 24, 1), ("ardupilot", 3, 4)):
        station = Station(autopilot_kind)  # type: ignore[arg-type]
        assert station.flight.autopilot.set_mode(mode) == result
        assert station.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == result
        station.run(0.2)
        assert any("Mission" in text or "AUTO" in text for text in station.texts)


def test_px4_climbs_by_itself_before_a_first_waypoint_and_ardupilot_wants_a_take_off() -> None:
    station = Station("px4")
    station.fly([item(WAYPOINT, 8, 0, 6)])
    station.run(10.0)
    assert station.flight.vehicle.position[0] == pytest.approx(8.0, abs=0.5)
    station = Station("ardupilot")
    station.upload(mission("ardupilot", [item(WAYPOINT, 8, 0, 6)]))
    station.flight.autopilot.set_mode(4)
    station.flight.autopilot.arm()
    assert station.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == 4
    station.run(0.2)
    assert "Auto: Missing Takeoff Cmd" in station.texts


@BOTH
def test_landing_start_and_the_current_item_are_reported(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    assert station.command(mavlink.MAV_CMD_DO_LAND_START) == 4
    station.fly([item(TAKE_OFF, 0, 0, 4), item(17, 20, 0, 4), item(189), item(LAND, 0, 0, 0)])
    station.run(7.0)
    told = [m for m in station.run(1.2) if m.get_type() == "MISSION_CURRENT"]
    first = 1 if autopilot_kind == "ardupilot" else 0
    assert (told[-1].seq, told[-1].total) == (first + 1, 4)
    assert station.command(mavlink.MAV_CMD_DO_LAND_START) == 0
    station.run(25.0)
    assert not station.flight.autopilot.armed
