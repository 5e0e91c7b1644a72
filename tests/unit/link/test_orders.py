"""Orders over the link: who may give them, what an edge is, and what is answered."""

import math
from typing import Any

import pytest

from companion.base.autopilot_kind import AutopilotKind
from companion.base.autopilots import PROFILES
from companion.base.messages import AutopilotState, Order, OrderKind, OrderOutcome, OrderReply
from companion.config import LinkConfig, OrdersConfig
from companion.link.codec import CURRENT_MODE, Codec, command_int, command_long, heartbeat, mavlink
from companion.link.orders import SETTLES_S, UNBROKEN_S, OrderListener
from companion.link.session import Session
from tests.unit.link.fake_autopilot import FakeAutopilot

GROUND, US, COMPONENT = 255, 1, 191


def listener(**settings: Any) -> OrderListener:
    made = OrderListener(OrdersConfig(**settings), COMPONENT, GROUND)
    made.stand_by(0.0)
    return made


def from_system(message: Any, system_id: int = GROUND, component_id: int = 190) -> Any:
    """The message as it is read from the line."""
    (read,) = Codec(US).decode(Codec(system_id, component_id).encode(message))
    return read


def command(number: int, *parameters: float, component: int = COMPONENT, confirmation: int = 0) -> Any:
    return command_long(number, parameters, US, component, confirmation)


def reply(order: Order, outcome: OrderOutcome, time_s: float = 1.0) -> OrderReply:
    return OrderReply(time_s, order.kind, order.source, outcome)


@pytest.mark.parametrize(
    ("number", "parameters", "kind"),
    [
        (mavlink.MAV_CMD_NAV_LAND, (), OrderKind.LAND),
        (mavlink.MAV_CMD_DO_LAND_START, (), OrderKind.LAND),
        (mavlink.MAV_CMD_USER_1, (1.0,), OrderKind.LAND),
        (mavlink.MAV_CMD_USER_1, (2.0,), OrderKind.FLY),
        (mavlink.MAV_CMD_USER_1, (0.0,), OrderKind.STOP),
    ],
)
def test_a_command_of_the_ground_station_is_an_order(
    number: int, parameters: tuple[float, ...], kind: OrderKind
) -> None:
    orders = listener()
    orders.hear_command(from_system(command(number, *parameters)), US, 5.0)
    (order,) = orders.take()
    assert (order.kind, order.source) == (kind, "the ground station (system 255)")
    assert orders.take() == []
    orders.reply(order, reply(order, OrderOutcome.IN_PROGRESS))
    orders.reply(order, reply(order, OrderOutcome.ACCEPTED))
    assert [(a.command, a.result, a.target_system, a.target_component) for a in orders.answers()] == [
        (number, mavlink.MAV_RESULT_IN_PROGRESS, GROUND, 190),
        (number, mavlink.MAV_RESULT_ACCEPTED, GROUND, 190),
    ]
    assert orders.answers() == []


def test_a_command_int_is_one_too() -> None:
    orders = listener()
    message = command_int(mavlink.MAV_CMD_NAV_LAND, (), (47.0, 8.0, 0.0), US, COMPONENT)
    orders.hear_command(from_system(message), US, 5.0)
    assert [order.kind for order in orders.take()] == [OrderKind.LAND]


def test_nobody_else_gives_orders_and_nobody_else_s_are_taken() -> None:
    orders = listener()
    land = command(mavlink.MAV_CMD_NAV_LAND)
    orders.hear_command(from_system(land, system_id=77), US, 5.0)
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND, component=1)), US, 5.0)
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND, component=0)), US, 5.0)
    orders.hear_command(from_system(land), US + 1, 5.0)
    assert (orders.take(), orders.answers()) == ([], [])


@pytest.mark.parametrize(
    ("number", "value", "turned_on"),
    [
        *((mavlink.MAV_CMD_USER_1, value, True) for value in (4.0, 0.5, math.nan, math.inf)),
        (mavlink.MAV_CMD_NAV_LAND, 0.0, False),
    ],
)
def test_what_is_no_order_or_is_turned_off_is_answered_as_unsupported(
    number: int, value: float, turned_on: bool
) -> None:
    orders = listener(mavlink=turned_on)
    orders.hear_command(from_system(command(number, value)), US, 5.0)
    assert orders.take() == []
    assert [a.result for a in orders.answers()] == [mavlink.MAV_RESULT_UNSUPPORTED]


