"""The session: what it sends when, whom it believes, and what it takes for the autopilot's state."""

import math
from typing import Any

import pytest
from pydantic import ValidationError

from companion.base.geometry import quat_from_euler, yaw_from_quat
from companion.base.messages import LandingTargetPose, Setpoint
from companion.config import LinkConfig, SenseConfig
from companion.link.codec import Codec, heartbeat, mavlink, status_texts
from companion.link.session import UNHEARD, Session
from companion.link.streams import telemetry_rates_hz
from companion.link.timesync import clock_ns
from companion.plan.mission.readiness import refused_words
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.session_flight import SessionFlight

PX4_RATES_HZ = telemetry_rates_hz("px4")


def test_heartbeats_go_out_at_1_hz_though_nobody_answers() -> None:
    flight = SessionFlight()
    flight.cut = True
    flight.run(5.5)
    times = [time_s for time_s, _ in flight.sent_of("HEARTBEAT")]
    assert len(times) == 6
    assert {m.get_type() for _, m in flight.sent} == {"HEARTBEAT"}


def test_the_autopilot_is_connected_ready_and_known() -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(believes_in_air=True))
    flight.run(2.0)
    state = flight.session.state
    assert (state.connected, state.autopilot_kind, state.mode, state.ready_to_arm) == (
        True,
        "px4",
        "AUTO.LOITER",
        True,
    )
    assert state.home == pytest.approx((47.0, 8.0, 400.0))
    assert state.landed == "in_air"


def mavlink_1(frames: bytes) -> bytes:
    """The same messages in version 1."""
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return b"".join(m.pack(packer, force_mavlink1=True) for m in Codec(1, 1).decode(frames))


def test_a_stream_of_mavlink_1_is_not_taken_and_named_until_it_becomes_version_2() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    for k in range(5):
        session.receive(mavlink_1(autopilot.tick(float(k))), float(k))
        session.tick(float(k))
    assert (session.state.connected, session.state.mavlink_1) == (False, True)
    assert "MAVLink 1; expected MAVLink 2" in refused_words(session.state)
    session.receive(autopilot.tick(6.0), 6.0)
    assert (session.state.connected, session.state.mavlink_1) == (True, False)
    # one that is up is not given up for it
    session.receive(mavlink_1(autopilot.tick(7.0)), 7.0)
    session.tick(7.0)
    assert (session.state.connected, session.state.mavlink_1) == (True, False)


def test_an_ardupilots_filter_is_asked_for_and_forgotten_with_the_connection() -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED"))
    flight.run(2.0)
    assert flight.session.state.ready_to_arm
    assert flight.session.state.ekf_ready is True
    flight.cut = True
    flight.run(4.0)
    assert flight.session.state.ekf_ready is None


def test_every_rate_is_asked_for_once_when_it_is_honoured() -> None:
    flight = SessionFlight()
    flight.run(12.0)
    asked = [m.param1 for m in flight.autopilot.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)]
    assert sorted(asked) == sorted(PX4_RATES_HZ)
    assert flight.autopilot.rates_hz == pytest.approx(PX4_RATES_HZ, rel=1e-3)


def test_a_rate_that_another_program_lowers_is_asked_for_again() -> None:
    flight = SessionFlight()
    flight.run(3.0)
    flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 1.0
    flight.run(5.0)
    assert flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] == pytest.approx(5.0)


def test_a_rate_request_that_is_lost_is_repeated() -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(deaf_to={mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: 2}))
    flight.run(2.0)
    assert set(flight.autopilot.rates_hz) == set(PX4_RATES_HZ)


def test_home_is_asked_for_until_it_is_known_and_again_after_arming() -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(deaf_to={mavlink.MAV_CMD_REQUEST_MESSAGE: 3}))

    def asked() -> int:
        requests = flight.autopilot.commands(mavlink.MAV_CMD_REQUEST_MESSAGE)
        return sum(request.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION for request in requests)

    flight.run(6.0)
    assert flight.session.state.home is not None
    count = asked()
    flight.run(5.0)
    assert asked() == count
    flight.autopilot.armed = True
    flight.run(1.5)
    assert asked() == count + 1


