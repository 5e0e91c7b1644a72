"""Orders over the link: who may give them, what an edge is, and what is answered."""

from dataclasses import replace
from typing import Any

import pytest

from companion.base.messages import (
    AutopilotState,
    Order,
    OrderKind,
    OrderOutcome,
    OrderReply,
)
from companion.config import LinkConfig, OrdersConfig
from companion.link.codec import Codec, command_int, command_long, heartbeat, mavlink
from companion.link.orders import SETTLES_S, OrderListener
from companion.link.session import Session

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


@pytest.mark.parametrize("value", [3.0, 0.5, float("nan"), float("inf")])
def test_what_is_no_order_is_answered_as_unsupported(value: float) -> None:
    orders = listener()
    orders.hear_command(from_system(command(mavlink.MAV_CMD_USER_1, value)), US, 5.0)
    assert orders.take() == []
    assert [a.result for a in orders.answers()] == [mavlink.MAV_RESULT_UNSUPPORTED]


def test_with_commands_turned_off_they_are_unsupported() -> None:
    orders = listener(mavlink=False)
    orders.hear_command(from_system(command(mavlink.MAV_CMD_NAV_LAND)), US, 5.0)
    assert orders.take() == []
    assert [a.result for a in orders.answers()] == [mavlink.MAV_RESULT_UNSUPPORTED]


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


def test_a_mode_asks_when_the_pilot_enters_it() -> None:
    orders = listener(flight_mode="GUIDED")
    state = AutopilotState(0.0, connected=True, armed=True, mode="GUIDED")
    orders.hear_mode(state, 10.0)  # as it was found
    assert orders.take() == []
    orders.hear_mode(replace(state, mode="LOITER"), 11.0)
    orders.hear_mode(state, 12.0)
    (order,) = orders.take()
    assert (order.kind, order.source) == (OrderKind.LAND, "flight mode GUIDED")
    orders.hear_mode(state, 13.0)
    orders.hear_mode(replace(state, mode="LOITER", armed=False), 14.0)
    orders.hear_mode(replace(state, armed=False), 15.0)
    assert orders.take() == []


def test_px4_s_modes_go_by_their_short_names() -> None:
    orders = listener(flight_mode="LOITER")
    state = AutopilotState(0.0, connected=True, armed=True, mode="POSCTL")
    orders.hear_mode(state, 10.0)
    orders.hear_mode(replace(state, mode="AUTO.LOITER"), 11.0)
    assert len(orders.take()) == 1


def test_the_hold_that_ended_the_last_landing_does_not_ask_for_the_next() -> None:
    orders = listener(flight_mode="LOITER")
    state = AutopilotState(0.0, connected=True, armed=True, mode="OFFBOARD")
    orders.hear_mode(state, 10.0)
    orders.stand_by(10.5)
    orders.hear_mode(replace(state, mode="AUTO.LOITER"), 11.0)
    assert orders.take() == []


def test_a_mission_asks_by_the_item_that_is_set() -> None:
    orders = listener(mission_item=4)
    for number in (3, 4, 5):
        orders.hear_autopilot(
            mavlink.MAVLink_mission_item_reached_message(number),
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
            10.0,
        )
    assert [order.source for order in orders.take()] == ["mission item 4"]


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
