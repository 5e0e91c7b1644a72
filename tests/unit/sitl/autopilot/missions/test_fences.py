"""Geofences: how they are uploaded, what they mean, and what the autopilots do outside of one."""

from typing import Any, Final

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot.flight.mission_items import Fence, FenceCommand, ItemFrame, MissionItem, MissionResult
from tests.unit.sitl.autopilot.missions.mission_desk import Station, item

FENCE: Final = mavlink.MAV_MISSION_TYPE_FENCE
DEGREE_M: Final = 111_170.0
SQUARE: Final = ((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0))
# its notch is open to the north
NOTCHED: Final = ((-20.0, -20.0), (20.0, -20.0), (0.0, 0.0), (20.0, 20.0), (-20.0, 20.0))
Corners = tuple[tuple[float, float], ...]


def polygon(command: int, corners: Corners = SQUARE) -> list[Any]:
    parameters = (float(len(corners)), 0.0, 0.0, 0.0)
    return [
        item(command, *corner, parameters=parameters, seq=number, frame=5, mission_type=FENCE)
        for number, corner in enumerate(corners)
    ]


def area(command: int, corners: Corners, parameter: float) -> list[MissionItem]:
    """Corners in metres about 0 N, 0 E, where a degree is as long to the east as to the north."""
    parameters = (parameter, 0.0, 0.0, 0.0)
    places = [(north / DEGREE_M, east / DEGREE_M) for north, east in corners]
    return [MissionItem(command, ItemFrame.GLOBAL, parameters, *place) for place in places]


def broken(items: list[MissionItem], north_m: float, east_m: float, *, unite: bool = True) -> bool:
    fence = Fence(unite)
    assert fence.replace(items)
    return fence.broken_at(north_m / DEGREE_M, east_m / DEGREE_M)


@pytest.mark.parametrize(
    ("place", "inside"),
    [((-10.0, 0.0), True), ((10.0, 0.0), False), ((10.0, 15.0), True), ((0.0, 30.0), False)],
)
def test_a_polygon_with_a_notch_holds_what_is_in_it(place: tuple[float, float], inside: bool) -> None:
    assert broken(area(FenceCommand.STAY_IN_POLYGON, NOTCHED, 5.0), *place) is not inside
    assert broken(area(FenceCommand.STAY_OUT_OF_POLYGON, NOTCHED, 5.0), *place) is inside


def test_a_circle_is_as_large_as_its_radius() -> None:
    for command, inside_breaks in (
        (FenceCommand.STAY_IN_CIRCLE, False),
        (FenceCommand.STAY_OUT_OF_CIRCLE, True),
    ):
        circle = area(command, ((5.0, 0.0),), 10.0)
        assert broken(circle, 14.8, 0.0) is inside_breaks
        assert broken(circle, 15.2, 0.0) is not inside_breaks


def test_of_two_areas_to_stay_in_one_is_enough_or_both_are_needed() -> None:
    both = area(FenceCommand.STAY_IN_CIRCLE, ((0.0, 0.0),), 10.0)
    both += area(FenceCommand.STAY_IN_CIRCLE, ((12.0, 0.0),), 10.0)
    assert not broken(both, -5.0, 0.0, unite=True)
    assert broken(both, -5.0, 0.0, unite=False)
    assert not broken(both, 6.0, 0.0, unite=False)
    assert broken(both, 30.0, 0.0, unite=True)


def test_no_fence_is_never_broken() -> None:
    assert not broken([], 1e5, 0.0)
    assert not broken(area(FenceCommand.RETURN_POINT, ((0.0, 0.0),), 0.0), 1e5, 0.0)


def test_a_fence_is_read_back_as_it_was_uploaded_beside_the_mission(station: Station) -> None:
    sent = polygon(FenceCommand.STAY_IN_POLYGON)
    assert station.upload(sent, FENCE) == MissionResult.ACCEPTED
    got = station.download(FENCE)
    assert [(m.seq, m.command, m.param1, m.x, m.y, m.mission_type) for m in got] == [
        (m.seq, m.command, m.param1, m.x, m.y, FENCE) for m in sent
    ]
    assert station.download() == []
    assert station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, FENCE))[-1].type == 0
    assert station.download(FENCE) == []


def test_a_polygon_that_lacks_corners_is_refused_and_the_old_fence_stays(station: Station) -> None:
    assert station.upload(polygon(FenceCommand.STAY_IN_POLYGON), FENCE) == 0
    short = polygon(FenceCommand.STAY_IN_POLYGON)[:3]
    assert station.upload(short, FENCE) == MissionResult.ERROR
    assert station.upload(polygon(FenceCommand.STAY_IN_POLYGON, SQUARE[:2]), FENCE) == MissionResult.ERROR
    waypoint = item(16, frame=5, mission_type=FENCE)
    assert station.upload([waypoint], FENCE) == MissionResult.UNSUPPORTED
    assert len(station.download(FENCE)) == 4


