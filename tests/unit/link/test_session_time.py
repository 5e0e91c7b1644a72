"""The session's time: telemetry is stamped with our time of measurement, by a synchronised clock."""

import pytest

from companion.base.messages import UNKNOWN_TIMEOUT_S, AutopilotSetup, LinkHealth
from companion.config import LinkConfig
from companion.link.codec import Codec, mavlink, timesync
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.session_flight import DELAY_S, SessionFlight


@pytest.mark.parametrize("offset_s", [-99.9, 0.0, 4321.0])
def test_telemetry_is_stamped_with_our_time_of_measurement(offset_s: float) -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(clock_offset_s=offset_s))
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
    flight = SessionFlight()
    flight.run(2.0)
    before = flight.session.state.attitude_time_s
    old = flight.autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, flight.now_s - 5.0)
    flight.session.receive(flight.autopilot.codec.encode(old), flight.now_s)
    assert flight.session.state.attitude_time_s == before
    future = flight.autopilot.message(mavlink.MAVLINK_MSG_ID_ATTITUDE, flight.now_s + 5.0)
    flight.session.receive(flight.autopilot.codec.encode(future), flight.now_s + 0.1)
    assert flight.session.state.attitude_time_s == before


def test_a_restarted_clock_is_followed() -> None:
    flight = SessionFlight(autopilot=FakeAutopilot(clock_offset_s=500.0))
    flight.run(3.0)
    flight.autopilot.clock_offset_s = -100.0
    flight.run(2.0)
    assert flight.session.timesync.offset_s == pytest.approx(-100.0, abs=0.003)


def test_the_clock_offset_rests_on_the_quickest_answers() -> None:
    session, autopilot = Session(LinkConfig()), FakeAutopilot()
    session.receive(autopilot.tick(0.0), 0.0)
    for i, (there_s, back_s) in enumerate([(0.05, 0.01), (0.002, 0.002), (0.01, 0.08)]):
        asked_s = 1.0 + i
        session.receive(
            autopilot.receive(session.tick(asked_s), asked_s + there_s), asked_s + there_s + back_s
        )
    assert session.timesync.offset_s == pytest.approx(0.0, abs=2e-3)


def test_the_time_is_asked_for_five_times_a_second() -> None:
    flight = SessionFlight()
    flight.run(7.0)
    asked = [time_s for time_s, m in flight.sent_of("TIMESYNC") if m.tc1 == 0 and time_s > 102.0]
    assert len(asked) == 25


@pytest.mark.parametrize("delay_s", [0.0, 0.5, 1.6])
def test_how_late_answers_come_is_reported_within_seconds_and_forgotten_with_the_link(delay_s: float) -> None:
    flight = SessionFlight()
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


def test_an_autopilot_that_no_longer_hears_us_is_silent_though_it_talks() -> None:
    flight = SessionFlight()
    flight.run(3.0)
    assert flight.session.silent_s(flight.now_s) < 0.1
    flight.unheard = True
    flight.run(2.0)
    assert flight.now_s - flight.session.heard_s < 0.1
    assert flight.session.silent_s(flight.now_s) == pytest.approx(1.6, abs=0.25)
    flight.unheard = False
    flight.run(0.3)
    assert flight.session.silent_s(flight.now_s) < 0.1


@pytest.mark.parametrize("keeps_s", [0.3, 0.5, 1.0])
def test_that_it_hears_us_no_more_is_known_before_it_gives_our_setpoint_up(keeps_s: float) -> None:
    flight = SessionFlight()
    flight.run(3.0)
    flight.session._setup._final = AutopilotSetup(setpoint_timeout_s=keeps_s)
    flight.run(3.0)
    flight.unheard = True
    flight.run(keeps_s)
    assert flight.session.silent_s(flight.now_s) >= 0.4 * keeps_s
    flight.unheard = False
    flight.run(0.3)
    assert flight.session.silent_s(flight.now_s) < 0.1


def test_one_that_never_tells_the_time_is_heard_by_what_it_says() -> None:
    session = Session(LinkConfig())
    session.heard_s = 9.8
    link = session.health(10.0)
    told = (link.silent_s, link.keeps_setpoint_s, link.lost_after_s)
    assert told == pytest.approx((0.2, UNKNOWN_TIMEOUT_S, 3.0))


@pytest.mark.parametrize(
    ("silent_s", "holds"),
    [
        (0.29, {"fresh"}),
        (0.5, set()),
        (0.51, {"maybe_unheard"}),
        (0.8, {"maybe_unheard", "silent"}),
        (1.0, {"maybe_unheard", "silent", "gave_up_setpoints"}),
        (3.1, {"maybe_unheard", "silent", "gave_up_setpoints", "lost"}),
    ],
)
def test_a_silence_counts_by_the_autopilots_own_time_out(silent_s: float, holds: set[str]) -> None:
    link = LinkHealth(silent_s, keeps_setpoint_s=1.0, lost_after_s=3.0)
    assert {
        name
        for name in ("fresh", "maybe_unheard", "silent", "gave_up_setpoints", "lost")
        if getattr(link, name)
    } == holds
    assert not LinkHealth(silent_s, keeps_setpoint_s=2.0 * silent_s).maybe_unheard


def test_one_slow_answer_is_no_late_link() -> None:
    flight = SessionFlight()
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
    flight = SessionFlight()
    flight.run(2.0)
    before = flight.session.timesync.offset_s
    stranger = timesync(999_000_000_000, 77)
    flight.session.receive(flight.autopilot.codec.encode(stranger), flight.now_s)
    assert flight.session.timesync.offset_s == before