def test_after_arming_home_is_asked_for_until_it_comes_though_the_old_one_is_known() -> None:
    session, autopilot = Session(LinkConfig()), Codec(1, 1)

    def hears(now_s: float, *messages: Any) -> int:
        """How often home is asked for in the second after it."""
        for message in messages:
            session.receive(autopilot.encode(message), now_s)
        asked = 0
        for tenth in range(10):
            for message in Codec(1).decode(session.tick(now_s + 0.1 * tenth)):
                if message.get_type() == "COMMAND_LONG" and message.command == request:
                    session.receive(autopilot.encode(accepted), now_s + 0.1 * tenth)
                    asked += message.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION
        return asked

    request = mavlink.MAV_CMD_REQUEST_MESSAGE
    accepted = mavlink.MAVLink_command_ack_message(request, 0, 0, 0, 1, 191)
    ground = FakeAutopilot()
    home = ground.message(mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.0)
    beat = ground.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0.0)
    ground.armed = True
    armed = ground.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0.0)
    assert [hears(1.0, beat, home), hears(2.0, beat)] == [1, 0]
    # what is asked at arming is accepted, and its answer is lost
    assert [hears(3.0 + second, armed) for second in range(6)] == [1, 0, 1, 0, 1, 0]
    assert [hears(9.0, home, armed), *(hears(10.0 + second, armed) for second in range(4))] == [1] + [0] * 4


def test_silence_is_a_lost_connection_and_everything_is_asked_for_again_afterwards() -> None:
    flight = SessionFlight()
    flight.run(3.0)
    flight.cut = True
    flight.run(1.9)
    assert flight.is_connected()
    flight.run(1.3)
    assert not flight.is_connected()
    assert not flight.session.state.ready_to_arm
    flight.autopilot.rates_hz.clear()
    flight.cut = False
    flight.run(2.0)
    assert flight.is_connected()
    assert set(flight.autopilot.rates_hz) == set(PX4_RATES_HZ)


def test_only_our_autopilot_is_believed() -> None:
    session = Session(LinkConfig(system_id=1))
    camera, ground = Codec(1, 100), Codec(255, 190)
    other = FakeAutopilot(system_id=2, armed=True)
    session.receive(camera.encode(heartbeat()) + ground.encode(heartbeat()) + other.tick(0.0), 0.0)
    assert session.state.mode == ""
    assert session.stranger == 2
    session.receive(FakeAutopilot().tick(0.0), 0.0)
    session.receive(other.tick(2.0), 2.0)
    assert session.state.connected
    assert not session.state.armed


def test_with_system_id_0_the_first_autopilot_is_adopted_and_its_id_is_ours() -> None:
    session = Session(LinkConfig(system_id=0))
    session.receive(Codec(255, 190).encode(heartbeat()), 0.0)
    session.receive(FakeAutopilot(system_id=42).tick(0.0), 0.0)
    session.receive(FakeAutopilot(system_id=2, armed=True).tick(0.1), 0.1)
    assert session.system_id == 42
    assert not session.state.armed
    assert {m.get_srcSystem() for m in Codec(1).decode(session.tick(0.2))} == {42}


def on_the_ground(session: Session, autopilot: FakeAutopilot, now_s: float) -> None:
    landed = autopilot.message(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, now_s)
    session.receive(autopilot.codec.encode(landed), now_s)


def test_an_old_landed_state_is_none() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    session.receive(autopilot.tick(0.0), 0.0)
    on_the_ground(session, autopilot, 0.5)
    session.tick(1.9)
    assert (session.state.landed, session.state.landed_time_s) == ("on_ground", 0.5)
    session.tick(2.1)
    assert session.state.landed == "undefined"
    assert session.state.connected
    on_the_ground(session, autopilot, 2.2)
    session.tick(2.3)
    assert session.state.landed == "on_ground"