def test_who_asks_how_it_stands_orders_nothing() -> None:
    orders = listener()
    assert not orders.take_question()
    orders.hear_command(from_system(command(mavlink.MAV_CMD_USER_1, 3.0)), US, 5.0)
    orders.hear_command(from_system(command(mavlink.MAV_CMD_USER_1, 3.0), system_id=7), US, 5.0)
    assert [answer.result for answer in orders.answers()] == [mavlink.MAV_RESULT_ACCEPTED]
    assert orders.take() == []
    assert orders.take_question()
    assert not orders.take_question()


def test_a_repeat_is_answered_as_before_and_orders_nothing() -> None:
    orders = listener()
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND)), US, 5.0)
    (order,) = orders.take()
    orders.reply(order, reply(order, OrderOutcome.IN_PROGRESS))
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND, confirmation=1)), US, 5.5)
    orders.reply(order, reply(order, OrderOutcome.FAILED, 9.0))
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND, confirmation=2)), US, 9.5)
    assert orders.take() == []
    progress, failed = mavlink.MAV_RESULT_IN_PROGRESS, mavlink.MAV_RESULT_FAILED
    assert [a.result for a in orders.answers()] == [progress, progress, failed, failed]
    # no repeat, but a new one
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND)), US, 9.6)
    assert len(orders.take()) == 1


@pytest.mark.parametrize("later_s", [0.0, 0.01])
def test_a_command_that_comes_by_two_ways_is_one_order_and_the_next_is_heard(later_s: float) -> None:
    orders = listener()
    stop = from_system(command(mavlink.MAV_CMD_USER_1, 0.0))
    for time_s in (5.0, 5.0 + later_s):
        orders.hear_command(stop, US, time_s)
    given = orders.take()
    for outcome in (OrderOutcome.IN_PROGRESS, OrderOutcome.ACCEPTED):
        for order in given:
            orders.reply(order, reply(order, outcome))
    assert len(given) == 1
    assert [a.result for a in orders.answers()][-1] == mavlink.MAV_RESULT_ACCEPTED
    orders.hear_command(stop, US, 100.0)
    assert [order.kind for order in orders.take()] == [OrderKind.STOP]


def test_what_standby_drops_is_no_repeat_when_it_comes_again() -> None:
    orders = listener()
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND)), US, 5.0)
    orders.stand_by(5.0)
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND, confirmation=1)), US, 5.5)
    assert [order.kind for order in orders.take()] == [OrderKind.LAND]


def test_a_stop_while_a_landing_is_under_way_is_an_order_of_its_own() -> None:
    orders = listener()
    orders.hear_command(from_system(command(mavlink.MAV_CMD_USER_1, 1.0)), US, 5.0)
    (land,) = orders.take()
    orders.reply(land, reply(land, OrderOutcome.IN_PROGRESS))
    orders.hear_command(from_system(command(mavlink.MAV_CMD_USER_1, 0.0)), US, 6.0)
    assert [order.kind for order in orders.take()] == [OrderKind.STOP]


# ---------------------------------------------------------------- the switch


def channels(value: int, count: int = 16) -> Any:
    values = [1500] * 18
    values[7 - 1] = value
    return mavlink.MAVLink_rc_channels_message(0, count, *values, 255)


def switched(orders: OrderListener, *values: int, start_s: float = 10.0) -> list[OrderKind]:
    for number, value in enumerate(values):
        orders.hear_autopilot(channels(value), mavlink.MAVLINK_MSG_ID_RC_CHANNELS, start_s + 0.2 * number)
    return [order.kind for order in orders.take()]


def test_a_switch_asks_by_its_edge_and_stops_by_the_other() -> None:
    orders = listener(rc_channel=7)
    assert switched(orders, 1100, 1900, 1900, 1900) == [OrderKind.LAND]
    assert switched(orders, 1900, 1100, 1100, 1100) == [OrderKind.STOP]


def test_a_switch_that_was_up_at_the_start_asks_for_nothing() -> None:
    orders = listener(rc_channel=7)
    assert switched(orders, 1900, 1900, 1900, 1900) == []
    assert switched(orders, 1100, 1100, 1900, 1900) == [OrderKind.STOP, OrderKind.LAND]


def test_one_wrong_value_is_no_edge() -> None:
    assert switched(listener(rc_channel=7), 1100, 1900, 1100, 1900, 1100) == []


@pytest.mark.parametrize("gone", [0, 0xFFFF])
def test_a_radio_that_comes_back_with_the_switch_up_asks_for_nothing(gone: int) -> None:
    assert switched(listener(rc_channel=7), 1100, gone, gone, 1900, 1900, 1900) == []


def test_a_switch_that_rose_while_the_link_was_silent_asks_for_nothing_but_one_that_fell_stops() -> None:
    orders = listener(rc_channel=7)
    for before, after, kinds in ((1100, 1900, []), (1900, 1100, [OrderKind.STOP])):
        orders.heard(10.0)
        assert switched(orders, before, before) == []
        orders.heard(10.0 + 2.0 * UNBROKEN_S)
        assert switched(orders, after, after, after, start_s=10.0 + 2.0 * UNBROKEN_S) == kinds


