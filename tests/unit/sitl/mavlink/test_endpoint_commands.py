"""Commands, setpoints and parameters at the simulated autopilot's MAVLink port."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from tests.unit.sitl.autopilot.autopilot_flight import HOME
from tests.unit.sitl.mavlink.endpoint_link import BOTH, NANS, Link, of, velocity_message

# ---------------------------------------------------------------- commands


@BOTH
def test_a_whole_flight_by_commands(autopilot_kind: AutopilotKind) -> None:
    link = Link(autopilot_kind)
    if autopilot_kind == "ardupilot":
        assert link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4).result == 0
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1).result == 0
    height = HOME[2] + 5.0 if autopilot_kind == "px4" else 5.0
    assert link.command(mavlink.MAV_CMD_NAV_TAKEOFF, *NANS[:6], height).result == 0
    link.run(8.0)
    latitude, longitude, altitude = link.flight.autopilot.geodetic((8.0, 3.0, -6.0))
    go = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0.5,
        round(latitude * 1e7), round(longitude * 1e7), altitude,
    )  # fmt: skip
    assert of(link.send(go), "COMMAND_ACK")[0].result == 0
    link.run(9.0)
    assert math.dist(link.flight.vehicle.position, (8.0, 3.0, -6.0)) < 0.3
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0).result in (1, 4)
    assert link.command(mavlink.MAV_CMD_NAV_LAND).result == 0
    link.run(20.0)
    assert not of(link.heard, "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert of(link.heard, "EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


@BOTH
def test_a_waypoint_of_no_mission_is_flown_to_at_once_where_ardupilot_does(
    autopilot_kind: AutopilotKind,
) -> None:
    link = Link(autopilot_kind)
    autopilot = link.flight.autopilot

    def send(current: int, latitude: float) -> Any:
        """As DroneKit's simple_goto: a MISSION_ITEM, with an altitude over home."""
        _, longitude, altitude = autopilot.geodetic((8.0, 3.0, -6.0))
        place = (latitude, longitude, altitude - HOME[2])
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
        item = mavlink.MAVLink_mission_item_message(
            1, 1, 0, frame, mavlink.MAV_CMD_NAV_WAYPOINT, current, 0, 0, 0, 0, 0, *place
        )
        return of(link.send(item), "MISSION_ACK")[0].type

    there = autopilot.geodetic((8.0, 3.0, -6.0))[0]
    assert send(2, there) == mavlink.MAV_MISSION_ERROR  # on the ground
    link.flight.take_off()
    link.run(5.0)
    assert send(2, math.nan) != mavlink.MAV_MISSION_ACCEPTED
    assert send(0, there) == mavlink.MAV_MISSION_ERROR
    if autopilot_kind == "px4":
        assert send(2, there) == mavlink.MAV_MISSION_ERROR
        return
    assert send(2, there) == mavlink.MAV_MISSION_ACCEPTED
    link.run(9.0)
    assert math.dist(link.flight.vehicle.position, (8.0, 3.0, -6.0)) < 0.3
    assert link.command(mavlink.MAV_CMD_NAV_LAND).result == 0
    assert send(2, there) == mavlink.MAV_MISSION_ERROR  # no longer GUIDED


def test_force_disarming_takes_the_magic_number() -> None:
    link = Link("px4")
    link.flight.take_off()
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0).result == 1
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196).result == 0
    assert not link.flight.autopilot.armed


def test_acknowledgements_go_to_the_sender_and_unknown_commands_are_unsupported() -> None:
    link = Link("px4")
    answer = link.command(mavlink.MAV_CMD_DO_DIGICAM_CONTROL)
    assert answer.result == mavlink.MAV_RESULT_UNSUPPORTED
    assert (answer.target_system, answer.target_component) == (1, 191)


@pytest.mark.parametrize("target", [(2, 1), (1, 191), (255, 0)])
def test_commands_for_others_are_left_alone(target: tuple[int, int]) -> None:
    link = Link("px4")
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, target=target) is None
    assert not link.flight.autopilot.armed


@BOTH
def test_the_version_is_sent_when_asked_for(autopilot_kind: AutopilotKind) -> None:
    link = Link(autopilot_kind)
    assert link.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION).result == 0
    version = of(link.heard, "AUTOPILOT_VERSION")[-1]
    for bit in (
        mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT,
    ):
        assert version.capabilities & bit
    assert link.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 4242).result != 0


def test_long_texts_come_in_chunks() -> None:
    link = Link("px4")
    link.flight.take_off()
    link.flight.take_control()
    texts = of(link.run(2.0), "STATUSTEXT")
    chunks = [m for m in texts if m.id]
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert "".join(m.text for m in chunks).startswith("Failsafe activated: No offboard control signal")
    assert len(chunks[-1].text) < 50


# ---------------------------------------------------------------- setpoints


@BOTH
def test_streamed_velocities_are_flown(autopilot_kind: AutopilotKind) -> None:
    link = Link(autopilot_kind)
    link.flight.take_off()
    link.send(velocity_message(1, 0b110111000111, (0.0, 0.0, 0.0)))
    if autopilot_kind == "px4":
        assert link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6).result == 0
    for _ in range(80):
        link.send(velocity_message(1, 0b110111000111, (1.0, -0.5, 0.2)))
        link.run(0.03)
    assert link.flight.vehicle.velocity == pytest.approx((1.0, -0.5, 0.2), abs=0.06)


@pytest.mark.parametrize("broken", [False, True])
def test_streamed_attitudes_are_flown_and_broken_ones_stop_ardupilot(broken: bool) -> None:
    link = Link("ardupilot")
    link.flight.take_off()
    half = math.radians(-5.0) / 2
    tilt = [math.cos(half), 0.0, math.sin(half), 0.0]

    def attitude(q: list[float]) -> Any:
        return mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0b111, q, 0, 0, 0, 0.5)

    for _ in range(30):
        link.send(attitude(tilt))
        if broken:
            link.send(attitude([math.nan] * 4))
            link.send(attitude([0.0] * 4))
        link.run(0.02)
    assert (link.flight.vehicle.velocity[0] > 0.25) is not broken
    assert abs(link.flight.vehicle.velocity[2]) < 0.1


def test_global_positions_are_flown() -> None:
    link = Link("ardupilot")
    link.flight.take_off()
    latitude, longitude, _ = link.flight.autopilot.geodetic((5.0, -4.0, 0.0))
    target = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000,
        round(latitude * 1e7), round(longitude * 1e7), 8.0, 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip
    link.send(target)
    link.run(10.0)
    assert link.flight.vehicle.position == pytest.approx((5.0, -4.0, -8.18), abs=0.2)


# ---------------------------------------------------------------- parameters, time, missions


def test_timesync_requests_are_answered_with_its_own_time() -> None:
    link = Link("px4")
    answer = of(link.send(mavlink.MAVLink_timesync_message(0, 123456789)), "TIMESYNC")[0]
    assert answer.ts1 == 123456789
    assert answer.tc1 == pytest.approx(6.0e9, abs=0.05e9)
    assert not of(link.send(mavlink.MAVLink_timesync_message(5, 6)), "TIMESYNC")