@pytest.mark.parametrize("lost", [False, True])
def test_an_old_position_is_none(lost: bool) -> None:
    # GIVEN a position; WHEN no other comes, or the autopilot says that it knows none any more
    session, autopilot = Session(LinkConfig()), FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED")
    session.receive(autopilot.tick(0.0), 0.0)
    position = mavlink.MAVLink_global_position_int_message(500, 470000000, 80000000, 404000, 0, 0, 0, 0, 0)
    unknown = mavlink.MAVLink_global_position_int_message(1900, 0, 0, 404000, 0, 0, 0, 0, 0)
    session.receive(autopilot.codec.encode(position), 0.5)
    if lost:
        session.receive(autopilot.codec.encode(unknown), 1.9)
    session.tick(1.9)
    assert session.state.global_position == pytest.approx((47.0, 8.0, 404.0))
    session.tick(2.1)
    # THEN the last one is forgotten, until there is one again
    assert session.state.global_position is None
    assert session.state.connected
    session.receive(autopilot.codec.encode(position), 2.2)
    session.tick(2.3)
    assert session.state.global_position is not None


def test_a_lost_link_makes_up_no_landing_no_disarming_and_no_pilot() -> None:
    session, autopilot = (
        Session(LinkConfig(heartbeat_timeout_s=1.0)),
        FakeAutopilot(mode="OFFBOARD", armed=True),
    )
    session.receive(autopilot.tick(0.0), 0.0)
    on_the_ground(session, autopilot, 0.9)
    session.tick(1.1)
    state = session.state
    assert (state.connected, state.landed, state.ready_to_arm) == (False, "undefined", False)
    assert (state.armed, state.offboard, state.mode) == (True, True, "OFFBOARD")


def test_setpoints_are_turned_into_the_autopilots_heading() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot(heading_rad=math.radians(95.0))
    session.receive(autopilot.tick(0.0), 0.0)
    attitude = autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, 1.0)
    session.receive(autopilot.codec.encode(attitude), 1.0)
    session.align(quat_from_euler(0.0, 0.0, math.radians(90.0)), 1.0)
    [message] = Codec(1).decode(session.send_setpoint(Setpoint(1.0, (1.0, 0.0, 0.2)), 1.0))
    c, s = math.cos(math.radians(5.0)), math.sin(math.radians(5.0))
    assert (message.vx, message.vy, message.vz) == pytest.approx((c, s, 0.2), abs=1e-6)
    assert message.yaw == pytest.approx(math.radians(5.0), abs=1e-6)
    assert message.target_system == 1


def test_a_notice_becomes_a_status_text() -> None:
    messages = Codec(1).decode(Session(LinkConfig()).send_notice("pad lost: climbing by 2 m", "warning"))
    assert [m.text for m in messages] == ["pad lost: climbing by 2 m"]


def test_figures_in_a_notice_stay_readable_in_ascii() -> None:
    [message] = Codec(1).decode(Session(LinkConfig()).send_notice("1.0 ±0.1 m/s², 5° off, 30 µT", "warning"))
    assert message.text == "1.0 +-0.1 m/s2, 5deg off, 30 uT"


def texts_of(flight: SessionFlight) -> list[str]:
    return [m.text for _, m in flight.sent_of("STATUSTEXT")]


def test_warnings_told_into_a_silent_link_are_sent_again_once_when_it_is_heard() -> None:
    flight = SessionFlight()
    flight.run(3.0)
    flight.send(flight.session.send_notice("camera lost", "error"))
    flight.run(1.0)
    flight.cut = True
    flight.run(0.5)  # not yet known as silent
    told = ["hold: link lost", "climbing 1.2 m clear of the pad", "abort: timeout"]
    for text in told:
        flight.send(flight.session.send_notice(text, "warning"))
        flight.run(1.0)
    flight.send(flight.session.send_notice("page opened", "info"))
    flight.send(flight.session.send_notice(told[0], "warning"))
    flight.run(0.5)
    flight.sent.clear()
    flight.cut = False
    flight.run(5.0)
    assert texts_of(flight) == told
    assert flight.sent_of("STATUSTEXT")[0][0] < flight.now_s - 4.9