def test_a_channel_that_the_radio_has_not_got_is_no_switch() -> None:
    orders = listener(rc_channel=7)
    for value in (1100, 1900, 1900, 1900):
        orders.hear_autopilot(channels(value, count=6), mavlink.MAVLINK_MSG_ID_RC_CHANNELS, 10.0)
    assert orders.take() == []


def test_what_was_switched_just_as_standby_began_asks_for_nothing() -> None:
    orders = listener(rc_channel=7)
    orders.stand_by(10.0)
    assert switched(orders, 1100, 1900, 1900, 1900, start_s=10.0 + 0.5 * SETTLES_S) == []


# ---------------------------------------------------------------- mode and mission


ACTIVE, CRITICAL, STANDBY = (mavlink.MAV_STATE_ACTIVE, mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_STANDBY)


def flown(
    orders: OrderListener,
    *modes: str | tuple[str, int],
    kind: AutopilotKind = "px4",
    start_s: float = 10.0,
    silent_s: float = 0.0,
    **state: Any,
) -> list[str]:
    """The orders from a heartbeat a second of each mode (ACTIVE if not said); other telemetry comes as well.

    `silent_s`: before the last one nothing comes for so long.
    """
    now_s = start_s
    for number, entry in enumerate(modes):
        mode, status = (entry, ACTIVE) if isinstance(entry, str) else entry
        now_s += 1.0
        for tenth in range(10):
            orders.heard(now_s - 0.1 * (9 - tenth))
        if number == len(modes) - 1 and silent_s:
            now_s += silent_s
            orders.heard(now_s)
        told = {"connected": True, "armed": True, "autopilot_kind": kind, "mode": mode, **state}
        orders.hear_heartbeat(AutopilotState(now_s, **told), status, now_s)
    return [order.source for order in orders.take()]


@pytest.mark.parametrize("by_hand", sorted(PROFILES["ardupilot"].stick_modes))
def test_a_mode_asks_when_the_pilot_enters_it(by_hand: str) -> None:
    orders = listener(flight_mode="GUIDED")
    assert flown(orders, "GUIDED", by_hand, "GUIDED", "GUIDED", kind="ardupilot") == ["flight mode GUIDED"]
    assert flown(orders, by_hand, "GUIDED", kind="ardupilot", armed=False) == []


@pytest.mark.parametrize("by_hand", sorted(PROFILES["px4"].stick_modes))
@pytest.mark.parametrize("name", ["LOITER", "AUTO.LOITER"])
def test_px4_s_modes_go_by_their_short_names(by_hand: str, name: str) -> None:
    assert flown(listener(flight_mode=name), by_hand, "AUTO.LOITER") == ["flight mode AUTO.LOITER"]


@pytest.mark.parametrize("before", ["AUTO.TAKEOFF", "AUTO.MISSION", "AUTO.RTL", "OFFBOARD", "mode 196608"])
def test_what_the_autopilot_ends_by_itself_asks_for_nothing(before: str) -> None:
    assert flown(listener(flight_mode="LOITER"), "POSCTL", before, before, "AUTO.LOITER") == []


def test_the_end_of_ardupilot_s_mission_asks_for_nothing() -> None:
    assert flown(listener(flight_mode="GUIDED"), "LOITER", "AUTO", "GUIDED", kind="ardupilot") == []


def test_a_failsafe_s_hold_asks_for_nothing_nor_does_its_end() -> None:
    orders = listener(flight_mode="LOITER")
    held = "AUTO.LOITER"
    assert flown(orders, "POSCTL", (held, CRITICAL), (held, CRITICAL), held) == []
    # nor where the failsafe fell back to a mode with sticks first
    assert flown(orders, "OFFBOARD", ("POSCTL", CRITICAL), held, start_s=20.0) == []
    # where CURRENT_MODE says that something else is intended, the mode is no choice either
    assert flown(orders, "POSCTL", held, start_s=30.0, intended_mode="POSCTL") == []
    # the pilot's own after it counts
    assert flown(orders, "POSCTL", held, start_s=40.0, intended_mode=held) == ["flight mode AUTO.LOITER"]


@pytest.mark.parametrize("status", [STANDBY, mavlink.MAV_STATE_EMERGENCY, mavlink.MAV_STATE_BOOT])
def test_only_an_autopilot_that_says_that_it_flies_is_believed(status: int) -> None:
    assert flown(listener(flight_mode="LOITER"), "POSCTL", ("AUTO.LOITER", status)) == []


