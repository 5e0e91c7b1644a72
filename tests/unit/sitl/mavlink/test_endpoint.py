"""The simulated autopilot's MAVLink port: telemetry, and bytes that nobody should send."""

import math
from collections import Counter

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight
from tests.unit.sitl.autopilot.missions.mission_desk import NANS, Station, of


@pytest.fixture
def link(autopilot_kind: AutopilotKind) -> Station:
    """At the rate of what is streamed fastest."""
    return Station(autopilot_kind, rate_hz=100)


# ---------------------------------------------------------------- telemetry


def test_telemetry_comes_at_its_rates(link: Station) -> None:
    counts = Counter(message.get_type() for message in link.run(4.0))
    assert counts["HEARTBEAT"] == 4
    rates_hz = {"ATTITUDE": 50, "LOCAL_POSITION_NED": 30, "GLOBAL_POSITION_INT": 5, "SYS_STATUS": 2}
    for name, rate_hz in (rates_hz | {"EXTENDED_SYS_STATE": 5}).items():
        assert counts[name] == pytest.approx(4 * rate_hz, abs=2 if rate_hz > 5 else 1), name


def test_health_comes_true_once_the_estimator_is_aligned(autopilot_kind: AutopilotKind) -> None:
    link = Station(autopilot_kind, 0.0)
    statuses = of(link.run(1.0), "SYS_STATUS")
    prearm, fence = mavlink.MAV_SYS_STATUS_PREARM_CHECK, mavlink.MAV_SYS_STATUS_GEOFENCE
    assert not statuses[-1].onboard_control_sensors_health & prearm
    assert not of(link.heard, "LOCAL_POSITION_NED")
    # MAVProxy takes a missing bit of health for a breach, whether there is a fence or not
    assert not statuses[0].onboard_control_sensors_present & fence
    assert not statuses[0].onboard_control_sensors_enabled & fence
    assert statuses[0].onboard_control_sensors_health & fence
    late = of(link.run(6.0), "SYS_STATUS")[-1]
    sensors = ("3D_GYRO", "3D_ACCEL", "3D_MAG", "GPS")
    for bit in (*(getattr(mavlink, f"MAV_SYS_STATUS_SENSOR_{name}") for name in sensors), prearm):
        by_health_alone = autopilot_kind == "px4" and bit == prearm
        assert bool(late.onboard_control_sensors_present & bit) is not by_health_alone
        assert bool(late.onboard_control_sensors_enabled & bit) is not by_health_alone
        assert late.onboard_control_sensors_health & bit
    assert of(link.heard, "HOME_POSITION")


def test_an_ardupilots_checks_pass_before_it_knows_where_it_is() -> None:
    link, absolute = Station("ardupilot", 0.0), mavlink.EKF_POS_HORIZ_ABS
    for message in (mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
        link.endpoint.set_interval(message, 0.1)
    link.run(4.0)
    health = of(link.heard, "SYS_STATUS")[-1].onboard_control_sensors_health
    assert health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert of(link.heard, "HOME_POSITION")
    assert not of(link.heard, "EKF_STATUS_REPORT")[-1].flags & absolute
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_FAILED
    link.run(2.0)
    assert of(link.heard, "EKF_STATUS_REPORT")[-1].flags & absolute


def test_heartbeats_tell_who_it_is_and_its_mode(link: Station) -> None:
    beat = of(link.heard, "HEARTBEAT")[-1]
    assert (beat.autopilot, beat.custom_mode) == {
        "px4": (mavlink.MAV_AUTOPILOT_PX4, 0x03040000),
        "ardupilot": (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0),
    }[link.autopilot_kind]
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_positions_are_the_autopilots_own_and_agree_with_each_other() -> None:
    link = Station("px4")
    link.flight.autopilot.estimate.position_ned_m = (100.0, 50.0, -20.0)
    link.endpoint.set_interval(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 0.0)
    data = link.endpoint.transmit(link.flight.now_s)
    message = of(link.parser.parse_buffer(data), "GLOBAL_POSITION_INT")[-1]
    assert message.lat * 1e-7 == pytest.approx(HOME[0] + 100.0 / 111_170.0, abs=2e-6)
    assert message.lon * 1e-7 == pytest.approx(HOME[1] + 50.0 / 76_056.0, abs=2e-6)
    assert message.alt * 1e-3 == pytest.approx(HOME[2] + 20.0, abs=0.01)


def test_rates_can_be_changed_stopped_and_put_back() -> None:
    link, interval = Station("ardupilot", rate_hz=100), mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    quaternion, attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mavlink.MAVLINK_MSG_ID_ATTITUDE
    assert link.command(interval, quaternion, 40_000) == 0
    assert link.command(interval, attitude, -1) == 0
    heard = link.run(2.0)
    assert len(of(heard, "ATTITUDE_QUATERNION")) == pytest.approx(50, abs=2)
    assert not of(heard, "ATTITUDE")
    link.command(interval, attitude, 0)
    assert len(of(link.run(1.0), "ATTITUDE")) == pytest.approx(50, abs=2)
    assert link.command(interval, 9999, 1000) != 0
    assert link.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, quaternion) == 0
    assert of(link.heard, "MESSAGE_INTERVAL")[-1].interval_us == 40_000


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


