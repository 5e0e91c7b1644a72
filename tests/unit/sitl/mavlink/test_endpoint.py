"""The simulated autopilot's MAVLink port: telemetry, and bytes that nobody should send."""

from __future__ import annotations

from collections import Counter

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.base.autopilot_kind import AutopilotKind
from sitl.autopilot.control.estimator import EstimatorErrors
from sitl.mavlink.endpoint import MavlinkEndpoint
from tests.unit.sitl.autopilot.autopilot_flight import HOME, AutopilotFlight
from tests.unit.sitl.mavlink.endpoint_link import BOTH, Link, of

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