def test_a_mode_that_changed_while_the_link_was_silent_asks_for_nothing() -> None:
    orders = listener(flight_mode="LOITER")
    assert flown(orders, "POSCTL", "AUTO.LOITER", silent_s=UNBROKEN_S + 0.1) == []
    # an OFFBOARD flight of ours that ended in the silence, and fell back to sticks
    assert flown(orders, "OFFBOARD", "POSCTL", start_s=20.0, silent_s=5.0) == []


def test_a_heartbeat_that_is_lost_costs_no_order() -> None:
    orders = listener(flight_mode="LOITER")
    flown(orders, "POSCTL")
    for tenth in range(1, 20):
        orders.heard(11.0 + 0.1 * tenth)
    assert flown(orders, "AUTO.LOITER", start_s=12.0) == ["flight mode AUTO.LOITER"]


def test_current_mode_alone_asks_for_nothing() -> None:
    session, autopilot = Session(LinkConfig(), orders=OrdersConfig(flight_mode="LOITER")), FakeAutopilot()
    session.orders.stand_by(0.0)
    autopilot.armed, autopilot.mode = True, "POSCTL"
    session.receive(autopilot.tick(10.0), 10.0)
    autopilot.mode = "AUTO.LOITER"
    session.receive(autopilot.codec.encode(autopilot.message(CURRENT_MODE, 10.5)), 10.5)
    assert session.orders.take() == []
    session.receive(autopilot.tick(11.0), 11.0)
    assert [order.source for order in session.orders.take()] == ["flight mode AUTO.LOITER"]


def test_the_hold_that_ended_the_last_landing_does_not_ask_for_the_next() -> None:
    orders = listener(flight_mode="LOITER")
    orders.stand_by(10.5)
    assert flown(orders, "POSCTL", "AUTO.LOITER") == []


@pytest.mark.parametrize("name", ["RTL", "LAND", "AUTO.RTL", "AUTO.LAND", "SMART_RTL", "BRAKE", "PRECLAND"])
def test_the_names_of_what_failsafes_choose_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} is what failsafes choose"):
        OrdersConfig(flight_mode=name)


def test_a_mission_asks_by_the_item_that_is_set() -> None:
    orders = listener(mission_item=4)
    for number in (3, 4, 5):
        orders.hear_autopilot(
            mavlink.MAVLink_mission_item_reached_message(number),
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
            10.0,
        )
    assert [order.source for order in orders.take()] == ["mission item 4"]


def test_an_item_that_is_told_again_is_reached_once_until_the_next_flight() -> None:
    orders = listener(mission_item=4)
    reached = mavlink.MAVLink_mission_item_reached_message(4)
    given: list[Order] = []
    for second in range(11):  # as PX4 does
        orders.hear_autopilot(reached, mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED, 20.0 + second)
        given += orders.take()
        if second == 2:
            orders.stand_by(22.5)  # stopped: what follows is no new word
    assert [order.time_s for order in given] == [20.0]
    for armed in (False, True):
        state = AutopilotState(50.0, connected=True, autopilot_kind="px4", armed=armed)
        orders.hear_heartbeat(state, mavlink.MAV_STATE_ACTIVE, 50.0)
    orders.hear_autopilot(reached, mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED, 60.0)
    assert [order.time_s for order in orders.take()] == [60.0]


# ---------------------------------------------------------------- through the session


def test_the_session_takes_the_autopilot_s_signs_from_the_autopilot_alone() -> None:
    session = Session(LinkConfig(), orders=OrdersConfig(mission_item=4, rc_channel=7))
    autopilot, gimbal = Codec(1, 1), Codec(1, 154)
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 128, 0, 4, 3)
    session.receive(autopilot.encode(beat), 5.0)
    reached = mavlink.MAVLink_mission_item_reached_message(4)
    session.receive(gimbal.encode(reached), 6.0)
    assert session.orders.take() == []
    session.receive(autopilot.encode(reached), 7.0)
    assert len(session.orders.take()) == 1


def test_the_session_sends_the_answers() -> None:
    session = Session(LinkConfig())
    session.receive(Codec(GROUND, 190).encode(heartbeat()), 1.0)
    session.receive(Codec(GROUND, 190).encode(command(mavlink.MAV_CMD_NAV_LAND)), 1.0)
    (order,) = session.orders.take()
    session.orders.reply(order, reply(order, OrderOutcome.DENIED))
    sent = Codec(GROUND).decode(session.tick(1.1))
    (ack,) = [m for m in sent if m.get_type() == "COMMAND_ACK"]
    assert (ack.result, ack.target_system) == (mavlink.MAV_RESULT_DENIED, GROUND)
