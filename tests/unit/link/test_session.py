"""The session: what it sends when, whom it believes, and how it keeps time."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from companion.base.geometry import quat_from_euler
from companion.base.messages import PadBeacon, Setpoint
from companion.config import LinkConfig
from companion.link.codec import Codec, Message, heartbeat, mavlink, status_texts, timesync
from companion.link.commands import NO_ANSWER, VehicleCommand
from companion.link.session import Session
from companion.link.streams import OWN_RATES_HZ, TELEMETRY_RATES_HZ
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.ground_beacon import follow_target

DELAY_S = 0.004
PX4_RATES_HZ = TELEMETRY_RATES_HZ | OWN_RATES_HZ["px4"]


class Flight:
    """A session and an autopilot with a line of constant delay between them, in steps of 2 ms."""

    def __init__(self, config: LinkConfig | None = None, autopilot: FakeAutopilot | None = None) -> None:
        self.session = Session(config or LinkConfig())
        self.autopilot = autopilot or FakeAutopilot()
        self.now_s = 100.0
        self.heard = Codec(9)
        self.sent: list[tuple[float, Message]] = []
        self.cut = False
        self.delay_s = DELAY_S
        self._to_autopilot: list[tuple[float, bytes]] = []
        self._to_session: list[tuple[float, bytes]] = []

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.002)):
            self.now_s += 0.002
            while self._to_session and self._to_session[0][0] <= self.now_s:
                self.session.receive(self._to_session.pop(0)[1], self.now_s)
            self.send(self.session.tick(self.now_s))
            while self._to_autopilot and self._to_autopilot[0][0] <= self.now_s:
                self._answer(self.autopilot.receive(self._to_autopilot.pop(0)[1], self.now_s))
            self._answer(self.autopilot.tick(self.now_s))

    def is_connected(self) -> bool:
        return self.session.state.connected

    def send(self, data: bytes) -> None:
        self.sent += [(self.now_s, message) for message in self.heard.decode(data)]
        if data and not self.cut:
            self._to_autopilot.append((self.now_s + self.delay_s, data))

    def _answer(self, data: bytes) -> None:
        if data and not self.cut:
            self._to_session.append((self.now_s + self.delay_s, data))

    def sent_of(self, kind: str) -> list[tuple[float, Message]]:
        return [(time_s, m) for time_s, m in self.sent if m.get_type() == kind]


def test_heartbeats_go_out_at_1_hz_though_nobody_answers() -> None:
    flight = Flight()
    flight.cut = True
    flight.run(5.5)
    times = [time_s for time_s, _ in flight.sent_of("HEARTBEAT")]
    assert len(times) == 6
    assert {m.get_type() for _, m in flight.sent} == {"HEARTBEAT"}


def test_the_autopilot_is_connected_ready_and_known() -> None:
    flight = Flight(autopilot=FakeAutopilot(believes_in_air=True))
    flight.run(2.0)
    state = flight.session.state
    assert (state.connected, state.autopilot_kind, state.mode, state.ready_to_arm) == (
        True,
        "px4",
        "AUTO.LOITER",
        True,
    )
    assert state.home == pytest.approx((47.0, 8.0, 400.0))
    assert state.position_ned_m == pytest.approx((1.0, 2.0, -3.0))
    assert state.landed == "in_air"


def test_an_ardupilots_filter_is_asked_for_and_forgotten_with_the_connection() -> None:
    flight = Flight(autopilot=FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED"))
    flight.run(2.0)
    assert flight.session.state.ready_to_arm
    assert flight.session.state.ekf_ready is True
    flight.cut = True
    flight.run(4.0)
    assert flight.session.state.ekf_ready is None


def test_every_rate_is_asked_for_once_when_it_is_honoured() -> None:
    flight = Flight()
    flight.run(12.0)
    asked = [m.param1 for m in flight.autopilot.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)]
    assert sorted(asked) == sorted(PX4_RATES_HZ)
    assert flight.autopilot.rates_hz == pytest.approx(PX4_RATES_HZ, rel=1e-3)


def test_a_rate_that_another_program_lowers_is_asked_for_again() -> None:
    flight = Flight()
    flight.run(3.0)
    flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 1.0
    flight.run(5.0)
    assert flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] == pytest.approx(5.0)


def test_a_rate_request_that_is_lost_is_repeated() -> None:
    flight = Flight(autopilot=FakeAutopilot(deaf_to={mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: 2}))
    flight.run(2.0)
    assert set(flight.autopilot.rates_hz) == set(PX4_RATES_HZ)


def test_home_is_asked_for_until_it_is_known_and_again_after_arming() -> None:
    flight = Flight(autopilot=FakeAutopilot(deaf_to={mavlink.MAV_CMD_REQUEST_MESSAGE: 3}))
    flight.run(6.0)
    assert flight.session.state.home is not None
    count = len(flight.autopilot.commands(mavlink.MAV_CMD_REQUEST_MESSAGE))
    flight.run(5.0)
    assert len(flight.autopilot.commands(mavlink.MAV_CMD_REQUEST_MESSAGE)) == count
    flight.autopilot.armed = True
    flight.run(1.5)
    assert len(flight.autopilot.commands(mavlink.MAV_CMD_REQUEST_MESSAGE)) == count + 1


def test_silence_is_a_lost_connection_and_everything_is_asked_for_again_afterwards() -> None:
    flight = Flight()
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


@pytest.mark.parametrize("offset_s", [-99.9, 0.0, 4321.0])
def test_telemetry_is_stamped_with_our_time_of_measurement(offset_s: float) -> None:
    flight = Flight(autopilot=FakeAutopilot(clock_offset_s=offset_s))
    flight.run(2.0)
    assert flight.session.timesync.offset_s == pytest.approx(offset_s, abs=0.0021)
    arrived_s = flight.now_s + 0.5
    attitude = flight.autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, arrived_s - 0.08)
    flight.session.receive(flight.autopilot.codec.encode(attitude), arrived_s)
    assert flight.session.state.attitude_time_s == pytest.approx(arrived_s - 0.08, abs=0.003)


def test_without_synchronisation_the_time_of_arrival_counts() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot(clock_offset_s=50.0)
    session.receive(autopilot.tick(7.0), 7.0)
    attitude = autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, 7.0)
    session.receive(autopilot.codec.encode(attitude), 7.02)
    assert session.state.attitude_time_s == 7.02


def test_a_message_of_an_impossible_time_is_not_taken_for_a_fresh_one() -> None:
    flight = Flight()
    flight.run(2.0)
    before = flight.session.state.attitude_time_s
    old = flight.autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, flight.now_s - 5.0)
    flight.session.receive(flight.autopilot.codec.encode(old), flight.now_s)
    assert flight.session.state.attitude_time_s == before
    future = flight.autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, flight.now_s + 5.0)
    flight.session.receive(flight.autopilot.codec.encode(future), flight.now_s + 0.1)
    assert flight.session.state.attitude_time_s == before


def test_a_restarted_clock_is_followed() -> None:
    flight = Flight(autopilot=FakeAutopilot(clock_offset_s=500.0))
    flight.run(3.0)
    flight.autopilot.clock_offset_s = -100.0
    flight.run(2.0)
    assert flight.session.timesync.offset_s == pytest.approx(-100.0, abs=0.003)


def test_the_clock_offset_leans_on_the_quickest_answers() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    session.receive(autopilot.tick(0.0), 0.0)
    for i, (there_s, back_s) in enumerate([(0.05, 0.01), (0.002, 0.002), (0.01, 0.08)]):
        asked_s = 1.0 + i
        session.receive(
            autopilot.receive(session.tick(asked_s), asked_s + there_s), asked_s + there_s + back_s
        )
    assert session.timesync.offset_s == pytest.approx(0.0, abs=2e-3)


def test_the_time_is_asked_for_five_times_a_second() -> None:
    flight = Flight()
    flight.run(7.0)
    asked = [time_s for time_s, m in flight.sent_of("TIMESYNC") if m.tc1 == 0 and time_s > 102.0]
    assert len(asked) == 25


@pytest.mark.parametrize("delay_s", [0.0, 0.5, 1.6])
def test_how_late_answers_come_is_told_within_seconds_and_forgotten_with_the_link(delay_s: float) -> None:
    flight = Flight()
    flight.run(3.0)
    assert flight.session.state.round_trip_s == pytest.approx(2 * DELAY_S, abs=0.005)
    flight.delay_s += delay_s
    flight.run(2 * delay_s + 0.7)
    state = flight.session.state
    assert state.round_trip_s == pytest.approx(2 * flight.delay_s, abs=0.005)
    assert flight.now_s - state.round_trip_time_s < 0.21
    flight.cut = True
    flight.run(5.0)
    assert flight.session.state.round_trip_s is None


def test_one_slow_answer_is_no_late_link() -> None:
    flight = Flight()
    flight.run(3.0)
    slowest = 0.0
    for wait_s in (0.21, 1.0):
        flight.delay_s = DELAY_S + (0.4 if wait_s < 0.3 else 0.0)
        for _ in range(round(wait_s / 0.05)):
            flight.run(0.05)
            slowest = max(slowest, flight.session.state.round_trip_s or 0.0)
    assert slowest < 0.3


def test_the_autopilots_own_question_for_the_time_is_answered() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    session.receive(autopilot.codec.encode(timesync(0, 123456789)), 42.0)
    answers = [m for m in Codec(1).decode(session.tick(42.001)) if m.get_type() == "TIMESYNC"]
    assert [(m.tc1, m.ts1) for m in answers] == [(42_000_000_000, 123456789)]


def test_answers_to_others_questions_for_the_time_are_left_alone() -> None:
    flight = Flight()
    flight.run(2.0)
    before = flight.session.timesync.offset_s
    stranger = timesync(999_000_000_000, 77)
    flight.session.receive(flight.autopilot.codec.encode(stranger), flight.now_s)
    assert flight.session.timesync.offset_s == before


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


def test_a_beacon_from_the_ground_station_is_heard() -> None:
    session = Session(LinkConfig())
    beacon = PadBeacon(0.0, 47.0, 8.0, 401.0, (1.0, 0.0, 0.0), 1.0)
    session.receive(Codec(255, 190).encode(follow_target(beacon)), 3.0)
    assert session.beacon is not None
    assert (session.beacon.time_s, session.beacon.altitude_m) == (3.0, 401.0)


@pytest.mark.parametrize("sender", [(254, 190), (1, 1), (1, 191)])
def test_a_beacon_from_anyone_else_is_not_believed(sender: tuple[int, int]) -> None:
    session = Session(LinkConfig())
    beacon = PadBeacon(0.0, 47.0, 8.0, 401.0, (1.0, 0.0, 0.0), 1.0)
    session.receive(Codec(*sender).encode(follow_target(beacon)), 3.0)
    assert session.beacon is None
    assert session.beacon_stranger == sender[0]


@pytest.mark.parametrize("ground_system_id", [255, 77])
def test_a_beacon_faster_than_any_pad_leaves_the_last_good_one(ground_system_id: int) -> None:
    session = Session(LinkConfig(ground_system_id=ground_system_id, maximum_pad_speed_m_s=3.0))
    ground = Codec(ground_system_id, 190)
    for time_s, north_m_s in ((1.0, 2.9), (2.0, 3.1), (3.0, 1000.0)):
        beacon = PadBeacon(0.0, 47.0, 8.0, 401.0, (north_m_s, 0.0, 0.0), 1.0)
        session.receive(ground.encode(follow_target(beacon)), time_s)
    assert session.beacon is not None
    assert session.beacon.time_s == 1.0


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


def test_texts_of_the_autopilot_are_kept_and_counted() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    for message in status_texts("Takeoff detected", "info", 1):
        session.receive(autopilot.codec.encode(message), 1.0)
    assert session.state.texts == ("Takeoff detected",)
    assert session.texts_heard == 1


# ---------------------------------------------------------------- commands

ARM = VehicleCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0))


def test_an_accepted_command_is_sent_once() -> None:
    flight = Flight()
    flight.run(1.5)
    pending = flight.session.command(ARM)
    flight.run(1.0)
    assert pending.accepted
    assert flight.autopilot.armed
    assert len(flight.autopilot.commands(ARM.number)) == 1


def test_a_lost_command_is_repeated_and_the_repeats_are_counted() -> None:
    flight = Flight(autopilot=FakeAutopilot(deaf_to={ARM.number: 2}))
    flight.run(1.5)
    pending = flight.session.command(ARM)
    flight.run(2.0)
    assert pending.accepted
    assert [m.confirmation for m in flight.autopilot.commands(ARM.number)] == [0, 1, 2]


def test_a_command_nobody_answers_is_given_up() -> None:
    flight = Flight(LinkConfig(command_tries=3, command_patience_s=0.2))
    flight.run(1.5)
    flight.cut = True
    pending = flight.session.command(ARM)
    outcomes = []
    for duration_s in (0.58, 0.1):
        flight.run(duration_s)
        outcomes.append(pending.outcome)
    assert outcomes == [None, NO_ANSWER]
    assert pending.tries == 3


def test_a_denied_command_says_so() -> None:
    flight = Flight(autopilot=FakeAutopilot(refuses={ARM.number: "Arming denied: no GPS"}))
    flight.run(1.5)
    pending = flight.session.command(ARM)
    flight.run(0.5)
    assert pending.outcome == "denied"
    assert flight.session.state.texts[-1] == "Arming denied: no GPS"


def ack(result: int, target: tuple[int, int], source: int = 1, component: int = 1) -> bytes:
    return Codec(source, component).encode(
        mavlink.MAVLink_command_ack_message(ARM.number, result, 0, 0, *target)
    )


@pytest.mark.parametrize(
    ("target", "source", "taken"),
    [((1, 191), 1, True), ((0, 0), 1, True), ((1, 0), 1, True), ((1, 192), 1, False), ((1, 191), 2, False)],
)
def test_only_an_answer_for_us_from_whom_we_asked_counts(
    target: tuple[int, int], source: int, taken: bool
) -> None:
    session = Session(LinkConfig())
    pending = session.command(ARM)
    session.tick(0.0)
    session.receive(ack(0, target, source), 0.1)
    assert pending.accepted is taken


def test_another_component_does_not_answer_in_the_autopilots_place() -> None:
    session = Session(LinkConfig())
    pending = session.command(ARM)
    session.tick(0.0)
    session.receive(ack(0, (1, 191), component=154), 0.1)
    assert pending.outcome is None
    session.receive(ack(0, (1, 191)), 0.2)
    assert pending.accepted


def test_a_px4s_mode_is_known_between_its_heartbeats() -> None:
    flight = Flight()
    flight.run(3.0)
    changes = []
    for _ in range(7):
        flight.run(0.53)  # at no particular time between two heartbeats
        flight.autopilot.mode = "OFFBOARD" if flight.autopilot.mode != "OFFBOARD" else "POSCTL"
        changed_s = flight.now_s
        while flight.session.state.mode != flight.autopilot.mode:
            flight.run(0.002)
        changes.append(flight.now_s - changed_s)
        assert flight.session.state.offboard is (flight.autopilot.mode == "OFFBOARD")
    assert max(changes) <= 0.1 + 2 * DELAY_S + 0.004


def test_an_ardupilots_heartbeat_is_asked_for_five_times_a_second() -> None:
    flight = Flight(autopilot=FakeAutopilot("ardupilot", mode="GUIDED"))
    flight.run(3.0)
    assert flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_HEARTBEAT] == pytest.approx(5.0)


def test_in_progress_means_wait_and_do_not_repeat() -> None:
    session = Session(LinkConfig())
    pending = session.command(ARM)
    session.tick(0.0)
    session.receive(ack(mavlink.MAV_RESULT_IN_PROGRESS, (1, 191)), 0.4)
    sent = Codec(1).decode(session.tick(2.0))
    assert "COMMAND_LONG" not in {m.get_type() for m in sent}
    session.receive(ack(mavlink.MAV_RESULT_FAILED, (1, 191)), 2.5)
    assert pending.outcome == "failed"


def test_commands_of_the_same_number_go_one_after_the_other() -> None:
    session = Session(LinkConfig())
    first, second = session.command(ARM), session.command(VehicleCommand(ARM.number, (0.0, 0.0)))
    sent = [m for m in Codec(1).decode(session.tick(0.0)) if m.get_type() == "COMMAND_LONG"]
    assert [m.param1 for m in sent] == [1.0]
    session.receive(ack(0, (1, 191)), 0.1)
    assert first.accepted
    assert second.outcome is None
    sent = [m for m in Codec(1).decode(session.tick(0.1)) if m.get_type() == "COMMAND_LONG"]
    assert [m.param1 for m in sent] == [0.0]


def test_a_withdrawn_command_is_not_repeated() -> None:
    session = Session(LinkConfig())
    pending = session.command(ARM)
    session.tick(0.0)
    session.withdraw(pending)
    assert "COMMAND_LONG" not in {m.get_type() for m in Codec(1).decode(session.tick(5.0))}
    assert pending.outcome == "withdrawn"


def test_a_late_answer_to_a_withdrawn_command_is_not_the_next_ones() -> None:
    session = Session(LinkConfig())
    first = session.command(ARM)
    session.tick(0.0)
    session.withdraw(first)
    second = session.command(VehicleCommand(ARM.number, (0.0, 0.0)))
    session.tick(0.1)
    session.receive(ack(mavlink.MAV_RESULT_DENIED, (1, 191)), 0.2)
    assert second.outcome is None
    session.receive(ack(0, (1, 191)), 0.3)
    assert second.accepted


def test_a_withdrawn_command_that_was_lost_costs_the_next_one_a_repeat_at_most() -> None:
    session = Session(LinkConfig())
    session.tick(0.0)
    session.withdraw(session.command(ARM))  # never sent: no answer to wait for
    second = session.command(ARM)
    session.tick(0.1)
    session.receive(ack(0, (1, 191)), 0.2)
    assert second.accepted
    third = session.command(ARM)
    session.tick(1.0)
    session.withdraw(third)
    fourth = session.command(ARM)
    session.tick(1.2)
    session.receive(ack(0, (1, 191)), 1.3)
    sent = [m.get_type() for m in Codec(1).decode(session.tick(1.75))]
    assert "COMMAND_LONG" in sent
    session.receive(ack(0, (1, 191)), 1.8)
    assert fourth.accepted


def parameter(name: bytes, value: float) -> bytes:
    message = mavlink.MAVLink_param_value_message(name, value, mavlink.MAV_PARAM_TYPE_INT32, 9, 0)
    return Codec(1, 1).encode(message)


def test_a_parameter_is_read_by_its_name() -> None:
    session = Session(LinkConfig())
    session.receive(FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED").tick(0.0), 0.0)
    request = session.read_parameter("GUID_OPTIONS")
    asked = [m for m in Codec(1).decode(session.tick(0.1)) if m.get_type() == "PARAM_REQUEST_READ"]
    assert [(m.param_id, m.param_index, m.target_system) for m in asked] == [("GUID_OPTIONS", -1, 1)]
    session.receive(parameter(b"GUID_TIMEOUT", 3.0), 0.2)
    session.receive(parameter(b"GUID_OPTIONS", math.nan), 0.2)
    outcomes = [request.outcome]
    session.receive(parameter(b"GUID_OPTIONS", 9.0), 0.2)
    assert [*outcomes, request.outcome] == [None, "accepted"]
    assert request.value == 9.0


def test_a_setting_ends_with_the_value_wanted_and_not_with_an_older_one() -> None:
    session = Session(LinkConfig(command_tries=2, command_patience_s=0.2))
    session.receive(FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED").tick(0.0), 0.0)
    request = session.set_parameter("GUID_OPTIONS", 8)
    session.tick(0.1)
    session.receive(parameter(b"GUID_OPTIONS", 0.0), 0.15)
    outcomes = [request.outcome]
    session.receive(parameter(b"GUID_OPTIONS", 8.0), 0.2)
    assert [*outcomes, request.outcome] == [None, "accepted"]
    refused = session.set_parameter("GUID_OPTIONS", 9)
    for now_s in (0.3, 0.55, 0.8):
        session.tick(now_s)
        session.receive(parameter(b"GUID_OPTIONS", 8.0), now_s)
    assert (refused.outcome, refused.value) == (NO_ANSWER, 8.0)


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
