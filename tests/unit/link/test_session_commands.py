"""The session's commands and parameters: sent, repeated, answered, withdrawn."""

import math
from typing import Any

import pytest

from companion.config import LinkConfig
from companion.link.codec import Codec, mavlink
from companion.link.commands import NO_ANSWER, Pending, VehicleCommand
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot
from tests.unit.link.session_flight import DELAY_S, SessionFlight

ARM = VehicleCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0))
DISARM = VehicleCommand(ARM.number, (0.0, 0.0))


def linked(autopilot: FakeAutopilot | None = None, **settings: Any) -> SessionFlight:
    """A flight whose link is up."""
    flight = SessionFlight(LinkConfig(**settings), autopilot=autopilot or FakeAutopilot())
    flight.run(1.5)
    return flight


def sent(session: Session, now_s: float, kind: str = "COMMAND_LONG") -> list[Any]:
    return [m for m in Codec(1).decode(session.tick(now_s)) if m.get_type() == kind]


def armed() -> tuple[Session, Pending]:
    """A session that has sent the command, and the command."""
    session = Session(LinkConfig())
    pending = session.command(ARM)
    session.tick(0.0)
    return session, pending


def test_an_accepted_command_is_sent_once() -> None:
    flight = linked()
    pending = flight.session.command(ARM)
    flight.run(1.0)
    assert pending.accepted
    assert flight.autopilot.armed
    assert len(flight.autopilot.commands(ARM.number)) == 1


def test_a_lost_command_is_repeated_and_the_repeats_are_counted() -> None:
    flight = linked(FakeAutopilot(deaf_to={ARM.number: 2}))
    pending = flight.session.command(ARM)
    flight.run(2.0)
    assert pending.accepted
    assert [m.confirmation for m in flight.autopilot.commands(ARM.number)] == [0, 1, 2]


def test_a_command_nobody_answers_is_given_up() -> None:
    flight = linked(command_tries=3, command_timeout_s=0.2)
    flight.cut = True
    pending = flight.session.command(ARM)
    outcomes = []
    for duration_s in (0.58, 0.1):
        flight.run(duration_s)
        outcomes.append(pending.outcome)
    assert outcomes == [None, NO_ANSWER]
    assert pending.tries == 3


def test_a_denied_command_says_so() -> None:
    flight = linked(FakeAutopilot(refuses={ARM.number: "Arming denied: no GPS"}))
    pending = flight.session.command(ARM)
    flight.run(0.5)
    assert pending.outcome == "denied"
    assert flight.session.state.texts[-1] == "Arming denied: no GPS"


def ack(result: int, target: tuple[int, int], source: int = 1, component: int = 1) -> bytes:
    return Codec(source, component).encode(
        mavlink.MAVLink_command_ack_message(ARM.number, result, 0, 0, *target)
    )


@pytest.mark.parametrize(
    ("target", "source", "component", "taken"),
    [
        ((1, 191), 1, 1, True),
        ((0, 0), 1, 1, True),
        ((1, 0), 1, 1, True),
        ((1, 192), 1, 1, False),
        ((1, 191), 2, 1, False),
        ((1, 191), 1, 154, False),  # a gimbal does not answer in the autopilot's place
    ],
)
def test_only_an_answer_for_us_from_whom_we_asked_counts(
    target: tuple[int, int], source: int, component: int, taken: bool
) -> None:
    session, pending = armed()
    session.receive(ack(0, target, source, component), 0.1)
    assert (pending.outcome, pending.accepted) == (("accepted", True) if taken else (None, False))
    session.receive(ack(0, (1, 191)), 0.2)
    assert pending.accepted


def test_a_px4s_mode_is_known_between_its_heartbeats() -> None:
    flight = SessionFlight()
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
    flight = SessionFlight(autopilot=FakeAutopilot("ardupilot", mode="GUIDED"))
    flight.run(3.0)
    assert flight.autopilot.rates_hz[mavlink.MAVLINK_MSG_ID_HEARTBEAT] == pytest.approx(5.0)


