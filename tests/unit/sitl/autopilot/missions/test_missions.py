"""Missions over MAVLink: uploaded, refused and downloaded as each autopilot does."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.missions.mission_desk import Station, item, mission, plain
from tests.unit.sitl.autopilot.missions.mission_items import BOTH, LAND, TAKE_OFF, WAYPOINT


def count(number: int, mission_type: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, number, mission_type)


def results(messages: list[Any]) -> list[int]:
    return [m.type for m in messages if m.get_type() == "MISSION_ACK"]


@BOTH
def test_a_mission_comes_back_as_it_was_sent(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    sent = mission(
        autopilot_kind, [item(TAKE_OFF, 0, 0, 5), item(WAYPOINT, 10, -4, 6), plain(178, 1, 3), item(LAND)]
    )
    assert station.upload(sent) == 0
    back = station.download()
    assert [m.command for m in back] == [m.command for m in sent]
    flown = slice(1, None) if autopilot_kind == "ardupilot" else slice(None)
    for ours, theirs in zip(sent[flown], back[flown], strict=True):
        assert (ours.x, ours.y, ours.z) == (theirs.x, theirs.y, theirs.z)
        assert ours.param1 == theirs.param1
    assert back[-1].frame == (6 if autopilot_kind == "px4" else 3)


def test_ardupilots_item_0_is_home_whatever_was_sent() -> None:
    station = Station("ardupilot")
    station.upload(mission("ardupilot", [item(WAYPOINT, 10, 0, 5)]))
    home = station.download()[0]
    assert home.frame == mavlink.MAV_FRAME_GLOBAL
    assert home.z == pytest.approx(400.18, abs=0.05)


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


@BOTH
def test_a_request_that_got_lost_is_repeated_and_silence_ends_the_upload(
    autopilot_kind: AutopilotKind,
) -> None:
    station = Station(autopilot_kind)
    station.send(count(2))
    repeated = [m for m in station.run(2.2) if m.get_type().startswith("MISSION_REQUEST")]
    assert len(repeated) == pytest.approx(8 if autopilot_kind == "px4" else 2, abs=1)
    assert {m.seq for m in repeated} == {0}
    assert results(station.run(7.0)) == [15]
    assert results(station.send(item(WAYPOINT))) == [1]


@BOTH
def test_an_item_out_of_sequence_does_not_end_the_upload(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    items = mission(
        autopilot_kind, [item(WAYPOINT, 1, 0, 5), item(WAYPOINT, 2, 0, 5), item(WAYPOINT, 3, 0, 5)]
    )
    station.send(count(len(items)))
    answer = station.send(items[2])[-1]
    if autopilot_kind == "px4":
        assert (answer.get_type(), answer.seq) == ("MISSION_REQUEST_INT", 0)
    else:
        assert results([answer]) == [13]
    for each in items:
        answers = station.send(each)
    assert results(answers) == [0]
    # its acknowledgement was lost, so the client sends the last item again
    assert results(station.send(items[-1])) == [0]


def test_a_second_count_starts_ardupilot_anew_and_is_refused_by_a_busy_px4() -> None:
    for autopilot_kind, expected in (("px4", [1]), ("ardupilot", [])):
        station = Station(autopilot_kind)  # type: ignore[arg-type]
        items = mission(autopilot_kind, [item(WAYPOINT, n, 0, 5) for n in range(3)])  # type: ignore[arg-type]
        station.send(count(len(items)))
        station.send(items[0])
        answers = station.send(count(2))
        assert results(answers) == expected
        if autopilot_kind == "ardupilot":
            assert answers[-1].seq == 0


@BOTH
def test_somebody_elses_items_are_denied(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind)
    station.send(count(1))
    station.us.srcSystem = 254
    assert results(station.send(item(WAYPOINT)))[0] != 0
    assert results(station.send(count(1)))[0] != 0
    station.us.srcSystem = 255
    assert results(station.send(item(WAYPOINT))) == [0]


@BOTH
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


@BOTH
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
def test_wrong_items_are_refused(autopilot_kind: AutopilotKind, wrong: Any, result: int) -> None:
    station = Station(autopilot_kind)
    station.send(count(1))
    assert results(station.send(wrong)) == [result]


def test_conditions_and_circles_are_ardupilots_alone() -> None:
    for command in (18, 82, 112, 115):
        assert Station("px4", 0.1).upload([item(command)]) == 3
        assert Station("ardupilot", 0.1).upload([item(command)]) == 0


@BOTH
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


@BOTH
def test_clearing_and_choosing_the_current_item(autopilot_kind: AutopilotKind) -> None:
    station = Station(autopilot_kind, 0.1)
    station.upload(mission(autopilot_kind, [item(WAYPOINT, n, 0, 5) for n in range(4)]))
    current = station.send(mavlink.MAVLink_mission_set_current_message(1, 1, 2))
    assert current[-1].seq == 2
    assert station.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 3) == 0
    assert station.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 30) != 0
    assert station.flight.autopilot.mission.current == 3
    assert results(station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))) == [0]
    assert station.send(mavlink.MAVLink_mission_request_list_message(1, 1))[-1].count == 0


def test_part_of_ardupilots_list_can_be_replaced() -> None:
    station = Station("ardupilot", 0.1)
    items = mission("ardupilot", [item(WAYPOINT, n, 0, 5) for n in range(4)])
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
