"""The simulated autopilot's MAVLink port: telemetry, and bytes that nobody should send."""

import math
from collections import Counter
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight

BOTH = pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
NANS = (math.nan,) * 7


class Link:
    """A flight with its endpoint, and a component at the other end."""

    def __init__(self, autopilot_kind: AutopilotKind, booted_s: float = 6.0) -> None:
        self.flight = AutopilotFlight(autopilot_kind)
        self.endpoint = MavlinkEndpoint(self.flight.autopilot)
        self.us = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self.parser = mavlink.MAVLink(None)
        self.heard: list[Any] = []
        self.run(booted_s)

    def run(self, seconds: float) -> list[Any]:
        """Step on, listening at 100 Hz; returns the messages heard meanwhile."""
        new: list[Any] = []
        for _ in range(round(seconds * 100)):
            data = self.endpoint.transmit(self.flight.now_s)
            new += self.parser.parse_buffer(data) or []
            self.flight.run(0.01)
        self.heard += new
        return new

    def send(self, message: Any) -> list[Any]:
        """Send one message; returns what comes back at once."""
        self.endpoint.receive(bytes(message.pack(self.us)), self.flight.now_s)
        return self.run(0.01)

    def command(self, number: int, *parameters: float, target: tuple[int, int] = (1, 1)) -> Any:
        """Send a COMMAND_LONG; returns its COMMAND_ACK, None when there is none."""
        filled = (*parameters, *NANS[len(parameters) :])
        answers = self.send(mavlink.MAVLink_command_long_message(*target, number, 0, *filled))
        return next((m for m in answers if m.get_type() == "COMMAND_ACK"), None)


def of(messages: list[Any], name: str) -> list[Any]:
    return [message for message in messages if message.get_type() == name]


def velocity_message(frame: int, mask: int, velocity: tuple[float, float, float]) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, 0, 0, 0, *velocity, 0, 0, 0, 0.0, 0.0
    )


# ---------------- The simulated autopilot's MAVLink port: telemetry, and bytes that nobody should send

# ---------------------------------------------------------------- telemetry


@BOTH
def test_telemetry_comes_at_its_rates(autopilot_kind: AutopilotKind) -> None:
    link = Link(autopilot_kind)
    counts = Counter(message.get_type() for message in link.run(4.0))
    assert counts["HEARTBEAT"] == 4
    assert counts["ATTITUDE"] == pytest.approx(200, abs=2)
    assert counts["LOCAL_POSITION_NED"] == pytest.approx(120, abs=2)
    assert counts["GLOBAL_POSITION_INT"] == pytest.approx(20, abs=1)
    assert counts["SYS_STATUS"] == pytest.approx(8, abs=1)
    assert counts["EXTENDED_SYS_STATE"] == pytest.approx(20, abs=1)


@BOTH
def test_health_comes_true_once_the_estimator_is_aligned(autopilot_kind: AutopilotKind) -> None:
    link = Link(autopilot_kind, booted_s=0.0)
    early = of(link.run(1.0), "SYS_STATUS")[-1].onboard_control_sensors_health
    assert not early & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert not of(link.heard, "LOCAL_POSITION_NED")
    late = of(link.run(6.0), "SYS_STATUS")[-1]
    for bit in (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO,
        mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
        mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG,
        mavlink.MAV_SYS_STATUS_SENSOR_GPS,
        mavlink.MAV_SYS_STATUS_PREARM_CHECK,
    ):
        by_health_alone = autopilot_kind == "px4" and bit == mavlink.MAV_SYS_STATUS_PREARM_CHECK
        assert bool(late.onboard_control_sensors_present & bit) is not by_health_alone
        assert bool(late.onboard_control_sensors_enabled & bit) is not by_health_alone
        assert late.onboard_control_sensors_health & bit
    assert of(link.heard, "HOME_POSITION")