def test_of_many_warnings_told_into_a_silent_link_the_last_few_are_sent_again() -> None:
    flight = SessionFlight()
    flight.run(2.0)
    flight.cut = True
    flight.run(2.0)
    for number in range(20):
        flight.send(flight.session.send_notice(f"warning {number}", "warning"))
    flight.sent.clear()
    flight.cut = False
    flight.run(2.0)
    assert texts_of(flight) == [f"warning {number}" for number in range(20 - UNHEARD, 20)]


def test_a_text_told_into_a_link_that_is_up_is_sent_once() -> None:
    flight = SessionFlight()
    flight.send(flight.session.send_notice("standby", "warning"))  # before it is heard it may hear us
    flight.run(3.0)
    flight.send(flight.session.send_notice("pad lost", "warning"))
    flight.run(1.0)
    flight.cut = True  # after it arrived
    flight.run(3.0)
    flight.cut = False
    flight.run(3.0)
    assert texts_of(flight) == ["standby", "pad lost"]


def test_texts_of_the_autopilot_are_kept_and_counted() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    for message in status_texts("Takeoff detected", "info", 1):
        session.receive(autopilot.codec.encode(message), 1.0)
    assert session.state.texts == ("Takeoff detected",)
    assert session.texts_heard == 1


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    "connection",
    ["serial:/dev/ttyAMA0:921600", "serial:/dev/serial/by-path/pci-0000:00:14.0:57600", "udp:pi.local:1"],
)
def test_connections_of_the_known_forms_are_taken(connection: str) -> None:
    assert LinkConfig(connection=connection).connection == connection


@pytest.mark.parametrize(
    "connection",
    ["", "/dev/ttyAMA0", "tcp:host", "udp:host", "udpin:host:0", "udp:host:65536", "serial:x:57600"],
)
def test_connections_of_other_forms_are_refused(connection: str) -> None:
    with pytest.raises(ValidationError, match=r"expected serial:PATH:BAUD"):
        LinkConfig(connection=connection)


def test_mavsdk_and_we_cannot_be_the_same_component() -> None:
    with pytest.raises(ValidationError, match="differ"):
        LinkConfig(component_id=192)


def test_another_companion_with_our_ids_is_noticed_and_an_echo_is_none() -> None:
    flight = SessionFlight()
    flight.run(2.0)
    ids = (flight.session.system_id, LinkConfig().component_id)
    (_, ours), *_ = flight.sent_of("HEARTBEAT")
    for beat in (
        Codec(*ids).encode(ours),  # a router that sends back what it gets
        Codec(ids[0], 154).encode(heartbeat(7)),  # a gimbal
        Codec(ids[0] + 1, ids[1]).encode(heartbeat(7)),  # the companion of another vehicle
    ):
        flight.session.receive(beat, flight.now_s)
    assert flight.session.state.twin_time_s == -math.inf
    flight.session.receive(Codec(*ids).encode(heartbeat(7)), flight.now_s)
    assert flight.session.state.twin_time_s == flight.now_s


def test_the_autopilot_s_own_pose_is_kept_beside_its_sensors() -> None:
    # LOCAL_POSITION_NED is a sensor's message too: by telemetry it has the climb rate
    for sense in (None, SenseConfig(source="autopilot")):
        session, autopilot = Session(LinkConfig(), sense, follows_pose=True), Codec(1, 1)
        for k in range(4):
            now_s = 100.0 + 0.05 * k
            for message in (
                mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3),
                mavlink.MAVLink_local_position_ned_message(50 * k, 1.0 + k, 2.0, -3.0, 20.0, 0.0, 0.0),
                mavlink.MAVLink_attitude_message(50 * k, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0),
            ):
                session.receive(autopilot.encode(message), now_s)
        assert session.poses is not None
        pose = session.poses.at(100.075)
        assert pose is not None
        assert pose.position_ned_m == pytest.approx((2.5, 2.0, -3.0))
        assert yaw_from_quat(pose.attitude) == pytest.approx(0.5)
    assert Session(LinkConfig()).poses is None


def test_a_landing_target_is_stamped_by_the_clock_of_timesync() -> None:
    target = LandingTargetPose(123.456, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), (0.1, 0.1))
    (m,) = Codec(9).decode(Session(LinkConfig()).send_landing_target(target))
    assert m.time_usec == clock_ns(123.456) // 1000 == 123_456_000
