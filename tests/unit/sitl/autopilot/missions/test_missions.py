"""Missions over MAVLink: uploaded, refused and downloaded as each autopilot does."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from companion.base.geometry import yaw_from_quat
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.missions.mission_desk import (
    LAND,
    RETURN,
    TAKE_OFF,
    WAYPOINT,
    Station,
    item,
    plain,
)


def count(number: int, mission_type: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, number, mission_type)


def results(messages: list[Any]) -> list[int]:
    return [m.type for m in messages if m.get_type() == "MISSION_ACK"]


def test_a_mission_comes_back_as_it_was_sent_after_home_where_that_is_item_0(station: Station) -> None:
    ways = [item(TAKE_OFF, 0, 0, 5), item(WAYPOINT, 10, -4, 6), plain(178, 1, 3), item(LAND)]
    sent = station.mission(ways)
    assert station.upload(sent) == 0
    back = station.download()
    assert [m.command for m in back] == [m.command for m in sent]
    for ours, theirs in zip(ways, back[-len(ways) :], strict=True):
        assert (ours.x, ours.y, ours.z, ours.param1) == (theirs.x, theirs.y, theirs.z, theirs.param1)
    assert back[-1].frame == (6 if station.autopilot_kind == "px4" else 3)
    if station.autopilot_kind == "ardupilot":  # whatever was sent for it
        assert (back[0].frame, back[0].z) == (mavlink.MAV_FRAME_GLOBAL, pytest.approx(400.18, abs=0.05))


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        (mavlink.MAVLink_mission_request_message, "MISSION_ITEM"),
        (mavlink.MAVLink_mission_request_int_message, "MISSION_ITEM_INT"),
    ],
)
def test_ardupilots_home_can_be_read_without_a_mission(ask: Any, answer: str) -> None:
    """DroneKit learns home by it, and waits for it."""
    [count] = Station("ardupilot").send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    assert count.count == 0
    [home] = Station("ardupilot").send(ask(1, 1, 0, 0))
    assert (home.get_type(), home.seq, home.z) == (answer, 0, pytest.approx(400.18, abs=0.05))
    assert results(Station("ardupilot").send(ask(1, 1, 1, 0))) == [1]
    assert results(Station("px4").send(ask(1, 1, 0, 0))) == [1]


@pytest.mark.parametrize(
    ("autopilot_kind", "request_type"), [("px4", "MISSION_REQUEST_INT"), ("ardupilot", "MISSION_REQUEST")]
)
def test_each_asks_in_its_own_way_and_takes_both_kinds_of_item(
    autopilot_kind: AutopilotKind, request_type: str
) -> None:
    station = Station(autopilot_kind)
    assert station.send(count(1))[-1].get_type() == request_type
    old = mavlink.MAVLink_mission_item_message(1, 1, 0, 3, WAYPOINT, 0, 1, 0, 0, 0, 0, 47.001, 8.001, 12.0)
    assert results(station.send(old)) == [0]
    asked = station.send(mavlink.MAVLink_mission_request_message(1, 1, 0))[-1]
    assert asked.get_type() == "MISSION_ITEM"
    if autopilot_kind == "px4":
        assert (asked.x, asked.y, asked.z) == pytest.approx((47.001, 8.001, 12.0), abs=1e-5)


def test_a_request_that_got_lost_is_repeated_and_silence_ends_the_upload(station: Station) -> None:
    station.send(count(2))
    repeated = [m for m in station.run(2.2) if m.get_type().startswith("MISSION_REQUEST")]
    assert len(repeated) == pytest.approx(8 if station.autopilot_kind == "px4" else 2, abs=1)
    assert {m.seq for m in repeated} == {0}
    assert results(station.run(7.0)) == [15]
    assert results(station.send(item(WAYPOINT))) == [1]


def test_an_item_out_of_sequence_does_not_end_the_upload(station: Station) -> None:
    items = station.mission([item(WAYPOINT, 1, 0, 5), item(WAYPOINT, 2, 0, 5), item(WAYPOINT, 3, 0, 5)])
    station.send(count(len(items)))
    answer = station.send(items[2])[-1]
    if station.autopilot_kind == "px4":
        assert (answer.get_type(), answer.seq) == ("MISSION_REQUEST_INT", 0)
    else:
        assert results([answer]) == [13]
    for each in items:
        answers = station.send(each)
    assert results(answers) == [0]
    # its acknowledgement was lost, so the client sends the last item again
    assert results(station.send(items[-1])) == [0]


def test_a_second_count_starts_ardupilot_anew_and_is_refused_by_a_busy_px4(station: Station) -> None:
    items = station.mission([item(WAYPOINT, n, 0, 5) for n in range(3)])
    station.send(count(len(items)))
    station.send(items[0])
    answers = station.send(count(2))
    assert results(answers) == ([1] if station.autopilot_kind == "px4" else [])
    assert station.autopilot_kind == "px4" or answers[-1].seq == 0


def test_somebody_elses_items_are_denied(station: Station) -> None:
    station.send(count(1))
    station.us.srcSystem = 254
    assert results(station.send(item(WAYPOINT)))[0] != 0
    assert results(station.send(count(1)))[0] != 0
    station.us.srcSystem = 255
    assert results(station.send(item(WAYPOINT))) == [0]


def test_one_upload_at_a_time_over_all_links(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind, 0.1)
    first, second = station.endpoint, MavlinkEndpoint(station.flight.autopilot)
    station.send(count(1))
    station.endpoint = second
    assert results(station.send(count(1)))[0] != 0
    assert results(station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0)))[0] != 0
    station.endpoint = first
    assert results(station.send(item(WAYPOINT))) == [0]
    station.endpoint = second
    assert station.send(count(1))[-1].seq == 0


@pytest.mark.parametrize(
    ("wrong", "result"),
    [
        (item(TAKE_OFF, frame=1), 2),
        (item(WAYPOINT, frame=10), 2),
        (item(42_000), 3),
        (item(84), 3),
        (item(WAYPOINT, 6_000_000, 0, 5), 10),
        (item(WAYPOINT, 0, 14_000_000, 5), 11),
        (item(WAYPOINT, 0, 0, math.nan), 12),
        (item(WAYPOINT, 0, 0, 1e9), 12),
        (plain(177, -5, 2), 6),
        (item(WAYPOINT, 0, 0, 5, mission_type=1), 1),
    ],
)
def test_wrong_items_are_refused(station: Station, wrong: Any, result: int) -> None:
    station.send(count(1))
    assert results(station.send(wrong)) == [result]


def test_conditions_and_circles_are_ardupilots_alone() -> None:
    for command in (18, 82, 112, 115):
        assert Station("px4", 0.1).upload([item(command)]) == 3
        assert Station("ardupilot", 0.1).upload([item(command)]) == 0


def test_lists_too_long_fences_and_rally_points(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind, 0.1)
    assert results(station.send(count(60_000))) == [4]
    assert results(station.send(count(60_000, 1))) == [4]
    assert results(station.send(count(3, 2))) == [3]  # rally points are not simulated
    for kind in (1, 2):
        assert station.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))[-1].count == 0
        assert results(station.send(count(0, kind))) == [0]
        assert results(station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, kind))) == [0]
    assert results(station.send(count(1, 7))) == [3]
    assert station.send(mavlink.MAVLink_mission_request_int_message(1, 1, 5))[-1].type == 1


def test_clearing_and_choosing_the_current_item(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind, 0.1)
    station.upload(station.mission([item(WAYPOINT, n, 0, 5) for n in range(4)]))
    current = station.send(mavlink.MAVLink_mission_set_current_message(1, 1, 2))
    assert current[-1].seq == 2
    assert station.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 3) == 0
    assert station.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 30) != 0
    assert station.flight.autopilot.mission.current == 3
    assert results(station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))) == [0]
    assert station.send(mavlink.MAVLink_mission_request_list_message(1, 1))[-1].count == 0


def test_part_of_ardupilots_list_can_be_replaced() -> None:
    station = Station("ardupilot", 0.1)
    items = station.mission([item(WAYPOINT, n, 0, 5) for n in range(4)])
    station.upload(items)
    part = mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 3)
    assert station.send(part)[-1].seq == 2
    assert station.send(item(WAYPOINT, 50, 0, 5, seq=2))[-1].seq == 3
    assert results(station.send(item(WAYPOINT, 60, 0, 5, seq=3))) == [0]
    assert [m.x for m in station.download()][1:] == [
        items[1].x, item(WAYPOINT, 50).x, item(WAYPOINT, 60).x, items[4].x,
    ]  # fmt: skip
    beyond = mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 9)
    assert results(station.send(beyond)) == [1]
    assert not Station("px4", 0.1).send(part)


# ---------------- Missions that are flown as each autopilot does


def test_a_mission_is_flown_from_take_off_to_landing(station: Station) -> None:
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
    assert station.reached() == list(range(station.first, station.first + 5))
    # rewound: it can be flown again
    assert station.flight.autopilot.mission.current == 0


def test_a_jump_is_taken_as_often_as_it_says(station: Station) -> None:
    there, back = item(WAYPOINT, 6, 0, 4), item(WAYPOINT, 0, 0, 4)
    station.fly([item(TAKE_OFF, 0, 0, 4), there, back, plain(177, station.first + 1, 2)])
    station.run(50.0)
    assert station.reached().count(station.first + 1) == 3
    assert station.flight.autopilot.mission.finished
    assert station.flight.autopilot.armed
    assert math.dist(station.flight.vehicle.velocity, (0.0, 0.0, 0.0)) < 0.1


def test_jumps_that_lead_nowhere_do_no_harm(station: Station) -> None:
    station.fly([item(TAKE_OFF, 0, 0, 3), plain(177, 2, -1), plain(177, 1, -1)])
    station.run(8.0)
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


def test_a_loop_with_nothing_to_fly_is_reported_of_once_a_second_at_most(station: Station) -> None:
    station.fly([item(TAKE_OFF, 0, 0, 3), item(WAYPOINT, 0, 0, 3), plain(177, station.first, -1)])
    station.run(6.0)
    before = len(station.heard)
    station.run(5.0)
    new = [m for m in station.heard[before:] if m.get_type() in ("MISSION_ITEM_REACHED", "STATUSTEXT")]
    assert 4 <= len(new) <= 30
    assert station.first + 2 not in station.reached()  # a jump is no place to be reached
    assert station.flight.vehicle.height_m == pytest.approx(3.0, abs=0.3)


def test_returning_is_an_item_too(station: Station) -> None:
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


def test_px4_heads_where_a_waypoint_says_and_ardupilot_along_the_way(station: Station) -> None:
    station.fly([item(TAKE_OFF, 0, 0, 4), item(WAYPOINT, 0, 20, 4, (0.0, 0.0, 0.0, 180.0))])
    station.run(8.5)
    heading = math.pi if station.autopilot_kind == "px4" else math.pi / 2
    turned = yaw_from_quat(station.flight.vehicle.attitude)
    assert abs(math.remainder(turned - heading, 2.0 * math.pi)) < 0.15


def test_a_mission_can_be_left_and_gone_on_with(station: Station) -> None:
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


def test_without_a_mission_its_mode_is_refused(station: Station) -> None:
    mode, result = (4 << 16 | 4 << 24, 1) if station.autopilot_kind == "px4" else (3, 4)
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
    station.upload(station.mission([item(WAYPOINT, 8, 0, 6)]))
    station.flight.autopilot.set_mode(4)
    station.flight.autopilot.arm()
    assert station.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == 4
    station.run(0.2)
    assert "Auto: Missing Takeoff Cmd" in station.texts


def test_landing_start_and_the_current_item_are_reported(station: Station) -> None:
    assert station.command(mavlink.MAV_CMD_DO_LAND_START) == 4
    station.fly([item(TAKE_OFF, 0, 0, 4), item(17, 20, 0, 4), item(189), item(LAND, 0, 0, 0)])
    station.run(7.0)
    told = [m for m in station.run(1.2) if m.get_type() == "MISSION_CURRENT"]
    assert (told[-1].seq, told[-1].total) == (station.first + 1, 4)
    assert station.command(mavlink.MAV_CMD_DO_LAND_START) == 0
    station.run(25.0)
    assert not station.flight.autopilot.armed