def test_timesync_requests_are_answered_with_its_own_time() -> None:
    station = Station("px4")
    station.send(mavlink.MAVLink_timesync_message(0, 123456789))
    station.send(mavlink.MAVLink_timesync_message(5, 6))
    (answer,) = of(station.heard, "TIMESYNC")
    assert answer.ts1 == 123456789
    assert answer.tc1 == pytest.approx(6.0e9, abs=0.05e9)


# ---------------------------------------------------------------- commands


def test_a_whole_flight_by_commands(link: Station) -> None:
    arm_disarm, height = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, HOME[2] + 5.0
    if link.autopilot_kind == "ardupilot":
        assert link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4) == 0
        height = 5.0
    assert link.command(arm_disarm, 1) == 0
    assert link.command(mavlink.MAV_CMD_NAV_TAKEOFF, *NANS[:6], height) == 0
    link.run(8.0)
    latitude, longitude, altitude = link.flight.autopilot.geodetic((8.0, 3.0, -6.0))
    go = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0.5,
        round(latitude * 1e7), round(longitude * 1e7), altitude,
    )  # fmt: skip
    assert link.result(go) == 0
    link.run(9.0)
    assert math.dist(link.flight.vehicle.position, (8.0, 3.0, -6.0)) < 0.3
    # in the air: not by 0 alone, nor by another number than the magic one
    for force in ((), (1.0,)):
        assert link.command(arm_disarm, 0, *force) in (1, 4)
    assert link.command(mavlink.MAV_CMD_NAV_LAND) == 0
    link.run(21.0)
    assert not of(link.heard, "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert of(link.heard, "EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


def test_a_waypoint_of_no_mission_is_flown_to_at_once_where_ardupilot_does(station: Station) -> None:
    there, longitude, altitude = station.flight.autopilot.geodetic((8.0, 3.0, -6.0))

    def send(current: int, latitude: float = there) -> int:
        """As DroneKit's simple_goto: a MISSION_ITEM, with an altitude over home."""
        frame, place = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, (latitude, longitude, altitude - HOME[2])
        item = mavlink.MAVLink_mission_item_message(
            1, 1, 0, frame, mavlink.MAV_CMD_NAV_WAYPOINT, current, 0, 0, 0, 0, 0, *place
        )
        return int(of(station.send(item), "MISSION_ACK")[0].type)

    assert send(2) == mavlink.MAV_MISSION_ERROR  # on the ground
    station.flight.take_off()
    station.run(5.0)
    assert send(2, math.nan) != mavlink.MAV_MISSION_ACCEPTED
    assert send(0) == mavlink.MAV_MISSION_ERROR
    if station.autopilot_kind == "px4":
        assert send(2) == mavlink.MAV_MISSION_ERROR
        return
    assert send(2) == mavlink.MAV_MISSION_ACCEPTED
    station.run(9.0)
    assert math.dist(station.flight.vehicle.position, (8.0, 3.0, -6.0)) < 0.3
    assert station.command(mavlink.MAV_CMD_NAV_LAND) == 0
    assert send(2) == mavlink.MAV_MISSION_ERROR  # no longer GUIDED


def test_force_disarming_takes_the_magic_number_and_long_texts_come_in_chunks() -> None:
    station = Station("px4", rate_hz=100)
    station.flight.take_off()
    station.flight.take_control()
    chunks = [m for m in of(station.run(2.0), "STATUSTEXT") if m.id]
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert "".join(m.text for m in chunks).startswith("Failsafe activated: No offboard control signal")
    assert len(chunks[-1].text) < 50
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0) == 1
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0
    assert not station.flight.autopilot.armed