def test_in_progress_means_wait_and_do_not_repeat() -> None:
    session, pending = armed()
    session.receive(ack(mavlink.MAV_RESULT_IN_PROGRESS, (1, 191)), 0.4)
    assert sent(session, 2.0) == []
    session.receive(ack(mavlink.MAV_RESULT_FAILED, (1, 191)), 2.5)
    assert pending.outcome == "failed"


def test_commands_of_the_same_number_go_one_after_the_other() -> None:
    session = Session(LinkConfig())
    first, second = session.command(ARM), session.command(DISARM)
    assert [m.param1 for m in sent(session, 0.0)] == [1.0]
    session.receive(ack(0, (1, 191)), 0.1)
    assert first.accepted
    assert second.outcome is None
    assert [m.param1 for m in sent(session, 0.1)] == [0.0]


def test_a_withdrawn_command_is_not_repeated() -> None:
    session, pending = armed()
    session.withdraw(pending)
    assert sent(session, 5.0) == []
    assert pending.outcome == "withdrawn"


def test_a_late_answer_to_a_withdrawn_command_is_not_the_next_ones() -> None:
    session, first = armed()
    session.withdraw(first)
    second = session.command(DISARM)
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
    assert sent(session, 1.75) != []
    session.receive(ack(0, (1, 191)), 1.8)
    assert fourth.accepted


def test_the_answer_to_a_repeat_is_not_the_next_commands() -> None:
    session, first = armed()
    session.tick(0.5)  # its answer takes longer
    session.receive(ack(0, (1, 191)), 0.6)
    assert first.accepted
    second = session.command(DISARM)
    session.tick(0.61)  # lost on its way
    session.receive(ack(0, (1, 191)), 0.95)
    assert second.outcome is None
    assert [m.param1 for m in sent(session, 1.2)] == [0.0]
    session.receive(ack(0, (1, 191)), 1.25)
    assert second.accepted


def test_each_loss_costs_the_next_command_of_its_number_one_repeat_at_most() -> None:
    session, first = armed()
    session.tick(0.5)  # it was lost
    session.receive(ack(0, (1, 191)), 0.52)
    assert first.accepted
    second, third = session.command(DISARM), session.command(ARM)
    session.tick(0.53)
    session.receive(ack(0, (1, 191)), 0.55)  # its own, but it may be the first one's
    assert second.outcome is None
    session.tick(1.03)
    session.receive(ack(0, (1, 191)), 1.05)
    assert second.accepted
    session.tick(1.06)
    session.receive(ack(0, (1, 191)), 1.08)
    assert third.accepted


def parameter(name: bytes, value: float) -> bytes:
    message = mavlink.MAVLink_param_value_message(name, value, mavlink.MAV_PARAM_TYPE_INT32, 9, 0)
    return Codec(1, 1).encode(message)


def test_a_parameter_is_read_by_its_name() -> None:
    session = Session(LinkConfig())
    session.receive(FakeAutopilot(autopilot_kind="ardupilot", mode="GUIDED").tick(0.0), 0.0)
    request = session.read_parameter("GUID_OPTIONS")
    asked = sent(session, 0.1, "PARAM_REQUEST_READ")
    assert [(m.param_id, m.param_index, m.target_system) for m in asked] == [("GUID_OPTIONS", -1, 1)]
    session.receive(parameter(b"GUID_TIMEOUT", 3.0), 0.2)
    session.receive(parameter(b"GUID_OPTIONS", math.nan), 0.2)
    outcomes = [request.outcome]
    session.receive(parameter(b"GUID_OPTIONS", 9.0), 0.2)
    assert [*outcomes, request.outcome] == [None, "accepted"]
    assert request.value == 9.0


def test_a_setting_ends_with_the_value_wanted_and_not_with_an_older_one() -> None:
    session = Session(LinkConfig(command_tries=2, command_timeout_s=0.2))
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