@BOTH
def test_a_fence_that_is_not_there_is_not_breached(autopilot_kind: AutopilotKind) -> None:
    """MAVProxy takes a missing bit of health for a breach, whether there is a fence or not."""
    status = of(Link(autopilot_kind, booted_s=0.0).run(1.0), "SYS_STATUS")[0]
    assert not status.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_GEOFENCE
    assert not status.onboard_control_sensors_enabled & mavlink.MAV_SYS_STATUS_GEOFENCE
    assert status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_GEOFENCE


def test_an_ardupilots_checks_pass_before_it_knows_where_it_is() -> None:
    link = Link("ardupilot", booted_s=0.0)
    for message in (mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
        link.endpoint.set_interval(message, 0.1)
    link.run(4.0)
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert of(link.heard, "SYS_STATUS")[-1].onboard_control_sensors_health & prearm
    assert of(link.heard, "HOME_POSITION")
    assert not of(link.heard, "EKF_STATUS_REPORT")[-1].flags & mavlink.EKF_POS_HORIZ_ABS
    arming = link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert arming.result == mavlink.MAV_RESULT_FAILED
    link.run(2.0)
    assert of(link.heard, "EKF_STATUS_REPORT")[-1].flags & mavlink.EKF_POS_HORIZ_ABS


def test_heartbeats_tell_who_it_is_and_its_mode() -> None:
    px4, ardupilot = (
        of(Link(autopilot_kind).heard, "HEARTBEAT")[-1] for autopilot_kind in ("px4", "ardupilot")
    )
    assert (px4.autopilot, px4.custom_mode) == (mavlink.MAV_AUTOPILOT_PX4, 0x03040000)
    assert (ardupilot.autopilot, ardupilot.custom_mode) == (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0)
    assert not px4.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_positions_are_the_autopilots_own_and_agree_with_each_other() -> None:
    link = Link("px4")
    link.flight.autopilot.estimate.position_ned_m = (100.0, 50.0, -20.0)
    link.endpoint.set_interval(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 0.0)
    data = link.endpoint.transmit(link.flight.now_s)
    message = of(link.parser.parse_buffer(data), "GLOBAL_POSITION_INT")[-1]
    assert message.lat * 1e-7 == pytest.approx(HOME[0] + 100.0 / 111_170.0, abs=2e-6)
    assert message.lon * 1e-7 == pytest.approx(HOME[1] + 50.0 / 76_056.0, abs=2e-6)
    assert message.alt * 1e-3 == pytest.approx(HOME[2] + 20.0, abs=0.01)


def test_rates_can_be_changed_stopped_and_put_back() -> None:
    link = Link("ardupilot")
    quaternion, attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mavlink.MAVLINK_MSG_ID_ATTITUDE
    assert link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, quaternion, 40_000).result == 0
    assert link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, -1).result == 0
    counts = Counter(m.get_type() for m in link.run(2.0))
    assert counts["ATTITUDE_QUATERNION"] == pytest.approx(50, abs=2)
    assert counts["ATTITUDE"] == 0
    link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, 0)
    assert Counter(m.get_type() for m in link.run(1.0))["ATTITUDE"] == pytest.approx(50, abs=2)
    assert link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 1000).result != 0
    assert link.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, quaternion).result == 0
    assert of(link.heard, "MESSAGE_INTERVAL")[-1].interval_us == 40_000


# ---------------------------------------------------------------- robustness


def test_the_same_seed_sends_the_same_bytes() -> None:
    def bytes_of(seed: int) -> bytes:
        flight = AutopilotFlight("px4", errors=EstimatorErrors(), seed=seed)
        endpoint = MavlinkEndpoint(flight.autopilot)
        out = b""
        for _ in range(500):
            flight.run(0.01)
            out += endpoint.transmit(flight.now_s)
        return out

    assert bytes_of(3) == bytes_of(3)
    assert bytes_of(3) != bytes_of(4)


# ---------------- Commands, setpoints and parameters at the simulated autopilot's MAVLink port

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