def test_acknowledgements_go_to_the_sender_and_commands_for_others_are_left_alone() -> None:
    station = Station("px4")
    assert station.command(mavlink.MAV_CMD_DO_DIGICAM_CONTROL) == mavlink.MAV_RESULT_UNSUPPORTED
    answer = of(station.heard, "COMMAND_ACK")[-1]
    assert (answer.target_system, answer.target_component) == (255, 190)
    for target in ((2, 1), (1, 191), (255, 0)):
        arm = mavlink.MAVLink_command_long_message(
            *target, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, *NANS[1:]
        )
        assert station.send(arm) == []
        assert not station.flight.autopilot.armed


def test_the_version_is_sent_when_asked_for(station: Station) -> None:
    request = mavlink.MAV_CMD_REQUEST_MESSAGE
    assert station.command(request, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    version = of(station.heard, "AUTOPILOT_VERSION")[-1]
    for bit in ("MAVLINK2", "SET_POSITION_TARGET_LOCAL_NED", "COMMAND_INT"):
        assert version.capabilities & getattr(mavlink, f"MAV_PROTOCOL_CAPABILITY_{bit}")
    assert station.command(request, 4242) != 0


# ---------------------------------------------------------------- setpoints


def test_streamed_velocities_are_flown(station: Station) -> None:
    def stream(*velocity: float) -> None:
        station.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, 0b110111000111, 0, 0, 0, *velocity, 0, 0, 0, 0.0, 0.0
            )
        )

    station.flight.take_off()
    stream(0.0, 0.0, 0.0)
    if station.autopilot_kind == "px4":
        assert station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6) == 0
    for _ in range(64):
        stream(1.0, -0.5, 0.2)
        station.run(0.05)
    assert station.flight.vehicle.velocity == pytest.approx((1.0, -0.5, 0.2), abs=0.06)


@pytest.mark.parametrize("broken", [False, True])
def test_streamed_attitudes_are_flown_and_broken_ones_stop_ardupilot(broken: bool) -> None:
    station = Station("ardupilot", rate_hz=50)
    station.flight.take_off()
    half = math.radians(-5.0) / 2
    tilt = [math.cos(half), 0.0, math.sin(half), 0.0]
    for _ in range(45):
        for q in (tilt, [math.nan] * 4, [0.0] * 4)[: 3 if broken else 1]:
            station.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0b111, q, 0, 0, 0, 0.5))
        station.run(0.02)
    assert (station.flight.vehicle.velocity[0] > 0.25) is not broken
    assert abs(station.flight.vehicle.velocity[2]) < 0.1


def test_global_positions_are_flown() -> None:
    station = Station("ardupilot")
    station.flight.take_off()
    latitude, longitude, _ = station.flight.autopilot.geodetic((5.0, -4.0, 0.0))
    target = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000,
        round(latitude * 1e7), round(longitude * 1e7), 8.0, 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip
    station.send(target)
    station.run(10.0)
    assert station.flight.vehicle.position == pytest.approx((5.0, -4.0, -8.18), abs=0.2)