@pytest.mark.parametrize(("autopilot_kind", "result"), [("px4", 0), ("ardupilot", 1)])
def test_mavsdks_circle_of_no_size_is_an_error_to_an_ardupilot(
    autopilot_kind: AutopilotKind, result: int
) -> None:
    """MAVSDK's example sends one for "no circle"; the real ArduCopter refuses it."""
    circle = item(FenceCommand.STAY_IN_CIRCLE, seq=4, frame=5, mission_type=FENCE)
    assert Station(autopilot_kind).upload([*polygon(FenceCommand.STAY_IN_POLYGON), circle], FENCE) == result


def fenced_flight(autopilot_kind: AutopilotKind, action: float) -> Station:
    """On the way to a place 60 m north, inside a square of 20 m."""
    station = Station(autopilot_kind)
    parameters = station.flight.autopilot.parameters
    assert parameters.set("GF_ACTION" if autopilot_kind == "px4" else "FENCE_ACTION", action)
    assert station.upload(polygon(FenceCommand.STAY_IN_POLYGON), FENCE) == 0
    if autopilot_kind == "ardupilot":
        assert station.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 1) == 0
    else:
        assert station.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 1) == 3
    station.fly([item(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 5.0), item(16, 60.0, 0.0, 5.0)])
    return station


@pytest.mark.parametrize(
    ("autopilot_kind", "action", "mode"),
    [("px4", 2, "AUTO_LOITER"), ("px4", 3, "AUTO_RTL"), ("ardupilot", 1, "RTL"), ("ardupilot", 4, "BRAKE")],
)
def test_outside_the_fence_it_does_what_the_parameter_says(
    autopilot_kind: AutopilotKind, action: float, mode: str
) -> None:
    station = fenced_flight(autopilot_kind, action)
    autopilot = station.flight.autopilot
    bits = []
    for _ in range(400):
        bits += [m for m in station.run(0.1) if m.get_type() == "SYS_STATUS"]
        if autopilot.mode == mode:
            break
    assert autopilot.mode == mode
    assert 19.0 < station.flight.vehicle.position[0] < 26.0
    bits += [m for m in station.run(1.0) if m.get_type() == "SYS_STATUS"]
    geofence = mavlink.MAV_SYS_STATUS_GEOFENCE
    assert bits[0].onboard_control_sensors_health & geofence
    assert bits[0].onboard_control_sensors_enabled & geofence
    assert not all(status.onboard_control_sensors_health & geofence for status in bits)
    assert any("fence" in text.lower() for text in station.texts)


def test_an_ardupilot_whose_fence_is_off_flies_on_through_it() -> None:
    station = fenced_flight("ardupilot", 1)
    assert station.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 0) == 0
    station.run(25.0)
    assert station.flight.vehicle.position[0] > 40.0
    assert station.flight.autopilot.mode == "AUTO"


@pytest.mark.parametrize(
    ("parameters", "mode"),
    [
        ({"FENCE_RADIUS": 30.0}, "RTL"),
        ({"FENCE_RADIUS": 30.0, "FENCE_ACTION": 4.0}, "BRAKE"),
        ({"FENCE_RADIUS": 30.0, "FENCE_TYPE": 5.0}, "AUTO"),  # without the circle
        ({"FENCE_RADIUS": 30.0, "FENCE_ENABLE": 0.0}, "AUTO"),
        ({"FENCE_RADIUS": 80.0}, "AUTO"),
        ({"FENCE_ALT_MAX": 10.0}, "RTL"),
    ],
)
def test_an_ardupilot_has_a_circle_and_a_ceiling_of_its_own(parameters: dict[str, float], mode: str) -> None:
    station = Station("ardupilot")
    for name, value in {"FENCE_ENABLE": 1.0, **parameters}.items():
        assert station.flight.autopilot.parameters.set(name, value)
    way = [
        item(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 5.0),
        item(16, 60.0, 0.0, 5.0),
        item(16, 60.0, 0.0, 15.0),
    ]
    station.fly(way)
    for _ in range(300):
        station.run(0.1)
        if station.flight.autopilot.mode == mode != "AUTO":
            break
    north_m, _, down_m = station.flight.vehicle.position
    assert station.flight.autopilot.mode == mode
    if mode == "AUTO":
        assert north_m > 40.0
    elif "FENCE_ALT_MAX" in parameters:
        assert 9.5 < -down_m < 11.5
    else:
        assert 29.0 < north_m < 36.0
